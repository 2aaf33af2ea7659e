"""Warnings about files of different hemispheres that are used together."""

import os
import warnings
from collections.abc import Iterable

from abfm.errors import AbfmWarning, one_line
from abfm.mesh import TriangleMesh
from abfm.reading import HEMISPHERES, hemisphere, named_side, side_of


def warn_of_sides(mesh: TriangleMesh, path: str | os.PathLike[str], side: str = "") -> None:
    """Warn once if a surface and a file belong to different hemispheres.

    ``side`` is the hemisphere in the metadata of the file, or empty.
    """
    mesh_side = side_of(mesh.structure)
    text = _difference(mesh.file_name or "the surface", mesh_side, path, side or hemisphere(path))
    if text:
        warn_once(mesh, text)


def warn_once(mesh: TriangleMesh, text: str) -> None:
    """Warn, unless there was a warning with the same text for this mesh before."""
    reported = mesh.cache.setdefault(warn_once, set())
    if text not in reported:
        reported.add(text)
        warnings.warn(text, AbfmWarning, stacklevel=4)


def warn_of_mixed_sides(mesh: TriangleMesh, paths: Iterable[str]) -> None:
    """Warn if files for a surface of unknown hemisphere have names of both hemispheres."""
    found = {side: path for path in paths if (side := named_side(path))}
    if side_of(mesh.structure) is None and len(found) > 1:
        text = _difference(found["L"], "L", found["R"], "R")
        warnings.warn(text, AbfmWarning, stacklevel=3)


def _difference(
    first: str | os.PathLike[str],
    side: str | None,
    other: str | os.PathLike[str],
    other_side: str | None,
) -> str:
    if side is None or other_side is None or side == other_side:
        return ""
    one, two = (one_line(os.path.basename(name), 80) for name in (first, other))
    return (
        f"{one} belongs to the {HEMISPHERES[side]} hemisphere, but {two} to the "
        f"{HEMISPHERES[other_side]} one. Use files of the same hemisphere"
    )
