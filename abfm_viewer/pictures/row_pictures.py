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
from abfm.io.sheets import Panel, Sheet, Values
from abfm.sequences import is_sequence
from abfm_viewer.appearance.colormaps import ColorRange, color_range
from abfm_viewer.computing.defaults import best_front
from abfm_viewer.pictures.panels import panel_pictures
from abfm_viewer.scene.surfaces import Camera, fitted

SIZE = 132, 110
"""Of each of the three, in pixels."""
_FIELD_OF_VIEW, _MARGIN = 18.0, 0.04  # degrees; share of the surface
_TOGETHER = 24  # results that are drawn on one canvas, which takes long to make
_KEPT = 50  # meshes whose cameras are known


class _Seen(NamedTuple):
    mesh: TriangleMesh
    camera: Camera


def row_pictures(paths: Sequence[Path]) -> Iterator[tuple[Path, Image.Image | ResultError]]:
    """Yield the picture of each result, of a match or of a registration's match on B, on white, or
    why there is none. A `DrawingError` says why the machine cannot draw.
    """
    seen: dict[str, _Seen] = {}
    for start in range(0, len(paths), _TOGETHER):
        read: list[tuple[Path, tuple[Panel, ...]]] = []
        ranges: dict[str, ColorRange] = {}
        for number, path in enumerate(paths[start : start + _TOGETHER]):
            try:
                panels, colors = _panels(path, f"function {number}", seen)
            except ResultError as error:
                yield path, error
            else:
                read.append((path, panels))
                ranges |= colors
        every = [panel for _, panels in read for panel in panels]
        if every:
            views = {one.mesh: one.camera for one in seen.values()}
            drawn = iter(panel_pictures(Sheet((tuple(every),)), [SIZE] * len(every), ranges, views))
            for path, panels in read:
                yield path, _side_by_side([next(drawn) for _ in panels])
        if len(seen) > _KEPT:
            seen.clear()


def _panels(
    path: Path, bar: str, seen: dict[str, _Seen]
) -> tuple[tuple[Panel, ...], dict[str, ColorRange]]:
    if is_sequence(path):
        arrays, labels = load_arrays(path, SEQUENCE), ("first frame", "middle", "last frame")
        frames = arrays["frames"][:, :, 0]
        source, advected, target = (frames[i] for i in (0, len(frames) // 2, -1))
    else:
        arrays, labels = load_arrays(path), ("source", "carried", "target")
        source, advected, target = (arrays[name][:, 0] for name in ("source", "advected", "target"))
    try:
        mesh = mesh_of(arrays)
    except ValueError as error:
        raise ResultError(f"{one_line(path)}: {one_line(error)}; {MEND}") from error
    if mesh.digest not in seen:
        front = best_front(mesh, target)
        aspect = SIZE[0] / SIZE[1]
        camera = fitted(mesh.vertices, front, aspect, _FIELD_OF_VIEW, _MARGIN)
        seen[mesh.digest] = _Seen(mesh, camera)
    mesh = seen[mesh.digest].mesh
    panels = tuple(
        Panel(mesh, Values(values, bar), label)
        for values, label in zip((source, advected, target), labels, strict=True)
    )
    return panels, {bar: color_range(source, target)}


def _side_by_side(pictures: Sequence[Image.Image]) -> Image.Image:
    whole = Image.new("RGB", (len(pictures) * SIZE[0], SIZE[1]), "white")
    for number, picture in enumerate(pictures):
        whole.paste(picture, (number * SIZE[0], 0), picture)
    return whole
