"""Small pictures of many results: the functions of their previews next to each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from PIL import Image

from abfm import ResultError, TriangleMesh
from abfm.io.sheets import Panel, Sheet, Up, Values
from abfm.pages.colormaps import color_range
from abfm.pages.front import best_front
from abfm.tasks.preview import Preview
from abfm.tasks.task import Task
from abfm_viewer.pictures.panels import panel_pictures
from abfm_viewer.pictures.rows import side_by_side
from abfm_viewer.scene.surfaces import Camera, fitted

SIZE = 132, 110
"""Of each of the three, in pixels."""
_RESULTS_PER_CANVAS = 24  # results that are drawn on one canvas, which takes long to make
_MESHES_KEPT = 50  # meshes whose cameras are known


def row_pictures(
    results: Sequence[tuple[Path, type[Task]]], up: Up | None = None
) -> Iterator[tuple[Path, Image.Image | ResultError]]:
    """Yield the picture of each result, a file and its kind, on white, or why there is none.

    All on a mesh are seen from where much of their functions is. A `DrawingError` says why the
    machine cannot draw.
    """
    seen: dict[str, TriangleMesh] = {}
    cameras: dict[TriangleMesh, Camera] = {}
    for start in range(0, len(results), _RESULTS_PER_CANVAS):
        read: list[tuple[Path, Preview]] = []
        for path, kind in results[start : start + _RESULTS_PER_CANVAS]:
            try:
                mesh, functions = kind.file.preview(path)
            except ResultError as error:
                yield path, error
            else:
                read.append((path, Preview(seen.setdefault(mesh.digest, mesh), functions)))
        for mesh in {mesh: None for _, (mesh, _) in read if mesh not in cameras}:
            ends = [f for _, one in read if one.mesh is mesh for f in one.functions[::2]]
            front, aspect = best_front(mesh, *ends, up=up), SIZE[0] / SIZE[1]
            cameras[mesh] = fitted(mesh.vertices, front, aspect)
        if read:
            bars = [f"function {number}" for number in range(len(read))]
            every = tuple(
                Panel(one.mesh, Values(values, bar), "")
                for (_, one), bar in zip(read, bars, strict=True)
                for values in one.functions
            )
            colors = [color_range(*one.functions[::2]) for _, one in read]
            ranges = dict(zip(bars, colors, strict=True))
            drawn = iter(panel_pictures(Sheet((every,)), [SIZE] * len(every), ranges, cameras))
            for path, one in read:
                yield path, side_by_side([next(drawn) for _ in one.functions])
        if len(seen) > _MESHES_KEPT:
            seen.clear()
            cameras.clear()
