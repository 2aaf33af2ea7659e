"""Pages of sequences: frames, what is between them, and what moves on the surface."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Protocol

import numpy as np

from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm.workers.control import checkpoint
from abfm.workers.progress import step
from abfm_viewer.appearance.colormaps import color_range
from abfm_viewer.computing.defaults import best_front
from abfm_viewer.computing.registered import MOST_CHANNELS
from abfm_viewer.document.verdict_words import Tone
from abfm_viewer.pages.page import Clock, Color, Layer, Page, Panel, Span, Ways

_MOST_VALUES = 6_000_000  # in all keys of all functions: less than as many bytes of a page
_MOST_BETWEEN = 4  # keys of an interval
_SECONDS_A_FRAME, _SHORTEST, _LONGEST = 0.15, 4.0, 30.0
_TAIL, _TAIL_OF_LINES = 0.2, 0.05  # of the whole time that ways are seen after
# apart from the colours of functions
_COLORS: dict[str, Color] = {
    "source": (0.95, 0.72, 0.02),
    "sink": (0.11, 0.49, 0.24),
    "spiral": (0.07, 0.09, 0.13),
    "saddle": (0.54, 0.25, 0.99),
}
_OTHER: Color = (0.11, 0.13, 0.17)


class Filmed(Protocol):
    """What a page needs of a sequence."""

    @property
    def mesh(self) -> TriangleMesh: ...

    @property
    def times(self) -> FloatArray:
        """Times of the frames, (T,)."""

    @property
    def frames(self) -> FloatArray:
        """The frames, (T, V) or (T, V, C)."""

    def at(self, t: float) -> FloatArray:
        """Return the frame at a time, (V,) or (V, C), between two frames carried from both."""


class Track(Protocol):
    """The way of something on the surface; its kind gives colour and name."""

    @property
    def times(self) -> FloatArray:
        """When it is where, (N,)."""

    @property
    def points(self) -> FloatArray:
        """Where it is, (N, 3), in the mesh's unit."""

    @property
    def kind(self) -> str: ...


@dataclass(frozen=True)
class Told:
    """What is said of a sequence: of all, of each interval with its tone, of its channels; and the
    axis that points upwards.
    """

    headline: str = ""
    tone: Tone = "ink"
    intervals: Sequence[tuple[str, Tone]] = ()
    facts: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    names: Sequence[str] = ()
    unit: str = ""
    unit_of_time: str = "s"
    up: str = "y"
    layers: Sequence[Layer] = ()  # that may be chosen besides the channels


def sequence_page(
    sequence: Filmed,
    title: str,
    told: Told,
    tracks: Sequence[Track] = (),
    path_lines: Sequence[tuple[FloatArray, FloatArray]] = (),
) -> Page:
    """Return the page of a sequence: its surface, with a time bar over real time, tracks, and path
    lines, each of times (N,) and points (N, 3).

    Of frames so many that the page would be too large one of two, three, ... is shown, and that is
    told; else, where there is room, keys are put between them.
    """
    mesh, times = sequence.mesh, np.asarray(sequence.times, dtype=float)
    keys, frames, thinned = _keys(sequence, times)
    count = frames.shape[2]
    usual = ["function"] if count == 1 else [f"function {c + 1}" for c in range(count)]
    layers = [
        Layer(name, frames[:, :, c], color_range(frames[:, :, c]), keys, told.unit)
        for c, name in enumerate([*told.names, *usual[len(told.names) :]][:count])
    ]
    front = best_front(mesh, frames[:, :, 0].std(axis=0), up=told.up)
    spans = [
        Span(start, end, f"interval {number}: {text}", tone)
        for number, ((start, end), (text, tone)) in enumerate(
            zip(pairwise(times.tolist()), told.intervals, strict=False), 1
        )
    ]
    seconds = min(max(_SECONDS_A_FRAME * len(times), _SHORTEST), _LONGEST)
    ticks = times.tolist()
    clock = Clock(ticks[0], ticks[-1], seconds, told.unit_of_time, ticks=ticks, spans=spans)
    about = f"{len(times)} frames on a surface of {len(mesh.vertices):,} vertices"
    ways = _ways(tracks, path_lines, float(np.ptp(times)))
    panel = Panel("", mesh, [*layers, *told.layers], front, ways)
    notes = [*told.notes, *([thinned] if thinned else [])]
    return Page(title, told.headline, [panel], clock, told.tone, about, told.facts, notes)


def _keys(sequence: Filmed, times: FloatArray) -> tuple[FloatArray, FloatArray, str]:
    """Return times and values (T', V, C) of the page, and what is to be said of them."""
    frames = np.asarray(sequence.frames)
    frames = frames.reshape(*frames.shape[:2], -1)[:, :, :MOST_CHANNELS]
    most = max(_MOST_VALUES // (frames.shape[1] * frames.shape[2]), 2)
    if most < len(times):
        every = -(-(len(times) - 1) // (most - 1))
        chosen = np.unique([*range(0, len(times), every), len(times) - 1])
        return (
            times[chosen],
            frames[chosen],
            f"one of {every} frames is shown, {len(chosen)} in all",
        )
    between = min(max((most - 1) // max(len(times) - 1, 1), 1), _MOST_BETWEEN)
    keys, values = [times[0]], [frames[0]]
    with step("carrying frames"):
        for number, (start, end) in enumerate(pairwise(times), 1):
            checkpoint()
            for share in range(1, between):
                keys.append(start + share / between * (end - start))
                carried = np.asarray(sequence.at(float(keys[-1])))
                values.append(carried.reshape(frames.shape[1], -1)[:, :MOST_CHANNELS])
            keys.append(end)
            values.append(frames[number])
    return np.array(keys), np.stack(values), ""


def _ways(
    tracks: Sequence[Track],
    path_lines: Sequence[tuple[FloatArray, FloatArray]],
    duration: float,
) -> list[Ways]:
    kinds: dict[str, list[tuple[FloatArray, FloatArray]]] = defaultdict(list)
    for track in tracks:
        kinds[track.kind].append((track.times, track.points))
    ways = [
        Ways.along(_plural(kind), paths, _COLORS.get(kind, _OTHER), tail=_TAIL * duration)
        for kind, paths in kinds.items()
    ]
    if path_lines:
        look = {"tail": _TAIL_OF_LINES * duration, "disc": 2.2, "line": 1.6, "opacity": 0.75}
        ways.insert(0, Ways.along("path lines", path_lines, _OTHER, **look))
    return ways


def _plural(kind: str) -> str:
    return kind if kind.endswith("s") else f"{kind}s"
