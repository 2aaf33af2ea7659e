"""Pages of matches, registrations, maps between surfaces, and populations."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from abfm.errors import AbfmError, one_line
from abfm.flow import flow_lines
from abfm.maps import SurfacePoints, spread_points
from abfm.matching import Match
from abfm.mesh import TriangleMesh
from abfm.outcome import Facts
from abfm.pages.colormaps import ColorRange, color_range, typical_range, without_extremes
from abfm.pages.front import best_front
from abfm.pages.page import Clock, Color, Layer, Page, Panel, Ways
from abfm.pages.registered import (
    MOST_CHANNELS,
    compared_colors,
    fronts,
    functions_on_a,
)
from abfm.population import Population
from abfm.registration import Correspondence, Registration
from abfm.types import FloatArray
from abfm.wording import capital, share
from abfm.workers.progress import step

_FRAMES = 7, 41  # fewest and most keys of what is carried
_MOST_VALUES = 3_000_000  # in all keys of all functions: about as many bytes of a page
_SECONDS = 4.0
# flow lines, keys of each, and how long in sqrt(area)
_LINES_MAX = 160
_KEYS_PER_LINE = 16
_LINE_LENGTH_MIN = 0.02
_INK: Color = (0.11, 0.13, 0.17)
_MARK: Color = (0.04, 0.56, 0.42)
_TARGET_COLOR: Color = (0.7, 0.12, 0.12)
_OF_MAP = "log2_area", "folded"
_ALL_TIMES = (-1e30, 1e30)
_NAME_LENGTH_MAX = 60  # characters of a channel


def match_page(match: Match, title: str, up: str | None = None, share: float = 1.0) -> Page:
    """Return the page of a match: its source, the source on its way, its target; ``up`` is the axis
    that points upwards, by default as in `best_front`, and ``share`` is the share of the largest
    number of values and lines, up to 1.
    """
    functions = () if match.problem.is_of_landmarks else (match.source[:, 0], match.target[:, 0])
    front = best_front(match.mesh, *functions, up=up)
    shown = _functions(match)
    moving = _moving(match, shown, share)
    still = [(match.source, "source", 0), (match.target, "target", 1)]
    if match.problem.is_of_landmarks:
        still = [(match.mesh.vertices, "at first", 0)]
    first, *last = (
        Panel(
            name,
            match.mesh,
            [Layer(each, values[:, c], colors) for c, (each, colors) in enumerate(shown)],
            front,
            _marks(match, side),
        )
        for values, name, side in still
    )
    carried = Panel("carried", match.mesh, moving, front, _lines(match, share))
    about = f"A match on a surface of {_sized(match.mesh)}"
    return _page(match, title, about, [first, carried, *last])


def registration_page(
    found: Registration, title: str, up: str | None = None, share: float = 1.0
) -> Page:
    """Return the page of a registration: A with its function, that on its way on B, and B's own;
    ``up`` is the axis of both that points upwards.
    """
    match = found.match
    if found.a is found.b:
        return match_page(match, title, up, share)
    of_a, of_b = fronts(found, up)
    shown = _functions(match, found.a)
    of_landmarks = match.problem.is_of_landmarks
    on_a = found.a.vertices if of_landmarks else functions_on_a(found)
    layers_of_a = [Layer(name, on_a[:, c], colors) for c, (name, colors) in enumerate(shown)]
    start = found.initial.transfer(on_a) if of_landmarks else None
    moving = _moving(match, shown, share, start)
    carried = Panel("A on B", found.b, moving, of_b, _lines(match, share))
    marks_on_a = _marks_on_a(found)
    panels = [Panel("A", found.a, layers_of_a, of_a, marks_on_a), carried]
    if not of_landmarks:
        own = [Layer(name, match.target[:, c], colors) for c, (name, colors) in enumerate(shown)]
        panels.append(Panel("B", found.b, own, of_b, _marks(match, 1)))
    about = f"Surface A, {_sized(found.a)}, registered to surface B, {_sized(found.b)}"
    page = _page(found, title, about, panels)
    facts = {**page.facts, "A covered": f"{100 * found.coverage():.3g}%"}
    return replace(page, facts=facts, notes=[*page.notes, *found.notes])


def correspondence_page(found: Correspondence, title: str, up: str | None = None) -> Page:
    """Return the page of a map: A with its coordinates, and B with those that come from A; with the
    facts of the map if it has any.
    """
    coordinates, carried = found.a.vertices, found.transfer(found.a.vertices)
    colors = [color_range(values) for values in coordinates.T]
    sides = zip(
        ("A", "A on B"), (found.a, found.b), (coordinates, carried), fronts(found, up), strict=True
    )
    panels = [
        Panel(
            name,
            mesh,
            [Layer(f"{axis} of A", values[:, c], colors[c]) for c, axis in enumerate("xyz")],
            front,
        )
        for name, mesh, values, front in sides
    ]
    distortion = found.distortion()
    facts = {
        "areas: |log2 J|, mean": f"{distortion.log2_area.mean:.2f}",
        "folded faces": f"{distortion.folded:,} of {len(distortion.flipped):,}",
        "A covered": f"{100 * found.coverage():.3g}%",
    }
    sizes = correspondence_headline(found)
    reported: Facts | None = getattr(found, "facts", None)
    if reported is None:
        return Page(title, sizes, panels, facts=facts)
    tone, notes = reported.tone, reported.notes
    return Page(title, reported.headline, panels, None, tone, capital(sizes), facts, notes)


def correspondence_headline(found: Correspondence) -> str:
    """Return the surfaces of a map and their sizes."""
    return f"surface A, {_sized(found.a)}, and surface B, {_sized(found.b)}"


def population_page(found: Population, title: str, up: str | None = None) -> Page:
    """Return the page of a population: its means by the initial maps and registered, and the
    deviation, on the template; ``up`` is the axis that points upwards.
    """
    front = best_front(found.template, up=up)
    titles = "mean by the initial maps", "mean", "deviation"
    layers = list(
        zip(
            *(_layers(found, c) for c in range(min(len(found.channels), MOST_CHANNELS))),
            strict=True,
        )
    )
    panels = [
        Panel(name, found.template, of_channels, front)
        for name, of_channels in zip(titles, layers, strict=True)
    ]
    notes = []
    if (count := len(found.channels)) > MOST_CHANNELS:
        notes.append(f"these are the first {MOST_CHANNELS} of {count} channels")
    facts = found.facts
    return Page(title, facts.headline, panels, tone=facts.tone, notes=[*facts.notes, *notes])


def _layers(found: Population, c: int) -> list[Layer]:
    """Return the two means of a channel, in one range of colours, and its deviation."""
    means, deviation = (found.plain_mean(c), found.mean(c)), found.deviation(c)
    name = one_line(found.channels[c].name, _NAME_LENGTH_MAX)
    of_means = typical_range(*means)
    largest = max(without_extremes(deviation), default=0.0)
    of_deviation = ColorRange("abfm sequential", 0.0, float(largest) or 1.0)
    return [
        *(Layer(name, each, of_means) for each in means),
        Layer(name, deviation, of_deviation),
    ]


def _functions(match: Match, a: TriangleMesh | None = None) -> list[tuple[str, ColorRange]]:
    """Return what is shown, by name and colours; of landmarks alone the coordinates of ``a``."""
    if match.problem.is_of_landmarks:
        mesh = a or match.mesh
        return [
            (f"{axis} of A" if a else axis, color_range(values))
            for axis, values in zip("xyz", mesh.vertices.T, strict=True)
        ]
    count = min(match.source.shape[1], MOST_CHANNELS)
    names = ["function"] if count == 1 else [f"function {c + 1}" for c in range(count)]
    if a is None:
        pairs = zip(match.source.T, match.target.T, strict=True)
        colors = [color_range(*pair) for pair in pairs]
    else:
        colors = [compared_colors(match, c) for c in range(count)]
    return list(zip(names, colors, strict=False))


def _moving(
    match: Match,
    shown: list[tuple[str, ColorRange]],
    share: float,
    start: FloatArray | None = None,
) -> list[Layer]:
    """Return what is carried, at even times from 0 to tau; of landmarks alone what is given."""
    budget = int(share * _MOST_VALUES) // (len(match.mesh.vertices) * len(shown))
    times = np.linspace(0, match.parameters.tau, min(max(budget, _FRAMES[0]), _FRAMES[1]))
    with step("carrying along the flow"):
        if match.problem.is_of_landmarks:
            carried = match.push(match.mesh.vertices if start is None else start, times)
        else:
            carried = match.advect(times)
    frames = carried.reshape(len(times), len(match.mesh.vertices), -1)
    return [Layer(name, frames[:, :, c], colors, times) for c, (name, colors) in enumerate(shown)]


def _lines(match: Match, share: float) -> list[Ways]:
    """Return flow lines from places spread over the surface, and from the landmarks."""
    mesh, tau = match.mesh, match.parameters.tau
    spread = spread_points(mesh)
    seeds = spread.points[np.arange(min(int(_LINES_MAX * share**0.5), len(spread.gaps)))]
    paths = _walked(match, seeds)
    least = _LINE_LENGTH_MIN * mesh.length_scale
    far = [each for each in paths if np.linalg.norm(np.diff(each[1], axis=0), axis=1).sum() > least]
    look = {"tail": tau / 3, "disc": 2.2, "line": 1.6, "opacity": 0.75}
    ways = [Ways.along("flow lines", far, _INK, **look)] if far else []
    if (marks := match.problem.landmarks) is not None:
        ways.append(Ways.along("landmarks", _walked(match, marks.points(mesh)), _MARK))
        ways += [replace(each, disc=3.0) for each in _marks(match, 1)]
    return ways


def _walked(match: Match, seeds: SurfacePoints) -> list[tuple[FloatArray, FloatArray]]:
    """Return times and places of flow lines at even times; of one that ends early, until then."""
    tau = match.parameters.tau
    found, lines = [], []
    with step("flow lines"), suppress(AbfmError):  # those that lead over too many faces
        lines = flow_lines(match.mesh, match.fine_velocity, seeds, tau, tau)
    for line in lines:
        times = np.linspace(0, tau, _KEYS_PER_LINE)
        places = [np.interp(times, line.times, line.positions[:, x]) for x in range(3)]
        found.append((times, np.stack(places, axis=1)))
    return found


def _marks(match: Match, side: int) -> list[Ways]:
    marks = match.problem.landmarks
    if marks is None:
        return []
    if side == 0:
        return [Ways.points("landmarks", marks.points(match.mesh).positions, _ALL_TIMES, _MARK)]
    places = marks.targets(match.mesh).positions
    return [Ways.points("where landmarks belong", places, _ALL_TIMES, _TARGET_COLOR)]


def _marks_on_a(found: Registration) -> list[Ways]:
    marks = found.match.problem.landmarks
    if marks is None:
        return []
    places = found.initial.inverse().transfer_points(marks.points(found.b)).positions
    return [Ways.points("landmarks", places, _ALL_TIMES, _MARK)]


def _page(found: Match | Registration, title: str, about: str, panels: list[Panel]) -> Page:
    match = found.match if isinstance(found, Registration) else found
    tau = match.parameters.tau
    clock = Clock(0.0, tau, _SECONDS, first=tau, ticks=np.linspace(0, tau, 5).tolist())
    told = found.facts.notes
    if (count := match.source.shape[1]) > MOST_CHANNELS:
        told.append(f"these are the first {MOST_CHANNELS} of {count} pairs of functions")
    words = found.facts.headline, found.facts.tone
    specs = zip(*(side[:MOST_CHANNELS] for side in match.problem.specs), strict=True)
    about = "; ".join([about, *(" → ".join(pair) for pair in specs if all(pair))])
    return Page(title, words[0], panels, clock, words[1], about, _facts(match, found.facts), told)


def _facts(match: Match, facts: Facts) -> dict[str, str]:
    told = {}
    initial, residual, log2_area, folded = (
        facts.numbers[name] for name in ("initial_residual", "worse_residual", *_OF_MAP)
    )
    if not match.problem.is_of_landmarks and initial is not None and residual is not None:
        told["residual"] = f"{share(initial)} → {share(residual)}"
    if (errors := match.landmark_errors) is not None and np.isfinite(errors).all():
        told["farthest landmark"] = f"{share(float(errors.max()))} of √area"
    if log2_area is not None:
        told["areas: |log2 J|, mean"] = f"{log2_area:.2f}"
    if folded is not None:
        told["folded faces"] = f"{100 * folded:.2g}%"
    return told


def _sized(mesh: TriangleMesh) -> str:
    return f"{len(mesh.vertices):,} vertices and {len(mesh.faces):,} faces"
