"""Pictures of a registration from two opposite sides: its functions, the map itself as a
checkerboard, and what it does to areas and shapes.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from PIL import Image

from abfm import Correspondence, Match, Registration
from abfm.io.sheets import Checker, Panel, Up
from abfm.maps import Distortion
from abfm.matching import PathStep
from abfm.pages.colormaps import ColorRange
from abfm.pages.front import Front
from abfm.pages.registered import (
    MOST_CHANNELS,
    compared_colors,
    counts,
    fronts,
    functions_on_a,
)
from abfm.types import FloatArray
from abfm_viewer.pictures.plots import histogram_picture, path_picture
from abfm_viewer.pictures.rows import Row, drawn, panels_of

_LOG2 = "log2 J and log2 R"
_ON_B = ("A on B, at first", "registered", "B")
_FIELDS = 16  # of the checkerboard, along A's larger side
_STRETCH_MIN = 1e-6  # of a stretch, as `Distortion.log2_area` has it
_RANGE_MIN = 0.5  # a smaller one shows hardly any colour elsewhere


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
    done. A `DrawingError` says why the machine cannot draw.
    """
    front_of_a, front_of_b = fronts(found, up)
    seen_from = {found.a: front_of_a, found.b: front_of_b}
    functions = _functions(found) if isinstance(found, Registration) else []
    planned = [*functions, _map(found, distortion, seen_from[found.a])]
    rows = drawn(planned, seen_from, width, report)
    report("drawing plots", 1.0)
    path = _path(found.match, width) if isinstance(found, Registration) else None
    return RegistrationPictures(tuple(rows[:-1]), rows[-1], _histograms(distortion, width), path)


def log2_of(ratios: FloatArray) -> FloatArray:
    """Return logarithms to base 2 of areas or shapes (F,), those of none as of a millionth."""
    return np.asarray(np.log2(np.clip(ratios, _STRETCH_MIN, 1 / _STRETCH_MIN)))


def _functions(found: Registration) -> list[Row]:
    match, rows = found.match, []
    if match.problem.is_of_landmarks:
        return []
    counted, is_one_surface = counts(match), found.a is found.b
    channels = zip(
        range(MOST_CHANNELS),
        functions_on_a(found).T,
        match.source.T,
        match.advected.T,
        match.target.T,
        strict=False,
    )
    names = ("source", "carried", "target") if is_one_surface else _ON_B
    for c, own, *on_b in channels:
        bar, off = f"function {c + 1}", f"difference {c + 1}"
        colors = compared_colors(match, c)
        half = (colors.high - colors.low) / 2
        _, after, target = on_b
        panels = (
            *(() if is_one_surface else panels_of(found.a, bar, {"A": own})),
            *panels_of(found.b, bar, dict(zip(names, on_b, strict=True))),
            *panels_of(found.b, off, {"difference": counted * (after - target)}),
        )
        ranges = {bar: colors, off: ColorRange("abfm diverging", -half, half)}
        rows.append(Row(bar, panels, ranges))
    return rows


def _map(found: Correspondence, distortion: Distortion, front: Front) -> Row:
    """Plan a checkerboard, straight as A is seen from the front, where it goes on B, and what the
    map does to B's faces.
    """
    places = found.a.vertices @ front.axes[:2].T
    low, extent = places.min(axis=0), np.ptp(places, axis=0).max()
    board = (places - low) * (0.5 * _FIELDS / extent)
    boards = [(found.a, board, "A")]
    if not isinstance(found, Registration):
        boards.append((found.b, found.transfer(board), "on B"))
    elif found.a is found.b:
        boards = [(found.a, board, "at first"), (found.b, found.transfer(board), "carried")]
    else:
        boards.append((found.b, found.initial.transfer(board), "on B, at first"))
        boards.append((found.b, found.transfer(board), "on B, registered"))
    panels = [Panel(mesh, Checker(each), title) for mesh, each, title in boards]
    changed = {"areas: log2 J": distortion.area, "shapes: log2 R": distortion.conformal}
    logs = {title: log2_of(each) for title, each in changed.items()}
    changes = panels_of(found.b, _LOG2, logs)
    most = max(distortion.log2_area.p98, distortion.log2_shape.p98)
    end = max(math.ceil(2 * most) / 2, _RANGE_MIN)
    return Row("the map", (*panels, *changes), {_LOG2: ColorRange("abfm diverging", -end, end)})


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
