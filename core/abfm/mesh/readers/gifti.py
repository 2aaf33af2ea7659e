"""GIFTI surfaces of brain imaging, plain or compressed (.gii, .gii.gz)."""

from pathlib import Path

import numpy as np

from abfm.mesh.readers.contents import FileContents

POINTSET, TRIANGLE = 1008, 1009  # NIFTI_INTENT codes


def read_gifti(path: Path) -> FileContents:
    """The point set and the triangles of a GIFTI surface file.

    Raises
    ------
    ValueError
        If nibabel is not installed, or the file holds no single surface.
    """
    try:
        import nibabel
        from nibabel.gifti.gifti import GiftiImage
    except ImportError as error:
        raise ValueError("reading GIFTI needs nibabel: pip install abfm[gifti]") from error
    image = nibabel.load(path)
    if not isinstance(image, GiftiImage):
        raise ValueError("it is not a GIFTI file")
    points = [array.data for array in image.darrays if array.intent == POINTSET]
    triangles = [array.data for array in image.darrays if array.intent == TRIANGLE]
    if len(points) != 1 or len(triangles) != 1:
        raise ValueError(
            f"it has {len(points)} point sets and {len(triangles)} triangle arrays instead of one of each: "
            "give a surface file (.surf.gii)"
        )
    return FileContents(np.asarray(points[0], dtype=np.float64), np.asarray(triangles[0]))
