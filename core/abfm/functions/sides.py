"""Hemispheres of files that are used together."""

import os
import warnings
from collections.abc import Iterable

from abfm.errors import AbfmWarning, one_line
from abfm.mesh import TriangleMesh
from abfm.reading import HEMISPHERES, hemisphere, named_side, side_of


def warn_of_sides(mesh: TriangleMesh, path: str | os.PathLike[str], side: str = "") -> None:
    """Warn once if a surface and a file, of this side by its metadata, are of two hemispheres."""
    own = side_of(mesh.structure)
    text = _difference(mesh.file_name or "the surface", own, path, side or hemisphere(path))
    if text:
        warn_once(mesh, text)


def warn_once(mesh: TriangleMesh, text: str) -> None:
    """Warn, unless this text was a warning about the mesh before."""
    reported = mesh.cache.setdefault(warn_once, set())
    if text not in reported:
        reported.add(text)
        warnings.warn(text, AbfmWarning, stacklevel=4)


def warn_of_mixed_sides(mesh: TriangleMesh, paths: Iterable[str]) -> None:
    """Warn if files for a surface whose hemisphere is not known are of two, by their names."""
    found = {side: path for path in paths if (side := named_side(path))}
    if side_of(mesh.structure) is None and len(found) > 1:
        text = _difference(found["L"], "L", found["R"], "R")
        warnings.warn(text, AbfmWarning, stacklevel=3)


def _difference(
    first: str | os.PathLike[str], side: str | None, other: str | os.PathLike[str], its: str | None
) -> str:
    if side is None or its is None or side == its:
        return ""
    one, two = (one_line(os.path.basename(name), 80) for name in (first, other))
    return (
        f"{one} is of the {HEMISPHERES[side]} hemisphere, and {two} of the {HEMISPHERES[its]} one: "
        "use files of one hemisphere"
    )
