"""Readers of brain surfaces: GIFTI, the formats of FreeSurfer, and MNI objects (CIVET)."""

import numpy as np

from abfm.mesh.readers.contents import FileContents, split_polygons
from abfm.reading import Opened, Words, decoded, freesurfer_quadrangles, freesurfer_surface
from abfm.reading import read_gifti as gifti
from abfm.wording import counted

_MNI_PROPERTIES = 5  # count of numbers that describe the reflection of light


def read_gifti(opened: Opened) -> FileContents:
    """Read the point set and the triangles of a GIFTI surface file."""
    found = gifti(opened)
    points = [array.values for array in found.arrays if array.intent == "NIFTI_INTENT_POINTSET"]
    triangles = [array.values for array in found.arrays if array.intent == "NIFTI_INTENT_TRIANGLE"]
    if len(points) != 1 or len(triangles) != 1:
        raise ValueError(
            f"the file has {counted(len(points), 'point set')} and "
            f"{counted(len(triangles), 'triangle array')}; expected one of each, as in "
            "a surface file (.surf.gii)"
        )
    vertices = np.asarray(points[0], dtype=np.float64)
    return FileContents(vertices, triangles[0], side=found.structure)


def read_surface(opened: Opened) -> FileContents:
    """Read a FreeSurfer surface of triangles, such as ``lh.white``, in its surface RAS."""
    return FileContents(*freesurfer_surface(opened.data))


def read_quadrangles(opened: Opened) -> FileContents:
    """Read an old FreeSurfer surface; quadrangles are split as in FreeSurfer and nibabel."""
    vertices, quads = freesurfer_quadrangles(opened.data)
    even = quads[:, :1] % 2 == 0
    first = np.where(even, quads[:, [0, 1, 3]], quads[:, [0, 1, 2]])
    second = np.where(even, quads[:, [2, 3, 1]], quads[:, [0, 2, 3]])
    faces = np.stack([first, second], axis=1).reshape(-1, 3)
    quadrangles = counted(len(quads), "quadrangle was", "quadrangles were")
    return FileContents(vertices, faces, (f"{quadrangles} split into triangles",))


def read_ascii_surface(opened: Opened) -> FileContents:
    """Read a FreeSurfer surface written by ``mris_convert`` as text: .asc or .srf."""
    text = decoded(opened.data, "replace")
    words = Words(text, text.find("\n") if text.startswith("#") else 0)
    vertex_count, face_count = words.count("vertices"), words.count("faces")
    # the last column marks ripped vertices
    rows = words.numbers(4 * vertex_count, "the table of vertices").reshape(-1, 4)
    faces = words.integers(4 * face_count, "the table of faces").reshape(-1, 4)
    return FileContents(rows[:, :3].copy(), faces[:, :3].copy())


def read_mni_obj(opened: Opened) -> FileContents:
    """Read the polygons of a text MNI object file, as written by CIVET and BrainSuite.

    Format: http://www.bic.mni.mcgill.ca/users/mishkin/mni_obj_format.pdf.
    """
    text = decoded(opened.data, "replace")
    words = Words(text, text.find("P") + 1)
    words.numbers(_MNI_PROPERTIES, "its first line")
    point_count = words.count("points")
    vertices = words.numbers(3 * point_count, "the list of points").reshape(-1, 3)
    words.numbers(3 * point_count, "the list of normals")
    polygon_count = words.count("polygons")
    per_color = words.count("colours")
    if per_color > 2:
        raise ValueError(f"the number before the colours is {per_color}; expected 0, 1 or 2")
    words.numbers(4 * (1, polygon_count, point_count)[per_color], "the list of colours")
    sizes = np.diff(words.integers(polygon_count, "the list of ends"), prepend=0)
    if (sizes < 0).any():
        raise ValueError("the end indices of the polygons do not increase; the file is damaged")
    return split_polygons(vertices, sizes, words.integers(int(sizes.sum()), "the list of corners"))
