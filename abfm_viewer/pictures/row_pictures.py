"""Small pictures of many results: source, where it was carried, and target, beside each other; of
a film its first, middle and last frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from PIL import Image

from abfm import ResultError, TriangleMesh
from abfm.errors import one_line
from abfm.io.results import MEND, SEQUENCE, load_arrays, mesh_of
from abfm.io.sheets import Panel, Sheet, Up, Values
from abfm.pages.colormaps import color_range
from abfm.pages.front import best_front
from abfm.sequences import is_sequence
from abfm.types import FloatArray
from abfm_viewer.pictures.panels import panel_pictures
from abfm_viewer.pictures.rows import side_by_side
from abfm_viewer.scene.surfaces import Camera, fitted

SIZE = 132, 110
"""Of each of the three, in pixels."""
_TOGETHER = 24  # results that are drawn on one canvas, which takes long to make
_KEPT = 50  # meshes whose cameras are known


class _Shown(NamedTuple):
    path: Path
    mesh: TriangleMesh
    functions: list[FloatArray]  # three
    labels: tuple[str, str, str]


def row_pictures(
    paths: Sequence[Path], up: Up | None = None
) -> Iterator[tuple[Path, Image.Image | ResultError]]:
    """Yield the picture of each result, of a match or of a registration's match on B, on white, or
    why there is none; all on a mesh are seen from where much of their functions is. A
    `DrawingError` says why the machine cannot draw.
    """
    seen: dict[str, TriangleMesh] = {}
    cameras: dict[TriangleMesh, Camera] = {}
    for start in range(0, len(paths), _TOGETHER):
        read: list[_Shown] = []
        for path in paths[start : start + _TOGETHER]:
            try:
                read.append(_read(path, seen))
            except ResultError as error:
                yield path, error
        for mesh in {one.mesh: None for one in read if one.mesh not in cameras}:
            functions = [f for one in read if one.mesh is mesh for f in one.functions[::2]]
            front, aspect = best_front(mesh, *functions, up=up), SIZE[0] / SIZE[1]
            cameras[mesh] = fitted(mesh.vertices, front, aspect)
        if read:
            bars = [f"function {number}" for number in range(len(read))]
            every = tuple(
                Panel(one.mesh, Values(values, bar), label)
                for one, bar in zip(read, bars, strict=True)
                for values, label in zip(one.functions, one.labels, strict=True)
            )
            colors = [color_range(*one.functions[::2]) for one in read]
            ranges = dict(zip(bars, colors, strict=True))
            drawn = iter(panel_pictures(Sheet((every,)), [SIZE] * len(every), ranges, cameras))
            for one in read:
                yield one.path, side_by_side([next(drawn) for _ in one.labels])
        if len(seen) > _KEPT:
            seen.clear()
            cameras.clear()


def _read(path: Path, seen: dict[str, TriangleMesh]) -> _Shown:
    if is_sequence(path):
        arrays, labels = load_arrays(path, SEQUENCE), ("first frame", "middle", "last frame")
        frames = arrays["frames"][:, :, 0]
        functions = [frames[i] for i in (0, len(frames) // 2, -1)]
    else:
        arrays, labels = load_arrays(path), ("source", "carried", "target")
        functions = [arrays[name][:, 0] for name in ("source", "advected", "target")]
    try:
        mesh = mesh_of(arrays)
    except ValueError as error:
        raise ResultError(f"{one_line(path)}: {one_line(error)}; {MEND}") from error
    return _Shown(path, seen.setdefault(mesh.digest, mesh), functions, labels)
