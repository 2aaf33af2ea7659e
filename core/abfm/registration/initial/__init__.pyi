from .alignment import Alignment as Alignment
from .alignment import align as align
from .alignment import closest_after_alignment as closest_after_alignment
from .connectivity import same_connectivity as same_connectivity
from .landmark_pairs import Landmarks as Landmarks
from .landmark_pairs import read_landmarks as read_landmarks
from .vertex_files import map_from_file as map_from_file
