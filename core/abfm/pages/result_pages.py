"""Pages of matches, registrations, maps between surfaces, and populations."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from abfm.calculus.operators import vertex_areas
from abfm.display import BEST_VIEW, ViewSpec
from abfm.errors import AbfmError, one_line
from abfm.flow import FlowLine, flow_lines
from abfm.maps import SurfacePoints, spread_points
from abfm.matching import Match
from abfm.mesh import TriangleMesh
from abfm.outcome import Facts
from abfm.pages.color_ranges import color_range
from abfm.pages.colormaps import ColorRange
from abfm.pages.front import front_of
from abfm.pages.page import Clock, Color, Layer, Page, Panel, Paths
from abfm.pages.registration_views import CHANNELS_MAX, common_colors, fronts, functions_on_a
from abfm.population import Population
from abfm.registration import Correspondence, Registration
from abfm.types import FloatArray
from abfm.wording import capital, share
from abfm.workers.progress import step

_KEYS = 7, 41  # minimum and maximum number of key frames of advected functions
_VALUES_MAX = 3_000_000  # values in all key frames; each takes about a byte of the page
_PLAY_SECONDS = 4.0
# flow lines: number, points of each, and minimum length in sqrt(area)
_LINES_MAX = 160
_POINTS_PER_LINE = 16
_LINE_LENGTH_MIN = 0.02
_OPACITY_MIN = 0.2  # of flow lines where the data do not determine the motion
_FAINT_NOTE = "flow lines are faint where the data do not determine the motion"
_INK_COLOR: Color = (0.11, 0.13, 0.17)
_LANDMARK_COLOR: Color = (0.04, 0.56, 0.42)
_TARGET_COLOR: Color = (0.7, 0.12, 0.12)
_MAP_NUMBERS = "log2_area", "folded"
_ALL_TIMES = (-1e30, 1e30)
_NAME_LENGTH_MAX = 60  # characters of the name of a channel


def match_page(match: Match, title: str, view: ViewSpec = BEST_VIEW, share: float = 1.0) -> Page:
    """Return the page of a match: source, advected source, and target.

    Parameters
    ----------
    match : Match
    title : str
    view : ViewSpec
    share : float
        Fraction of the maximum number of values and lines, up to 1.
    """
    functions = () if match.problem.is_of_landmarks else (match.source[:, 0], match.target[:, 0])
    front = front_of(match.mesh, *functions, view=view)
    shown = _functions(match)
    moving = _moving(match, shown, share)
    fixed = [(match.source, "source", 0), (match.target, "target", 1)]
    if match.problem.is_of_landmarks:
        fixed = [(match.mesh.vertices, "initial", 0)]
    panels = []
    for values, name, side in fixed:
        layers = [Layer(each, values[:, c], colors) for c, (each, colors) in enumerate(shown)]
        panels.append(Panel(name, match.mesh, layers, front, _landmarks(match, side)))
    panels.insert(1, Panel("advected", match.mesh, moving, front, _lines(match, share)))
    about = f"A match on a surface of {_size_text(match.mesh)}"
    return _page(match, title, about, panels)


def registration_page(
    found: Registration, title: str, view: ViewSpec = BEST_VIEW, share: float = 1.0
) -> Page:
    """Return the page of a registration: A, its advected function on B, and B.

    Parameters
    ----------
    found : Registration
    title : str
    view : ViewSpec
        Of surface B; A is shown from the corresponding side.
    share : float
        Fraction of the maximum number of values and lines, up to 1.
    """
    match = found.match
    if found.a is found.b:
        return match_page(match, title, view, share)
    of_a, of_b = fronts(found, view)
    shown = _functions(match, found.a)
    of_landmarks = match.problem.is_of_landmarks
    on_a = found.a.vertices if of_landmarks else functions_on_a(found)
    layers_of_a = [Layer(name, on_a[:, c], colors) for c, (name, colors) in enumerate(shown)]
    start = found.initial.transfer(on_a) if of_landmarks else None
    moving = _moving(match, shown, share, start)
    advected = Panel("A on B", found.b, moving, of_b, _lines(match, share))
    panels = [Panel("A", found.a, layers_of_a, of_a, _landmarks_on_a(found)), advected]
    if not of_landmarks:
        target_layers = [
            Layer(name, match.target[:, c], colors) for c, (name, colors) in enumerate(shown)
        ]
        panels.append(Panel("B", found.b, target_layers, of_b, _landmarks(match, 1)))
    about = f"Surface A, {_size_text(found.a)}, registered to surface B, {_size_text(found.b)}"
    page = _page(found, title, about, panels)
    facts = {**page.facts, "A covered": f"{100 * found.coverage():.3g}%"}
    return replace(page, facts=facts, notes=[*page.notes, *found.notes])


def correspondence_page(found: Correspondence, title: str, view: ViewSpec = BEST_VIEW) -> Page:
    """Return the page of a map: A with its coordinates, and B with the transferred coordinates."""
    coordinates, transferred = found.a.vertices, found.transfer(found.a.vertices)
    colors = [color_range(values, is_full=True) for values in coordinates.T]
    sides = ("A", found.a, coordinates), ("A on B", found.b, transferred)
    panels = []
    for (name, mesh, values), front in zip(sides, fronts(found, view), strict=True):
        layers = [Layer(f"{axis} of A", values[:, c], colors[c]) for c, axis in enumerate("xyz")]
        panels.append(Panel(name, mesh, layers, front))
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
    words = reported.headline, panels, None, tone, capital(sizes), facts, notes, reported.topics
    return Page(title, *words)


def correspondence_headline(found: Correspondence) -> str:
    """Return the two surfaces of a map with their sizes."""
    return f"surface A, {_size_text(found.a)}, and surface B, {_size_text(found.b)}"


def population_page(found: Population, title: str, view: ViewSpec = BEST_VIEW) -> Page:
    """Return the page of a population: initial mean, registered mean, standard deviation."""
    front = front_of(found.template, view=view)
    titles = "initial mean", "registered mean", "standard deviation"
    facts, count = found.facts, len(found.channels)
    layers = zip(*(_layers(found, c) for c in range(min(count, CHANNELS_MAX))), strict=True)
    named = zip(titles, layers, strict=True)
    panels = [Panel(name, found.template, of_channels, front) for name, of_channels in named]
    notes = list(facts.notes)
    if count > CHANNELS_MAX:
        notes.append(f"the page shows the first {CHANNELS_MAX} of {count} channels")
    return Page(title, facts.headline, panels, tone=facts.tone, notes=notes, topics=facts.topics)


def _layers(found: Population, c: int) -> list[Layer]:
    """Return three layers of channel ``c``: initial mean, registered mean and standard deviation.

    Both means have the same range of colours.
    """
    means, deviation = (found.plain_mean(c), found.mean(c)), found.deviation(c)
    name = one_line(found.channels[c].name, _NAME_LENGTH_MAX)
    areas = vertex_areas(found.template)
    of_means = color_range(*means, areas=areas)
    of_deviation = color_range(deviation, areas=areas, quantity="magnitude")
    return [*(Layer(name, each, of_means) for each in means), Layer(name, deviation, of_deviation)]


def _functions(match: Match, a: TriangleMesh | None = None) -> list[tuple[str, ColorRange]]:
    """Return the names and colour ranges of the functions that the page of a match shows.

    If only landmarks are matched, these functions are the coordinates of ``a``, by default of the
    mesh of the match.
    """
    if match.problem.is_of_landmarks:
        mesh = a or match.mesh
        return [
            (f"{axis} of A" if a else axis, color_range(values, is_full=True))
            for axis, values in zip("xyz", mesh.vertices.T, strict=True)
        ]
    count = min(match.source.shape[1], CHANNELS_MAX)
    names = ["function"] if count == 1 else [f"function {c + 1}" for c in range(count)]
    return [(name, common_colors(match, c)) for c, name in enumerate(names)]


def _moving(
    match: Match, shown: list[tuple[str, ColorRange]], share: float, start: FloatArray | None = None
) -> list[Layer]:
    """Return layers of the advected functions at uniform times from 0 to tau.

    If only landmarks are matched, the function ``start`` is advected, by default the coordinates.
    ``shown`` are the names and colour ranges of the functions.
    """
    budget = int(share * _VALUES_MAX) // (len(match.mesh.vertices) * len(shown))
    times = np.linspace(0, match.parameters.tau, min(max(budget, _KEYS[0]), _KEYS[1]))
    with step("advecting functions"):
        if match.problem.is_of_landmarks:
            advected = match.push(match.mesh.vertices if start is None else start, times)
        else:
            advected = match.advect(times)
    frames = advected.reshape(len(times), len(match.mesh.vertices), -1)
    return [Layer(name, frames[:, :, c], colors, times) for c, (name, colors) in enumerate(shown)]


def _lines(match: Match, share: float) -> list[Paths]:
    """Return flow lines from points distributed over the surface and from the landmarks.

    Flow lines are faint where the data do not determine the motion.
    """
    mesh, tau = match.mesh, match.parameters.tau
    spread = spread_points(mesh)
    seeds = spread.points[np.arange(min(int(_LINES_MAX * share**0.5), len(spread.gaps)))]
    lines = _flow_lines(match, seeds)
    length_min = _LINE_LENGTH_MIN * mesh.length_scale
    lengths = [np.linalg.norm(np.diff(line.positions, axis=0), axis=1).sum() for line in lines]
    long_lines = [each for each, size in zip(lines, lengths, strict=True) if size > length_min]
    paths = []
    if long_lines:
        determined = np.maximum(match.determined.mean(axis=0), _OPACITY_MIN)
        shares = [determined[line.faces].mean() for line in long_lines]
        style = {"tail": tau / 3, "disc": 2.2, "line": 1.6, "opacity": 0.75}
        along = [_timed(line, tau) for line in long_lines]
        found = Paths.along("flow lines", along, _INK_COLOR, **style)
        paths.append(replace(found, opacities=np.repeat(shares, _POINTS_PER_LINE - 1)))
    if (landmarks := match.problem.landmarks) is not None:
        along = [_timed(line, tau) for line in _flow_lines(match, landmarks.points(mesh))]
        paths.append(Paths.along("landmarks", along, _LANDMARK_COLOR))
        paths += [replace(each, disc=3.0) for each in _landmarks(match, 1)]
    return paths


def _flow_lines(match: Match, seeds: SurfacePoints) -> list[FlowLine]:
    """Return the flow lines from ``seeds``; none if a line crosses too many faces."""
    tau = match.parameters.tau
    with step("flow lines"), suppress(AbfmError):  # flow lines over too many faces raise an error
        return flow_lines(match.mesh, match.fine_velocity, seeds, tau, tau)
    return []


def _timed(line: FlowLine, tau: float) -> tuple[FloatArray, FloatArray]:
    """Return uniform times up to ``tau`` and the points (N, 3) of a line, whose end may repeat."""
    times = np.linspace(0, tau, _POINTS_PER_LINE)
    places = [np.interp(times, line.times, line.positions[:, x]) for x in range(3)]
    return times, np.stack(places, axis=1)


def _landmarks(match: Match, side: int) -> list[Paths]:
    landmarks = match.problem.landmarks
    if landmarks is None:
        return []
    if side == 0:
        places = landmarks.points(match.mesh).positions
        return [Paths.points("landmarks", places, _ALL_TIMES, _LANDMARK_COLOR)]
    places = landmarks.targets(match.mesh).positions
    return [Paths.points("target landmarks", places, _ALL_TIMES, _TARGET_COLOR)]


def _landmarks_on_a(found: Registration) -> list[Paths]:
    landmarks = found.match.problem.landmarks
    if landmarks is None:
        return []
    places = found.initial.inverse().transfer_points(landmarks.points(found.b)).positions
    return [Paths.points("landmarks", places, _ALL_TIMES, _LANDMARK_COLOR)]


def _page(found: Match | Registration, title: str, about: str, panels: list[Panel]) -> Page:
    match = found.match if isinstance(found, Registration) else found
    tau = match.parameters.tau
    clock = Clock(0.0, tau, _PLAY_SECONDS, first=tau, ticks=np.linspace(0, tau, 5).tolist())
    facts = found.facts
    is_faint = any(paths.opacities is not None for panel in panels for paths in panel.paths)
    reported = [*facts.notes, *([_FAINT_NOTE] if is_faint else [])]
    if (count := match.source.shape[1]) > CHANNELS_MAX:
        reported.append(f"the page shows the first {CHANNELS_MAX} of {count} pairs of functions")
    specs = zip(*(side[:CHANNELS_MAX] for side in match.problem.specs), strict=True)
    about = "; ".join([about, *(" → ".join(pair) for pair in specs if all(pair))])
    shown = _facts(match, facts)
    return Page(
        title, facts.headline, panels, clock, facts.tone, about, shown, reported, facts.topics
    )


def _facts(match: Match, facts: Facts) -> dict[str, str]:
    reported = {}
    initial, residual, log2_area, folded = (
        facts.numbers[name] for name in ("initial_residual", "worse_residual", *_MAP_NUMBERS)
    )
    if not match.problem.is_of_landmarks and initial is not None and residual is not None:
        reported["residual"] = f"{share(initial)} → {share(residual)}"
    if (errors := match.landmark_errors) is not None and np.isfinite(errors).all():
        reported["largest landmark error"] = f"{share(float(errors.max()))} of √area"
    if log2_area is not None:
        reported["areas: |log2 J|, mean"] = f"{log2_area:.2f}"
    if folded is not None:
        reported["folded faces"] = f"{100 * folded:.2g}%"
    return reported


def _size_text(mesh: TriangleMesh) -> str:
    return f"{len(mesh.vertices):,} vertices and {len(mesh.faces):,} faces"
