"""Rows of pictures of surfaces, each from two opposite sides, for static pages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from PIL import Image

from abfm import TriangleMesh
from abfm.io.sheets import Panel, Sheet, Values
from abfm.pages.colormaps import ColorRange
from abfm.pages.front import Front, triple
from abfm.types import FloatArray
from abfm_viewer.pictures.panels import panel_pictures
from abfm_viewer.scene.surfaces import fitted

_ASPECT_MIN = 0.5
_ASPECT_MAX = 1.5


class Drawing(NamedTuple):
    """A surface from the front and from the back."""

    title: str
    sides: tuple[Image.Image, Image.Image]


@dataclass(frozen=True, eq=False)
class Row:
    """Surfaces that are compared, with the colours of their functions by title."""

    title: str
    panels: tuple[Panel, ...]
    ranges: Mapping[str, ColorRange]
    drawings: tuple[Drawing, ...] = ()


def panels_of(
    mesh: TriangleMesh, bar: str, functions: Mapping[str, FloatArray]
) -> tuple[Panel, ...]:
    """Return a panel of each function on a surface, by label, in the colours of one bar."""
    return tuple(Panel(mesh, Values(values, bar), label) for label, values in functions.items())


def drawn(
    rows: Sequence[Row],
    fronts: Mapping[TriangleMesh, Front],
    width: int,
    report: Callable[[str, float], None],
) -> list[Row]:
    """Return rows with their drawings of a width in pixels, all of one aspect.

    ``report`` is called with each row and the share that is done. A `DrawingError` says why the
    machine cannot draw.
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
            Drawing(panel.label, (side_by_side([front]), side_by_side([back])))
            for panel, front, back in zip(row.panels, *sides, strict=True)
        )
        found.append(replace(row, drawings=tuple(drawings)))
    return found


def side_by_side(pictures: Sequence[Image.Image]) -> Image.Image:
    """Return transparent pictures of one size next to each other, on white."""
    width, height = pictures[0].size
    ground = Image.new("RGB", (len(pictures) * width, height), "white")
    for number, picture in enumerate(pictures):
        ground.paste(picture, (number * width, 0), picture)
    return ground
