"""Pages of sequences: frames, what is between them, and what moves on the surface."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from abfm import sequences
from abfm.calculus import face_normals
from abfm.calculus.operators import vertex_areas
from abfm.flow import flow_lines, straightest_geodesics, vectors_at
from abfm.maps import SurfacePoints, spread_points
from abfm.pages.colormaps import ColorRange, color_range
from abfm.pages.film_motion import CRITICAL_COLORS, OPACITY_MIN, fast_in, ways_of
from abfm.pages.front import best_front, changes_in_time
from abfm.pages.page import Clock, Color, Layer, Page, Panel, Span, Ways
from abfm.pages.registered import MOST_CHANNELS
from abfm.sequences.report import interval_headline, motion_text, uncertainty_text
from abfm.types import FloatArray
from abfm.wording import share
from abfm.workers.progress import stepped

VALUES_MAX = 4_000_000
"""Values in all keys of all functions; a value is two bytes of a page."""
PART_VALUES_MAX = 500_000
"""The same of a part of the field."""
_KEYS_PER_INTERVAL_MAX = 4
PLAY_SECONDS_PER_FRAME = 0.15
PLAY_SECONDS_MIN = 4.0
PLAY_SECONDS_MAX = 30.0
_TAIL_SHARE = 0.2  # of the time of all frames: how long a track stays visible behind its point
_PATH_LINES_MAX = 140
_PATH_PIECES_MAX = 15_000  # of all path lines together
_PATH_INTERVALS = 10  # after which a path line starts anew
_ARROWS_PER_INTERVAL_MAX = 480
_ARROWS_MAX = 40_000  # in all intervals
_ARROW_LENGTH_MAX = 0.92  # of the distance between two arrows
_ARROW_SPEED_MIN = 0.2  # of the speed of the longest arrow
_ARROW_COSINE_MIN = 0.6  # of the angle by which the surface turns along an arrow
_COLOR_PERCENTILE = 99.5  # at the ends of the colours
_INK: Color = (0.11, 0.13, 0.17)


@dataclass(frozen=True)
class Labels:
    """Names of channels, the unit of values and that of times, the axis that is up, and how many of
    the values and arrows that a page may have there are, up to 1.
    """

    names: Sequence[str] = ()
    unit: str = ""
    unit_of_time: str = ""
    up: str | None = None
    share: float = 1.0


def sequence_page(
    sequence: sequences.Sequence,
    title: str,
    labels: Labels | None = None,
) -> Page:
    """Return the page of a sequence: its frames and what is carried between them, what each
    interval came to, arrows of its field, path lines, critical points on their tracks, and
    divergence and curl, with a time bar over real time.
    """
    labels = labels or Labels()
    mesh, facts, times = sequence.mesh, sequence.facts, sequence.times.tolist()
    layers, notes = frame_layers(sequence, labels)
    front = best_front(mesh, up=labels.up, changes=changes_in_time(layers[0].values[:, :, None]))
    unit = f"1/{labels.unit_of_time}" if labels.unit_of_time else ""
    layers += [
        _layer(name, values, sequence.middles, unit, labels.share)
        for name, values in (("divergence", sequence.divergence), ("curl", sequence.curl))
    ]
    lines = [_path_lines(sequence)] if labels.share == 1 else []  # which are hidden at first
    ways = [_arrows(sequence, labels.share), *lines, *_tracks(sequence)]
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
    about = f"A film of {len(times)} frames on a surface of {len(mesh.vertices):,} vertices"
    panel, clock = Panel("", mesh, layers, front, ways), clock_of(times, labels, spans)
    return Page(title, facts.headline, [panel], clock, facts.tone, about, shown_facts, notes)


def frame_layers(sequence: sequences.Sequence, labels: Labels) -> tuple[list[Layer], list[str]]:
    """Return a layer of each channel of the frames, and notes.

    Of frames so many that the page would be too large one of two, three, ... is shown, and that is
    told; else, where there is room, keys are put between them.
    """
    keys, frames, thinned = _keys(sequence, labels.share)
    if sequence.unknown is not None:
        frames = np.where(sequence.unknown[:, None], np.nan, frames)
    count, given = frames.shape[2], sequence.frames.shape[2]
    usual = ["function"] if count == 1 else [f"function {c + 1}" for c in range(count)]
    layers = [
        Layer(name, frames[:, :, c], color_range(frames[:, :, c]), keys, labels.unit)
        for c, name in enumerate([*labels.names, *usual[len(labels.names) :]][:count])
    ]
    notes = [thinned] if thinned else []
    if given > count:
        notes.append(f"these are the first {count} of {given} channels")
    return layers, notes


def clock_of(times: Sequence[float], labels: Labels, spans: Sequence[Span] = ()) -> Clock:
    """Return the clock of frames at ascending times."""
    seconds = min(max(PLAY_SECONDS_PER_FRAME * len(times), PLAY_SECONDS_MIN), PLAY_SECONDS_MAX)
    return Clock(times[0], times[-1], seconds, labels.unit_of_time, ticks=times, spans=spans)


def _layer(name: str, values: FloatArray, times: FloatArray, unit: str, share: float) -> Layer:
    """Return a layer about 0 at some of the times at least, with colours that a few extremes do not
    change.
    """
    every = -(-values.size // int(share * PART_VALUES_MAX))
    shown, most = values[::every], float(np.percentile(np.abs(values), _COLOR_PERCENTILE)) or 1.0
    at = times[::every] if len(shown) > 1 else None
    return Layer(name, shown, ColorRange("abfm diverging", -most, most), at, unit)


def _speed(sequence: sequences.Sequence, labels: Labels) -> str:
    """Return the median over time of the root mean square over the surface."""
    return f"{float(np.median(sequence.speed)):.3g}, {_unit_of_speed(labels)}"


def _unit_of_speed(labels: Labels) -> str:
    unit = {"": "unit of time", "s": "second"}.get(labels.unit_of_time, labels.unit_of_time)
    return f"in the mesh's unit per {unit}"


def _tracks(sequence: sequences.Sequence) -> list[Ways]:
    kinds: dict[str, list[tuple[FloatArray, FloatArray]]] = defaultdict(list)
    for way in ways_of(sequence.tracks()):
        kinds[way.kind].append((way.times, way.points.positions))
    tail = _TAIL_SHARE * float(np.ptp(sequence.times))
    return [
        Ways.along(f"{kind}s", kinds[kind], color[:3], tail=tail)
        for kind, color in CRITICAL_COLORS.items()
        if kind in kinds
    ]


def _arrows(sequence: sequences.Sequence, share: float) -> Ways:
    """Return arrows of each interval's field about places that stay the same, no longer than these
    are apart, which fade where frames do not determine it; none where it is slow, where they would
    meet a boundary, or leave the surface.
    """
    mesh, times = sequence.mesh, sequence.times
    spread, fast = spread_points(mesh), fast_in(sequence) or 1.0
    most = max(int(share * _ARROWS_MAX) // len(sequence), 1)
    count = min(_ARROWS_PER_INTERVAL_MAX, most, len(spread.gaps))
    points, normals = spread.points[np.arange(count)], spread.normals[:count]
    longest = _ARROW_LENGTH_MAX * mesh.length_scale * min(float(spread.gaps[count - 1]), 0.2)
    normals_of_faces = face_normals(mesh)
    parts: list[tuple[FloatArray, ...]] = []
    with stepped("arrows", sequence.velocity) as fields:
        for number, velocity in enumerate(fields):
            vectors = vectors_at(mesh, velocity, points) / fast
            opacities = sequence.determined[number][points.faces]
            speed = np.linalg.norm(vectors, axis=1)
            vectors *= (longest * np.minimum(1.0, 1 / np.maximum(speed, 1e-300)))[:, None]
            seen, tips = (speed > _ARROW_SPEED_MIN) & (opacities > OPACITY_MIN), []
            for side in (-0.5, 0.5):
                found, inside = straightest_geodesics(mesh, points, side * vectors)
                turned = (normals_of_faces[found.faces] * normals).sum(axis=1)
                seen &= inside & (turned > _ARROW_COSINE_MIN)
                tips.append(found.positions)
            spans = np.broadcast_to(times[number : number + 2], (count, 2))
            parts.append(tuple(each[seen] for each in (*tips, spans, normals, opacities)))
    starts, ends, spans, *of_pieces = (np.concatenate(each) for each in zip(*parts, strict=True))
    ways = Ways("arrows", starts, ends, spans, _INK, disc=0.0, line=0.0, arrow=2.0)
    return replace(ways, normals=of_pieces[0], opacities=of_pieces[1])


def _about_arrows(sequence: sequences.Sequence, labels: Labels) -> str:
    if not (fast := fast_in(sequence)):
        return "nothing moves: there are no arrows"
    return (
        f"arrows are the field of each interval, the longest ones where it has a speed of "
        f"{fast:.3g} or more ({_unit_of_speed(labels)}), and none where it has less than "
        f"{100 * _ARROW_SPEED_MIN:.0f}% of that; they fade where the frames do not determine it"
    )


def _about_mask(sequence: sequences.Sequence) -> list[str]:
    if (unknown := sequence.unknown) is None:
        return []
    areas = vertex_areas(sequence.mesh)
    return [
        f"{share(float(areas[unknown].sum() / areas.sum()))} of the surface has no value or no "
        "weight, is not compared, and is grey"
    ]


def _path_lines(sequence: sequences.Sequence) -> Ways:
    """Return path lines from places spread over the surface; each begins anew after a while, not
    all at once.
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
            here = SurfacePoints(mesh, faces, barycentric)
            # a fifth of the time that the continuous flow takes, which has more to prepare
            lines = flow_lines(mesh, velocity, here, end - begin)
            starts.append(here.positions)
            ends.append(np.array([line.positions[-1] for line in lines]))
            spans.append(np.tile([begin, end], (len(ages), 1)))
            ages = ages + 1
            is_old = ages % _PATH_INTERVALS == 0
            faces = np.where(is_old, seeds.faces, [line.faces[-1] for line in lines])
            last = np.array([line.barycentric[-1] for line in lines])
            barycentric = np.where(is_old[:, None], seeds.barycentric, last)
    tail = _PATH_INTERVALS / 2 * float(np.ptp(times)) / len(sequence)
    pieces = np.concatenate(starts), np.concatenate(ends), np.concatenate(spans)
    return Ways(
        "path lines", *pieces, _INK, tail=tail, disc=2.2, line=1.6, opacity=0.75, shown=False
    )


def _keys(sequence: sequences.Sequence, share: float) -> tuple[FloatArray, FloatArray, str]:
    """Return times and values (T', V, C) of the page, and what is to be said of them."""
    times, frames = sequence.times, sequence.frames[:, :, :MOST_CHANNELS]
    most = max(int(share * VALUES_MAX) // (frames.shape[1] * frames.shape[2]), 2)
    if most < len(times):
        every = -(-(len(times) - 1) // (most - 1))
        chosen = np.unique([*range(0, len(times), every), len(times) - 1])
        return (
            times[chosen],
            frames[chosen],
            f"one of {every} frames is shown, {len(chosen)} in all",
        )
    between = min(max((most - 1) // max(len(times) - 1, 1), 1), _KEYS_PER_INTERVAL_MAX)
    keys, values = [times[0]], [frames[0]]
    with stepped("carrying frames", [*pairwise(times)]) as pairs:
        for number, (start, end) in enumerate(pairs, 1):
            for part in range(1, between):
                keys.append(start + part / between * (end - start))
                carried = sequence.at(float(keys[-1]))
                values.append(carried.reshape(frames.shape[1], -1)[:, :MOST_CHANNELS])
            keys.append(end)
            values.append(frames[number])
    return np.array(keys), np.stack(values), ""
