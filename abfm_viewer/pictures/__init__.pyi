from .document_pictures import DocumentRenderer as DocumentRenderer
from .document_pictures import PictureOptions as PictureOptions
from .movies import write_movie as write_movie
from .panels import captions as captions
from .plots import plot_font as plot_font
from .plots import plot_picture as plot_picture
from .sheets import figure_picture as figure_picture
from .sheets import match_picture as match_picture
