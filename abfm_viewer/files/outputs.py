"""Output files: refused before hours of work, and written by their suffix."""

from __future__ import annotations

import os
import re
import secrets
import tempfile
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import abfm
from abfm import AbfmError, ResultError, pages
from abfm.errors import one_line, printable
from abfm.io import results, write_atomically
from abfm.types import IntArray

if TYPE_CHECKING:
    from PIL import Image

SLOWEST = 0.1
# frames a second by suffix; browsers slow down a GIF that is faster
FASTEST = {".mp4": 120.0, ".gif": 50.0}
WRITTEN = (".npz", ".ply", ".vtu", ".csv", ".html")
"""Suffixes of files that a match can be written to."""


def check(path: Path, suffixes: Collection[str]) -> None:
    """Refuse a path that could not be written, by a `ResultError` that says why and what to do."""
    if path.suffix not in suffixes:
        raise ResultError(f"cannot write {path}: its name must end in {', '.join(suffixes)}")
    check_folder(path)


def check_folder(path: Path) -> None:
    """Refuse a path that could not be written, whatever its suffix."""
    if path.parent.exists() and not path.parent.is_dir():
        raise ResultError(f"cannot write {path}: {path.parent} is no folder; choose another place")
    if not path.parent.is_dir():
        raise ResultError(f"cannot write {path}: there is no folder {path.parent}; make it first")
    abfm.io.check_writable(path)


def check_not_read(path: Path, read: Iterable[str | None]) -> None:
    """Refuse a path of a file that the same command reads, also by the text of a function, and a
    .pvd whose frames would lie among those that are read.
    """
    for name in (name for each in read if each is not None for name in _files_in(each)):
        other = Path(os.path.expanduser(name))
        among = re.fullmatch(rf"{re.escape(path.stem)}_[0-9]+\.vtu", other.name)
        frame = path.with_suffix("") / other.name
        written = [path, frame] if path.suffix == ".pvd" and among else [path]
        for place in written:
            if os.path.exists(other) and os.path.exists(place) and place.samefile(other):
                named = "it" if place is path else f"its {other.name}"
                raise ResultError(f"cannot write {path}: {named} is read; choose another name")


def _files_in(text: str) -> list[str]:
    """Return the names of files that a text may mean: itself, or those of a function."""
    from abfm.batch.columns import SPEC  # with all that it loads

    found = [text]

    def seen(name: str) -> str:
        found.append(name)
        return name

    with suppress(AbfmError):
        SPEC.renamed(text, seen)
    return found


def check_registered(path: Path) -> None:
    """Refuse a path that no registration could be written to."""
    check(path, REGISTERED)
    if path.suffix not in (*_TABLES, ".npz", ".html"):
        abfm.io.check_surface_name(path)


_TABLES = (".txt", ".csv", ".npy")
REGISTERED = (".npz", ".gii", ".ply", ".reg", ".txt", ".csv", ".npy", ".html")
"""Suffixes of files that a registration can be written to."""


def check_sequence(path: Path) -> None:
    """Refuse a path that no sequence could be written to."""
    check(path, SEQUENCES)
    if path.suffix == ".stc":
        abfm.io.check_stc_name(path)
    elif path.suffix == ".pvd":
        abfm.sequences.check_pvd(path)
    elif path.suffix == ".gii":
        abfm.io.check_values_name(path)


SEQUENCES = (".npz", ".pvd", ".stc", ".gii", ".html")
"""Suffixes of files that a sequence can be written to."""


class LostResultError(ResultError):
    """A result that could be written nowhere."""


def write_sequences(
    paths: Sequence[Path],
    found: abfm.Sequence,
    tracks: Path | None = None,
    intervals: Path | None = None,
    labels: pages.Labels | None = None,
) -> list[str]:
    """Write a sequence to several files, and its tables, as `write_all` does, with the labels of
    pages.
    """
    writers: dict[Path, Callable[[], str | None]] = {
        path: partial(write_sequence, path, found, labels) for path in paths
    }
    if tracks is not None:
        writers[tracks] = partial(abfm.sequences.export_tracks, tracks, found)
    if intervals is not None:
        writers[intervals] = partial(abfm.sequences.export_intervals, intervals, found)
    return _write_each([*writers], lambda path: writers[path](), found)


def write_sequence(path: Path, found: abfm.Sequence, labels: pages.Labels | None = None) -> str:
    """Write by the suffix, as `write` does, with the labels of a page."""
    if path.suffix == ".npz":
        return results.save_what_can_be(path, found)
    if path.suffix == ".pvd":
        abfm.sequences.export_pvd(path, found)
    elif path.suffix == ".stc":
        return abfm.sequences.export_stc(path, found)
    elif path.suffix == ".html":
        pages.sequence_page(found, printable(path.stem), labels or pages.Labels()).write(path)
    else:
        abfm.sequences.export_speed(path, found)
    return ""


def write_registration(path: Path, found: abfm.Registration, up: str | None = None) -> str:
    """Write by the suffix, as `write` does; ``up`` is B's axis that points upwards on a page."""
    if path.suffix == ".npz":
        return results.save_what_can_be(path, found)
    if path.suffix == ".html":
        pages.registration_page(found, printable(path.stem), up).write(path)
    elif path.suffix in _TABLES:
        abfm.io.write_values(path, vertex_numbers(found.points))
    else:
        left_out = found.a.file_vertex_count - len(found.a.vertices)
        if left_out:
            raise ResultError(
                f"cannot write {path}: {left_out} vertices of A's file were left out or merged, so "
                "that rows would not be those of the file; write a .npz, or give A without them"
            )
        try:
            positions, structure = found.back.positions, found.a.structure
            placed = abfm.TriangleMesh(positions, found.a.faces, structure=structure)
        except AbfmError as error:
            raise ResultError(f"cannot write {path}: where A lies on B {one_line(error)}") from None
        abfm.io.write_surface(path, placed)
    return ""


def vertex_numbers(points: abfm.PointMap) -> IntArray:
    """Return the nearest vertex for each vertex of the domain, both counted as the mesh files do;
    -1 for vertices that no face uses.
    """
    return points.domain.on_file(points.codomain.vertex_ids[points.nearest_vertices()], -1)


def make_folder(path: Path) -> None:
    """Make a folder for output unless it is there; a `ResultError` says why that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:
        raise ResultError(
            f"cannot make the folder {path}: {one_line(error)}; choose another"
        ) from None


def write(path: Path, match: abfm.Match, up: str | None = None) -> str:
    """Write by the suffix; ``up`` is the axis that points upwards on a page. Return what a result
    file is without and why, in a line, if some of it cannot be written.
    """
    if path.suffix == ".npz":
        return results.save_what_can_be(path, match)
    if path.suffix == ".csv":
        abfm.io.export_energy_csv(path, match.energy_history, match.stages)
    elif path.suffix == ".html":
        pages.match_page(match, printable(path.stem), up).write(path)
    else:
        functions = {"source": match.source, "target": match.target, "advected": match.advected}
        on_points = {name: f if f.shape[1] > 1 else f[:, 0] for name, f in functions.items()}
        one = len(match.velocity) == 1
        names = ["velocity" if one else f"velocity_segment_{i}" for i in range(len(match.velocity))]
        export = abfm.io.export_ply if path.suffix == ".ply" else abfm.io.export_vtu
        export(path, match.mesh, on_points, dict(zip(names, match.velocity, strict=True)))
    return ""


def write_path(path: Path, match: abfm.Match) -> None:
    """Write the table of a match's path as CSV, whole or not at all."""
    lines = abfm.matching.path_table(match.path, match.mesh)
    write_text(path, "".join(f"{line}\n" for line in lines))


def write_all(
    paths: Sequence[Path], found: abfm.Match | abfm.Registration, up: str | None = None
) -> list[str]:
    """Write a result to several files; return what a result file is without, a line each.

    If a file cannot be written the result is kept elsewhere, unless a result file holds it, and a
    ResultError reports that.
    """
    if isinstance(found, abfm.Match):
        return _write_each(paths, partial(write, match=found, up=up), found)
    return _write_each(paths, partial(write_registration, found=found, up=up), found)


def _write_each(
    paths: Sequence[Path], write: Callable[[Path], str | None], whole: results.Saved
) -> list[str]:
    problem, kept, notes = None, False, []
    for path in paths:
        try:
            note = write(path)
        except Exception as error:  # whatever goes wrong, the result is kept
            problem = problem or error
        else:
            kept = kept or path.suffix == ".npz"
            notes += [note] if note else []
    if problem is None:
        return notes
    reason = one_line(problem) if isinstance(problem, AbfmError) else f"not written: {problem!r}"
    if kept:
        raise ResultError(reason) from problem
    if place := _kept_elsewhere(whole):
        raise ResultError(f"{reason}; the result is in {place}") from problem
    raise LostResultError(f"{reason}; there was no other place for the result either") from problem


def _kept_elsewhere(whole: results.Saved) -> str:
    """Save a result in a folder that can be written; return its place, or nothing."""
    for folder in (Path.cwd, Path.home, tempfile.gettempdir):
        with suppress(Exception):
            place = Path(folder()) / f"abfm-{secrets.token_hex(4)}.npz"
            missing = results.save_what_can_be(place, whole)
            return f"{place}{f'; {missing}' if missing else ''}"
    return ""


def write_text(path: Path, text: str) -> None:
    """Write a text, whole or not at all, with question marks for what UTF-8 cannot encode."""
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


def write_picture(path: Path, picture: Image.Image) -> None:
    with write_atomically(path) as temporary:
        picture.save(temporary)
