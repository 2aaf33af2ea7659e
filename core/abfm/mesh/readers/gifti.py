"""GIFTI surfaces of brain imaging, plain or compressed (.gii, .gii.gz)."""

from pathlib import Path

import numpy as np

from abfm.mesh.readers.contents import FileContents
from abfm.reading.gifti import gifti_arrays


def read_gifti(path: Path) -> FileContents:
    """Read the point set and the triangles of a GIFTI surface file."""
    arrays = gifti_arrays(path)
    points = [array.values for array in arrays if array.intent == "NIFTI_INTENT_POINTSET"]
    triangles = [array.values for array in arrays if array.intent == "NIFTI_INTENT_TRIANGLE"]
    if len(points) != 1 or len(triangles) != 1:
        raise ValueError(
            f"it has {len(points)} point sets and {len(triangles)} triangle arrays instead of one "
            "of each: give a surface file (.surf.gii)"
        )
    return FileContents(np.asarray(points[0], dtype=np.float64), triangles[0])
