"""Output files: refused before hours of work, and written by their suffix."""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import abfm
from abfm import ResultError
from abfm.errors import one_line
from abfm.io import write_atomically
from abfm.types import FloatArray

if TYPE_CHECKING:
    from PIL import Image

SLOWEST = 0.1
# frames a second by suffix; browsers slow down a GIF that is faster
FASTEST = {".mp4": 120.0, ".gif": 50.0}


def check(path: Path, suffixes: Collection[str]) -> None:
    """Refuse a path that could not be written, by a `ResultError` that says why and what to do."""
    if path.suffix not in suffixes:
        raise ResultError(f"cannot write {path}: its name must end in {', '.join(suffixes)}")
    if not path.parent.is_dir():
        raise ResultError(f"cannot write {path}: there is no folder {path.parent}; make it first")
    abfm.io.check_writable(path)


def make_folder(path: Path) -> None:
    """Make a folder for output unless it is there; a `ResultError` says why that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise ResultError(
            f"cannot make the folder {path}: {one_line(error)}; choose another"
        ) from None


WRITERS: dict[str, Callable[[Path, abfm.Match], None]] = {
    ".npz": lambda path, match: match.save(path),
    ".ply": lambda path, match: abfm.io.export_ply(
        path, match.mesh, _point_data(match), _cell_data(match)
    ),
    ".vtu": lambda path, match: abfm.io.export_vtu(
        path, match.mesh, _point_data(match), _cell_data(match)
    ),
    ".csv": lambda path, match: abfm.io.export_energy_csv(path, match.energy_history, match.stages),
}


def write(path: Path, match: abfm.Match) -> None:
    """Write a match as the file's suffix says."""
    WRITERS[path.suffix](path, match)


def write_all(paths: Sequence[Path], match: abfm.Match) -> None:
    """Write a match to several files; where one cannot be written, the result is not lost.

    Raises
    ------
    ResultError
        If a file could not be written. All others are, and the result is in one of them or in
        another folder, which the error names.
    """
    problem, kept = None, False
    for path in paths:
        try:
            write(path, match)
            kept = kept or path.suffix == ".npz"
        except ResultError as error:
            problem = problem or error
    if problem is not None:
        raise problem if kept else ResultError(f"{problem}; {_kept_elsewhere(match)}")


def _kept_elsewhere(match: abfm.Match) -> str:
    """Write a result where there is a place for it, and say where."""
    folders = Path.cwd, Path.home, lambda: Path(tempfile.gettempdir())
    for folder in folders:
        with suppress(ResultError, OSError, RuntimeError):
            place = folder() / f"abfm-{secrets.token_hex(4)}.npz"
            match.save(place)
            return f"the result is in {place}"
    return "there was no other place for the result either"


def write_picture(path: Path, picture: Image.Image) -> None:
    """Write a PNG file, whole or not at all."""
    with write_atomically(path) as temporary:
        picture.save(temporary)


def _point_data(match: abfm.Match) -> dict[str, FloatArray]:
    functions = {"source": match.source, "target": match.target, "advected": match.advected}
    return {name: f if f.shape[1] > 1 else f[:, 0] for name, f in functions.items()}


def _cell_data(match: abfm.Match) -> dict[str, FloatArray]:
    if len(match.velocity) == 1:
        return {"velocity": match.velocity[0]}
    return {f"velocity_segment_{number}": field for number, field in enumerate(match.velocity)}
