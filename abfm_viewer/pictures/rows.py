"""Small pictures for static pages: rows of surfaces from two opposite sides, and previews."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from abfm import ResultError, TriangleMesh
from abfm.calculus.operators import vertex_areas
from abfm.display import BEST_VIEW, ViewSpec
from abfm.io.sheets import Panel, Sheet, Values
from abfm.pages.color_ranges import color_range
from abfm.pages.colormaps import ColorRange
from abfm.pages.front import Front, front_of, triple
from abfm.tasks.task import Preview, Task
from abfm.types import FloatArray
from abfm_viewer.pictures.panels import panel_pictures
from abfm_viewer.scene.surfaces import Camera, fitted

_ASPECT_MIN = 0.5
_ASPECT_MAX = 1.5
PREVIEW_SIZE = 132, 110  # width and height of each of the three functions of a preview, in pixels
_RESULTS_PER_CANVAS = 24  # because a canvas takes long to create
_CACHED_MESHES_MAX = 50  # with their cameras


class Drawing(NamedTuple):
    """Pictures of a surface from the front and from the back."""

    title: str
    sides: tuple[Image.Image, Image.Image]


@dataclass(frozen=True, eq=False)
class Row:
    """A row of pictures of surfaces that a page shows side by side for comparison."""

    title: str
    panels: tuple[Panel, ...]
    ranges: Mapping[str, ColorRange]  # by the title of the colour bar
    drawings: tuple[Drawing, ...] = ()


def panels_of(
    mesh: TriangleMesh, bar: str, functions: Mapping[Any, FloatArray]
) -> tuple[Panel, ...]:
    """Return a panel for each function on a surface, by label; all share the colour bar ``bar``."""
    return tuple(Panel(mesh, Values(each, bar), str(label)) for label, each in functions.items())


def draw_rows(
    rows: Sequence[Row],
    fronts: Mapping[TriangleMesh, Front],
    width: int,
    report: Callable[[str, float], None],
) -> list[Row]:
    """Draw rows of surfaces, and return the rows with their pictures.

    Each picture is ``width`` pixels wide, and all have the same aspect. ``fronts`` are the fronts
    of the meshes. ``report`` is called with the title of each row and the completed share, 0 to 1.
    Raises `DrawingError` if the machine cannot draw.
    """
    free = (fitted(mesh.vertices, front).aspect for mesh, front in fronts.items())
    aspect = min(max(*free, _ASPECT_MIN), _ASPECT_MAX)
    size = width, max(round(width / aspect), 1)
    views = [
        {
            mesh: fitted(mesh.vertices, replace(front, direction=triple(direction)), aspect)
            for mesh, front in fronts.items()
            for direction in [sign * np.array(front.direction)]
        }
        for sign in (1, -1)
    ]
    found = []
    for number, row in enumerate(rows):
        report(f"drawing {row.title}", number / len(rows))
        sheet, sizes = Sheet((row.panels,)), [size] * len(row.panels)
        sides = (panel_pictures(sheet, sizes, row.ranges, view) for view in views)
        drawings = (
            Drawing(panel.label, (_side_by_side([front]), _side_by_side([back])))
            for panel, front, back in zip(row.panels, *sides, strict=True)
        )
        found.append(replace(row, drawings=tuple(drawings)))
    return found


def row_pictures(
    results: Sequence[tuple[Path, type[Task]]], view: ViewSpec = BEST_VIEW
) -> Iterator[tuple[Path, Image.Image | ResultError]]:
    """Yield the path of each result file, and its picture on white or the error of reading it.

    ``results`` are paths, each with the kind of task that made the result. All results on one mesh
    have the same camera, which shows their functions well. Raises `DrawingError` if the machine
    cannot draw.
    """
    meshes: dict[str, TriangleMesh] = {}
    cameras: dict[TriangleMesh, Camera] = {}
    for start in range(0, len(results), _RESULTS_PER_CANVAS):
        read: list[tuple[Path, Preview]] = []
        for path, kind in results[start : start + _RESULTS_PER_CANVAS]:
            try:
                mesh, functions = kind.file.preview(path)
            except ResultError as error:
                yield path, error
            else:
                read.append((path, Preview(meshes.setdefault(mesh.digest, mesh), functions)))
        for mesh in {one.mesh: None for _, one in read if one.mesh not in cameras}:
            ends = [f for _, one in read if one.mesh is mesh for f in one.functions[::2]]
            front, aspect = front_of(mesh, *ends, view=view), PREVIEW_SIZE[0] / PREVIEW_SIZE[1]
            cameras[mesh] = fitted(mesh.vertices, front, aspect)
        ranges = {
            str(path): color_range(*functions[::2], areas=vertex_areas(mesh))
            for path, (mesh, functions) in read
        }
        every = [
            panels_of(mesh, str(path), dict(enumerate(functions)))
            for path, (mesh, functions) in read
        ]
        sheet = Sheet((tuple(chain.from_iterable(every)),))
        sizes = [PREVIEW_SIZE] * len(sheet.rows[0])
        shown = iter(panel_pictures(sheet, sizes, ranges, cameras))
        for (path, _), panels in zip(read, every, strict=True):
            yield path, _side_by_side([next(shown) for _ in panels])
        if len(meshes) > _CACHED_MESHES_MAX:
            meshes.clear()
            cameras.clear()


def _side_by_side(pictures: Sequence[Image.Image]) -> Image.Image:
    """Return transparent pictures of one size side by side, on white."""
    width, height = pictures[0].size
    ground = Image.new("RGB", (len(pictures) * width, height), "white")
    for number, picture in enumerate(pictures):
        ground.paste(picture, (number * width, 0), picture)
    return ground
