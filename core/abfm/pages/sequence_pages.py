"""Pages of sequences: frames, interpolated frames, and motion on the surface."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from abfm import sequences
from abfm.calculus import face_normals
from abfm.calculus.operators import vertex_areas
from abfm.display import BEST_VIEW, ViewSpec
from abfm.flow import flow_lines, straightest_geodesics, vectors_at
from abfm.maps import SurfacePoints, spread_points
from abfm.pages.color_ranges import color_range
from abfm.pages.front import changes_in_time, front_of
from abfm.pages.page import Clock, Color, Layer, Page, Panel, Paths, Span
from abfm.pages.registration_views import CHANNELS_MAX
from abfm.pages.sequence_motion import CRITICAL_COLORS, OPACITY_MIN, fast_speed_of, track_paths
from abfm.sequences.report import interval_headline, motion_text, uncertainty_text
from abfm.types import FloatArray
from abfm.wording import share
from abfm.workers.progress import stepped

VALUES_MAX = 4_000_000
"""Maximum number of values in all key frames of all functions; each takes two bytes."""
PART_VALUES_MAX = 500_000  # maximum number of values of divergence or of curl
_KEYS_PER_INTERVAL_MAX = 4
PLAY_SECONDS_PER_FRAME = 0.15
PLAY_SECONDS_MIN = 4.0
PLAY_SECONDS_MAX = 30.0
_TAIL_SHARE = 0.2  # a track stays visible behind its point for this share of the duration
_PATH_LINES_MAX = 140
_PATH_PIECES_MAX = 15_000  # pieces of all path lines together
_PATH_INTERVALS = 10  # number of intervals after which a path line begins again at its first point
_ARROWS_PER_INTERVAL_MAX = 480
_ARROWS_MAX = 40_000  # number of arrows in all intervals together
_ARROW_LENGTH_MAX = 0.92  # largest length of an arrow, relative to the distance between two arrows
_ARROW_SPEED_MIN = 0.2  # smallest drawn speed, relative to that of the longest arrow
_ARROW_COSINE_MIN = 0.6  # smallest cosine of the angle between the surface normals along an arrow
_INK_COLOR: Color = (0.11, 0.13, 0.17)


@dataclass(frozen=True)
class Labels:
    """Names and units of a page of a sequence.

    Attributes
    ----------
    names : sequence of str
        Names of the channels.
    unit, unit_of_time : str
        Unit of values and of times.
    view : ViewSpec
        Side from which the surface is shown.
    share : float
        Fraction of the maximum number of values and arrows, up to 1.
    """

    names: Sequence[str] = ()
    unit: str = ""
    unit_of_time: str = ""
    view: ViewSpec = BEST_VIEW
    share: float = 1.0


def sequence_page(sequence: sequences.Sequence, title: str, labels: Labels | None = None) -> Page:
    """Return the page of a sequence, with a time bar.

    The page shows frames and interpolated frames, arrows of the field, path lines, critical points
    with tracks, divergence and curl. The time bar has the result of each interval.
    """
    labels = labels or Labels()
    mesh, facts, times = sequence.mesh, sequence.facts, sequence.times.tolist()
    layers, notes = frame_layers(sequence, labels)
    front = front_of(mesh, view=labels.view, changes=changes_in_time(layers[0].values[:, :, None]))
    unit = f"1/{labels.unit_of_time}" if labels.unit_of_time else ""
    layers += [
        _layer(sequence, name, values, unit, labels.share)
        for name, values in (("divergence", sequence.divergence), ("curl", sequence.curl))
    ]
    lines = [_path_lines(sequence)] if labels.share == 1 else []  # path lines are initially hidden
    paths = [_arrows(sequence, labels.share), *lines, *_tracks(sequence)]
    spans = [
        Span(start, end, f"interval {i + 1}: {interval_headline(sequence, i)}", verdict.kind.tone)
        for i, ((start, end), verdict) in enumerate(
            zip(pairwise(times), sequence.verdicts, strict=True)
        )
    ]
    shown_facts = {
        "median speed": _speed(sequence, labels),
        **({"uncertainty": uncertainty_text(sequence)} if sequence.solved.any() else {}),
        "frames in between": motion_text(sequence),
        "solved with": sequence.settings,
    }
    notes += [
        *([] if facts.tone == "good" else [facts.reason]),
        _about_arrows(sequence, labels),
        *_about_mask(sequence),
        *sequence.notes,
    ]
    about = f"A sequence of {len(times)} frames on a surface of {len(mesh.vertices):,} vertices"
    panel, clock = Panel("", mesh, layers, front, paths), clock_of(times, labels, spans)
    return Page(
        title, facts.headline, [panel], clock, facts.tone, about, shown_facts, notes, facts.topics
    )


def frame_layers(sequence: sequences.Sequence, labels: Labels) -> tuple[list[Layer], list[str]]:
    """Return a layer for each channel of the frames, and notes about omitted frames and channels.

    If there are too many frames for a page, they are subsampled. Otherwise interpolated frames are
    added between them, as far as the size of the page allows.
    """
    keys, frames, subsampling = _keys(sequence, labels.share)
    if sequence.unknown is not None:
        frames = np.where(sequence.unknown[:, None], np.nan, frames)
    areas = vertex_areas(sequence.mesh)
    count, given = frames.shape[2], sequence.frames.shape[2]
    default_names = ["function"] if count == 1 else [f"function {c + 1}" for c in range(count)]
    layers = [
        Layer(name, frames[:, :, c], color_range(frames[:, :, c], areas=areas), keys, labels.unit)
        for c, name in enumerate([*labels.names, *default_names[len(labels.names) :]][:count])
    ]
    notes = [subsampling] if subsampling else []
    if given > count:
        notes.append(f"the page shows the first {count} of {given} channels")
    return layers, notes


def clock_of(times: Sequence[float], labels: Labels, spans: Sequence[Span] = ()) -> Clock:
    seconds = min(max(PLAY_SECONDS_PER_FRAME * len(times), PLAY_SECONDS_MIN), PLAY_SECONDS_MAX)
    return Clock(times[0], times[-1], seconds, labels.unit_of_time, ticks=times, spans=spans)


def _layer(
    sequence: sequences.Sequence, name: str, values: FloatArray, unit: str, share: float
) -> Layer:
    """Return a layer of values in the middles of intervals, with a range symmetric about 0.

    It is subsampled in time if it exceeds ``share`` of the maximum number of values.
    """
    colors = color_range(values, areas=vertex_areas(sequence.mesh), quantity="signed")
    stride = -(-values.size // int(share * PART_VALUES_MAX))
    at = sequence.middles[::stride] if len(values) > stride else None
    return Layer(name, values[::stride], colors, at, unit)


def _speed(sequence: sequences.Sequence, labels: Labels) -> str:
    """Return the speed as text: the median over time of the root mean square over the surface."""
    return f"{float(np.median(sequence.speed)):.3g}, {_unit_of_speed(labels)}"


def _unit_of_speed(labels: Labels) -> str:
    unit = {"": "unit of time", "s": "second"}.get(labels.unit_of_time, labels.unit_of_time)
    return f"in the mesh's unit per {unit}"


def _tracks(sequence: sequences.Sequence) -> list[Paths]:
    kinds: dict[str, list[tuple[FloatArray, FloatArray]]] = defaultdict(list)
    for track in track_paths(sequence.tracks()):
        kinds[track.kind].append((track.times, track.points.positions))
    tail = _TAIL_SHARE * float(np.ptp(sequence.times))
    return [
        Paths.along(f"{kind}s", kinds[kind], color[:3], tail=tail)
        for kind, color in CRITICAL_COLORS.items()
        if kind in kinds
    ]


def _arrows(sequence: sequences.Sequence, share: float) -> Paths:
    """Return arrows of each interval's field at fixed points.

    The length is limited by the distance between the points. Arrows fade where frames do not
    determine the field. They are omitted where the field is slow, at boundaries, and where they
    would leave the surface.
    """
    mesh, times = sequence.mesh, sequence.times
    spread, fast = spread_points(mesh), fast_speed_of(sequence) or 1.0
    arrows_max = max(int(share * _ARROWS_MAX) // len(sequence), 1)
    count = min(_ARROWS_PER_INTERVAL_MAX, arrows_max, len(spread.gaps))
    points, normals = spread.points[np.arange(count)], spread.normals[:count]
    length_max = _ARROW_LENGTH_MAX * mesh.length_scale * min(float(spread.gaps[count - 1]), 0.2)
    normals_of_faces = face_normals(mesh)
    parts: list[tuple[FloatArray, ...]] = []
    with stepped("arrows", sequence.velocity) as fields:
        for number, velocity in enumerate(fields):
            vectors = vectors_at(mesh, velocity, points) / fast
            opacities = sequence.determined[number][points.faces]
            speed = np.linalg.norm(vectors, axis=1)
            vectors *= (length_max * np.minimum(1.0, 1 / np.maximum(speed, 1e-300)))[:, None]
            is_visible, tips = (speed > _ARROW_SPEED_MIN) & (opacities > OPACITY_MIN), []
            for side in (-0.5, 0.5):
                found, inside = straightest_geodesics(mesh, points, side * vectors)
                cosines = (normals_of_faces[found.faces] * normals).sum(axis=1)
                is_visible &= inside & (cosines > _ARROW_COSINE_MIN)
                tips.append(found.positions)
            spans = np.broadcast_to(times[number : number + 2], (count, 2))
            parts.append(tuple(each[is_visible] for each in (*tips, spans, normals, opacities)))
    starts, ends, spans, *of_pieces = (np.concatenate(each) for each in zip(*parts, strict=True))
    paths = Paths("arrows", starts, ends, spans, _INK_COLOR, disc=0.0, line=0.0, arrow=2.0)
    return replace(paths, normals=of_pieces[0], opacities=of_pieces[1])


def _about_arrows(sequence: sequences.Sequence, labels: Labels) -> str:
    if not (fast := fast_speed_of(sequence)):
        return "the field is zero, so there are no arrows"
    return (
        f"arrows show the field of each interval. They have their maximum length at a speed of "
        f"{fast:.3g} ({_unit_of_speed(labels)}) or more, and are omitted below "
        f"{100 * _ARROW_SPEED_MIN:.0f}% of this speed. They fade where the frames do not "
        "determine the field"
    )


def _about_mask(sequence: sequences.Sequence) -> list[str]:
    if (unknown := sequence.unknown) is None:
        return []
    areas = vertex_areas(sequence.mesh)
    return [
        f"{share(float(areas[unknown].sum() / areas.sum()))} of the surface has no value or weight "
        "0; it is not compared, and it is grey"
    ]


def _path_lines(sequence: sequences.Sequence) -> Paths:
    """Return path lines from points distributed over the surface.

    After `_PATH_INTERVALS` intervals, a line restarts at its first point. Different lines restart
    at different times.
    """
    mesh, times = sequence.mesh, sequence.times
    count = min(_PATH_LINES_MAX, _PATH_PIECES_MAX // len(sequence))
    spread = spread_points(mesh)
    seeds = spread.points[np.arange(min(count, len(spread.gaps)))]
    ages = np.arange(len(seeds.faces)) % _PATH_INTERVALS
    faces, barycentric = seeds.faces, seeds.barycentric
    starts, ends, spans = [], [], []
    intervals = list(zip(sequence.velocity, pairwise(times), strict=True))
    with stepped("path lines", intervals) as counted_intervals:
        for velocity, (begin, end) in counted_intervals:
            points = SurfacePoints(mesh, faces, barycentric)
            # takes a fifth of the time of the continuous flow, which needs more preparation
            lines = flow_lines(mesh, velocity, points, end - begin)
            starts.append(points.positions)
            ends.append(np.array([line.positions[-1] for line in lines]))
            spans.append(np.tile([begin, end], (len(ages), 1)))
            ages = ages + 1
            is_old = ages % _PATH_INTERVALS == 0
            faces = np.where(is_old, seeds.faces, [line.faces[-1] for line in lines])
            last = np.array([line.barycentric[-1] for line in lines])
            barycentric = np.where(is_old[:, None], seeds.barycentric, last)
    tail = _PATH_INTERVALS / 2 * float(np.ptp(times)) / len(sequence)
    pieces = np.concatenate(starts), np.concatenate(ends), np.concatenate(spans)
    return Paths(
        "path lines", *pieces, _INK_COLOR, tail=tail, disc=2.2, line=1.6, opacity=0.75, shown=False
    )


def _keys(sequence: sequences.Sequence, share: float) -> tuple[FloatArray, FloatArray, str]:
    """Return times and values (T', V, C) of the frames that the page stores, and a note.

    If there are too many frames, the note reports which are stored. Otherwise interpolated frames
    are added, and the note is empty.
    """
    times, frames = sequence.times, sequence.frames[:, :, :CHANNELS_MAX]
    keys_max = max(int(share * VALUES_MAX) // (frames.shape[1] * frames.shape[2]), 2)
    if keys_max < len(times):
        stride = -(-(len(times) - 1) // (keys_max - 1))
        chosen = np.unique([*range(0, len(times), stride), len(times) - 1])
        note = f"the page shows one of {stride} frames, {len(chosen)} in total"
        return times[chosen], frames[chosen], note
    between = min(max((keys_max - 1) // max(len(times) - 1, 1), 1), _KEYS_PER_INTERVAL_MAX)
    keys, values = [times[0]], [frames[0]]
    with stepped("interpolating frames", [*pairwise(times)]) as pairs:
        for number, (start, end) in enumerate(pairs, 1):
            for part in range(1, between):
                keys.append(start + part / between * (end - start))
                interpolated = sequence.at(float(keys[-1]))
                values.append(interpolated.reshape(frames.shape[1], -1)[:, :CHANNELS_MAX])
            keys.append(end)
            values.append(frames[number])
    return np.array(keys), np.stack(values), ""
