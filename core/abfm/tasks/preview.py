"""Functions of a result for a small picture, read from its file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from abfm.errors import ResultError, one_line
from abfm.io import results
from abfm.mesh import TriangleMesh
from abfm.types import FloatArray


class Preview(NamedTuple):
    """Functions (V,) on a surface that a small picture of a result shows."""

    mesh: TriangleMesh
    functions: list[FloatArray]


def preview_of(
    path: Path, file: results.FileKind, functions: Callable[..., list[FloatArray]]
) -> Preview:
    """Return the functions that are made of the arrays of a file, and its surface.

    Raises
    ------
    ResultError
        If the file is missing or damaged.
    """
    arrays = results.load_arrays(path, file)
    try:
        mesh = results.mesh_of(arrays)
    except ValueError as error:
        raise ResultError(f"{one_line(path)}: {one_line(error)}; {results.MEND}") from error
    return Preview(mesh, functions(arrays))
