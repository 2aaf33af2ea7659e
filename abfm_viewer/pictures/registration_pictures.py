"""Pictures of a registration from two opposite sides: its functions, the map itself as a
checkerboard, and what it does to areas and shapes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from abfm import Correspondence, Match, PathStep, Registration, TriangleMesh
from abfm.io.sheets import Checker, Panel, Sheet, Up, Values
from abfm.maps import Distortion
from abfm.pages.colormaps import ColorRange, table
from abfm.pages.front import Front, triple
from abfm.pages.registered import (
    MOST_CHANNELS,
    compared_colors,
    counts,
    fronts,
    functions_on_a,
)
from abfm.types import FloatArray
from abfm_viewer.pictures.panels import panel_pictures
from abfm_viewer.pictures.report_plots import histogram_picture, path_picture
from abfm_viewer.scene.surfaces import Camera, fitted

_LOG2 = "log2 J and log2 R"
_ASPECTS = 0.5, 1.5  # least and greatest width over height of all pictures
_FIELDS = 16  # of the checkerboard, along A's larger side
_LEAST = 1e-6  # of a stretch, as `Distortion.log2_area` has it
_LEAST_RANGE = 0.5  # of logarithms: less hardly shows anywhere else


@dataclass(frozen=True, eq=False)
class Drawing:
    """A surface from the front and from the back."""

    title: str
    sides: tuple[Image.Image, Image.Image]


@dataclass(frozen=True, eq=False)
class Bar:
    """What colours mean: a strip from the low to the high end."""

    title: str
    low: float
    high: float
    strip: Image.Image


@dataclass(frozen=True, eq=False)
class Row:
    """Drawings that are compared, and what their colours mean."""

    title: str
    drawings: tuple[Drawing, ...]
    bars: tuple[Bar, ...]


@dataclass(frozen=True, eq=False)
class Planned:
    """A row before it is drawn."""

    title: str
    panels: tuple[Panel, ...]
    ranges: Mapping[str, ColorRange]


@dataclass(frozen=True, eq=False)
class RegistrationPictures:
    """All that a report draws."""

    functions: tuple[Row, ...]  # one a channel, of a registration
    map: Row  # a checkerboard on A and on B, and logarithms of areas and shapes on B
    histograms: tuple[Image.Image, Image.Image]  # of areas and shapes
    path: Image.Image | None  # where it has several steps whose distortion is known


def registration_pictures(
    found: Correspondence,
    distortion: Distortion,
    width: int,
    up: Up | None = None,
    report: Callable[[str, float], None] = lambda text, share: None,
) -> RegistrationPictures:
    """Draw a registration, or a map without functions, in pictures of a width in pixels.

    ``distortion`` is the map's, and ``report`` is called with what is drawn and the share that is
    behind. A `DrawingError` says why the machine cannot draw.
    """
    of_a, of_b = fronts(found, up)
    views, aspect = both_sides({found.a: of_a, found.b: of_b})
    functions = _functions(found) if isinstance(found, Registration) else []
    planned = [*functions, _map(found, distortion, views[0][found.a].front)]
    rows = drawn_rows(planned, views, (width, max(round(width / aspect), 1)), report)
    report("drawing plots", 1.0)
    path = _path(found.match, width) if isinstance(found, Registration) else None
    return RegistrationPictures(tuple(rows[:-1]), rows[-1], _histograms(distortion, width), path)


def log2_of(ratios: FloatArray) -> FloatArray:
    """Return logarithms to base 2 of areas or shapes (F,), those of none as of a millionth."""
    return np.asarray(np.log2(np.clip(ratios, _LEAST, 1 / _LEAST)))


def drawn_rows(
    planned: Sequence[Planned],
    views: tuple[dict[TriangleMesh, Camera], ...],
    size: tuple[int, int],
    report: Callable[[str, float], None],
) -> list[Row]:
    """Draw rows from two sides; ``report`` is called with each and the share that is behind."""
    rows = []
    for number, row in enumerate(planned):
        report(f"drawing {row.title}", number / len(planned))
        sheet, sizes = Sheet((row.panels,)), [size] * len(row.panels)
        front, back = (panel_pictures(sheet, sizes, row.ranges, view) for view in views)
        drawings = (
            Drawing(panel.label, (_on_white(one), _on_white(other)))
            for panel, one, other in zip(row.panels, front, back, strict=True)
        )
        bars = []
        for title, colors in row.ranges.items():
            shades = np.round(255 * table(colors.colormap, 256)).astype(np.uint8)
            bars.append(Bar(title, colors.low, colors.high, Image.fromarray(shades[None])))
        rows.append(Row(row.title, tuple(drawings), tuple(bars)))
    return rows


def _on_white(picture: Image.Image) -> Image.Image:
    ground = Image.new("RGB", picture.size, "white")
    ground.paste(picture, (0, 0), picture)
    return ground


def _functions(found: Registration) -> list[Planned]:
    match, rows = found.match, []
    if match.problem.is_of_landmarks:
        return []
    on_a, counted = functions_on_a(found), counts(match)
    channels = zip(on_a.T, match.source.T, match.advected.T, match.target.T, strict=True)
    is_one_surface = found.a is found.b
    for c, (own, before, after, target) in enumerate(channels):
        if c == MOST_CHANNELS:
            break
        bar, off = f"function {c + 1}", f"difference {c + 1}"
        colors = compared_colors(match, c)
        half = (colors.high - colors.low) / 2
        ranges = {bar: colors, off: ColorRange("abfm diverging", -half, half)}
        of_a = Panel(found.a, Values(own, bar), "A")
        names = ("source", "carried") if is_one_surface else ("A on B, at first", "registered")
        others = (
            Panel(found.b, Values(before, bar), names[0]),
            Panel(found.b, Values(after, bar), names[1]),
            Panel(found.b, Values(target, bar), "target" if is_one_surface else "B"),
            Panel(found.b, Values(counted * (after - target), off), "difference"),
        )
        panels = others if is_one_surface else (of_a, *others)
        rows.append(Planned(bar, panels, ranges))
    return rows


def _map(found: Correspondence, distortion: Distortion, front: Front) -> Planned:
    """Plan a checkerboard, straight as A is seen from the front, where it goes on B, and what the
    map does to B's faces.
    """
    places = found.a.vertices @ front.axes[:2].T
    low, extent = places.min(axis=0), np.ptp(places, axis=0).max()
    board = (places - low) * (0.5 * _FIELDS / extent)
    boards = [(found.a, board, "A")]
    if not isinstance(found, Registration):
        boards.append((found.b, found.carry(board), "on B"))
    elif found.a is found.b:
        boards = [(found.a, board, "at first"), (found.b, found.carry(board), "carried")]
    else:
        boards.append((found.b, found.initial.carry(board), "on B, at first"))
        boards.append((found.b, found.carry(board), "on B, registered"))
    panels = [Panel(mesh, Checker(each), title) for mesh, each, title in boards]
    values = (("areas: log2 J", distortion.area), ("shapes: log2 R", distortion.conformal))
    panels += [Panel(found.b, Values(log2_of(each), _LOG2), title) for title, each in values]
    most = max(distortion.log2_area.p98, distortion.log2_shape.p98)
    end = max(math.ceil(2 * most) / 2, _LEAST_RANGE)
    return Planned("the map", tuple(panels), {_LOG2: ColorRange("abfm diverging", -end, end)})


def _histograms(distortion: Distortion, width: int) -> tuple[Image.Image, Image.Image]:
    size, areas = _plot_size(width), distortion.weights
    area, shape = distortion.log2_area, distortion.log2_shape
    of_areas = histogram_picture(
        log2_of(distortion.area),
        areas,
        {"95%": (-area.p95, area.p95), "98%": (-area.p98, area.p98)},
        "areas, log2 J",
        size,
    )
    marks = {"95%": (shape.p95,), "98%": (shape.p98,)}
    shapes = log2_of(distortion.conformal)
    return of_areas, histogram_picture(shapes, areas, marks, "shapes, log2 R", size)


def _path(match: Match, width: int) -> Image.Image | None:
    cost = np.array([step.log2_area for step in match.path])
    left = np.array([_verified(step) for step in match.path])
    if np.isfinite(cost).sum() < 2 or math.isnan(cost[match.step]):
        return None
    return path_picture(cost, left, match.step, _plot_size(width))


def _verified(step: PathStep) -> float:
    """Return what a step leaves, by flow lines where that is known."""
    return step.residual if math.isnan(step.verified_residual) else step.verified_residual


def _plot_size(width: int) -> tuple[int, int]:
    return 2 * width, round(1.1 * width)


def both_sides(
    seen_from: Mapping[TriangleMesh, Front],
) -> tuple[tuple[dict[TriangleMesh, Camera], ...], float]:
    """Return cameras of surfaces before and behind them, and the aspect of all pictures."""
    free = (fitted(mesh.vertices, front).aspect for mesh, front in seen_from.items())
    aspect = min(max(*free, _ASPECTS[0]), _ASPECTS[1])
    before, behind = dict[TriangleMesh, Camera](), dict[TriangleMesh, Camera]()
    for mesh, front in seen_from.items():
        back = replace(front, direction=triple(-np.array(front.direction)))
        before[mesh] = fitted(mesh.vertices, front, aspect)
        behind[mesh] = fitted(mesh.vertices, back, aspect)
    return (before, behind), aspect
