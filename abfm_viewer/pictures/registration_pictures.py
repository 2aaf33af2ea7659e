"""Pictures of a registration: functions, the map as a checkerboard, and distortions."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from PIL import Image

from abfm import Correspondence, Match, Registration
from abfm.display import BEST_VIEW, ViewSpec
from abfm.io.sheets import Checker, Panel
from abfm.maps import Distortion
from abfm.pages import registration_views
from abfm.pages.color_ranges import color_range
from abfm.pages.colormaps import ColorRange
from abfm.pages.front import Front
from abfm.types import FloatArray
from abfm_viewer.pictures.plots import histogram_picture, path_picture
from abfm_viewer.pictures.rows import Row, draw_rows, panels_of

_LOG2 = "log2 J and log2 R"
_ON_B = ("A on B, initial map", "registered", "B")
_SQUARES = 16  # of the checkerboard, along the larger side of A
_STRETCH_MIN = 1e-6  # smaller stretches count as this, as in `Distortion.log2_area`
_RANGE_MIN = 0.5  # smallest end of the colours of log2 J and log2 R


@dataclass(frozen=True, eq=False)
class RegistrationPictures:
    functions: tuple[Row, ...]  # one row for each channel; empty for a map
    map: Row  # a checkerboard on A and on B, and the distortion of areas and shapes on B
    histograms: tuple[Image.Image, Image.Image]  # of areas and shapes
    path: Image.Image | None  # if several steps of the match have a known distortion


def registration_pictures(
    found: Correspondence,
    distortion: Distortion,
    width: int,
    view: ViewSpec = BEST_VIEW,
    report: Callable[[str, float], None] = lambda text, share: None,
) -> RegistrationPictures:
    """Return the pictures of a registration, or of a map without functions.

    ``width`` is in pixels, ``distortion`` is that of the map. ``report`` is called with the name of
    the next picture and the completed share, 0 to 1. Raises `DrawingError` if the machine cannot
    draw.
    """
    front_of_a, front_of_b = registration_views.fronts(found, view)
    front_of = {found.a: front_of_a, found.b: front_of_b}
    functions = _functions(found) if isinstance(found, Registration) else []
    planned = [*functions, _map(found, distortion, front_of[found.a])]
    rows = draw_rows(planned, front_of, width, report)
    report("drawing plots", 1.0)
    path = _path(found.match, width) if isinstance(found, Registration) else None
    return RegistrationPictures(tuple(rows[:-1]), rows[-1], _histograms(distortion, width), path)


def log2_of(ratios: FloatArray) -> FloatArray:
    """Return base-2 logarithms of ratios (F,), which are limited to 1e-6 to 1e6."""
    return np.asarray(np.log2(np.clip(ratios, _STRETCH_MIN, 1 / _STRETCH_MIN)))


def _functions(found: Registration) -> list[Row]:
    match, rows = found.match, []
    if match.problem.is_of_landmarks:
        return []
    counted, is_one_surface = registration_views.mask_indicator(match), found.a is found.b
    channels = zip(
        range(registration_views.CHANNELS_MAX),
        registration_views.functions_on_a(found).T,
        match.source.T,
        match.advected.T,
        match.target.T,
        strict=False,
    )
    names = ("source", "advected", "target") if is_one_surface else _ON_B
    for c, on_a, *on_b in channels:
        bar, difference = f"function {c + 1}", f"difference {c + 1}"
        colors = registration_views.common_colors(match, c)
        half = (colors.high - colors.low) / 2
        _, after, target = on_b
        panels = (
            *(() if is_one_surface else panels_of(found.a, bar, {"A": on_a})),
            *panels_of(found.b, bar, dict(zip(names, on_b, strict=True))),
            *panels_of(found.b, difference, {"difference": counted * (after - target)}),
        )
        ranges = {bar: colors, difference: ColorRange("abfm diverging", -half, half)}
        rows.append(Row(bar, panels, ranges))
    return rows


def _map(found: Correspondence, distortion: Distortion, front: Front) -> Row:
    """Return pictures of the map: a checkerboard on A, its image on B, and the distortion on B."""
    places = found.a.vertices @ front.axes[:2].T
    low, extent = places.min(axis=0), np.ptp(places, axis=0).max()
    board = (places - low) * (0.5 * _SQUARES / extent)
    boards = [(found.a, board, "A")]
    if not isinstance(found, Registration):
        boards.append((found.b, found.transfer(board), "on B"))
    elif found.a is found.b:
        boards = [(found.a, board, "before the flow"), (found.b, found.transfer(board), "advected")]
    else:
        boards.append((found.b, found.initial.transfer(board), "on B, initial map"))
        boards.append((found.b, found.transfer(board), "on B, registered"))
    panels = [Panel(mesh, Checker(each), title) for mesh, each, title in boards]
    ratios = {"areas: log2 J": distortion.area, "shapes: log2 R": distortion.conformal}
    logs = {title: log2_of(each) for title, each in ratios.items()}
    changes = panels_of(found.b, _LOG2, logs)
    colors = color_range(
        *logs.values(), areas=distortion.weights, quantity="signed", end_min=_RANGE_MIN
    )
    return Row("the map", (*panels, *changes), {_LOG2: colors})


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
    lines = {"95%": (shape.p95,), "98%": (shape.p98,)}
    shapes = log2_of(distortion.conformal)
    return of_areas, histogram_picture(shapes, areas, lines, "shapes, log2 R", size)


def _path(match: Match, width: int) -> Image.Image | None:
    area_change = np.array([step.log2_area for step in match.path])
    # along flow lines, or else by the discrete flow
    both = np.array([(step.verified_residual, step.residual) for step in match.path])
    residuals = np.where(np.isnan(both[:, 0]), both[:, 1], both[:, 0])
    if np.isfinite(area_change).sum() < 2 or math.isnan(area_change[match.step]):
        return None
    return path_picture(area_change, residuals, match.step, _plot_size(width))


def _plot_size(width: int) -> tuple[int, int]:
    return 2 * width, round(1.1 * width)
