"""A page that shows surfaces, turning, with a time bar: one file, without server or network.

It is drawn by WebGL2, by the scripts beside this file, which it holds; what it may do is bounded by
its own policy: it can load nothing.
"""

from __future__ import annotations

import base64
import hashlib
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from abfm.errors import ParameterError
from abfm.io import write_whole
from abfm.mesh import TriangleMesh
from abfm.outcome import Tone
from abfm.pages.colormaps import ColorRange, gradient, table
from abfm.pages.creases import drawn_mesh
from abfm.pages.front import Front
from abfm.pages.html import TEMPLATES, environment, stylesheet
from abfm.pages.packing import Store, quantised, quantised_places
from abfm.types import FloatArray, IntArray
from abfm.workers.progress import step

_SCRIPTS = ("packing.js", "drawing.js", "camera.js", "player.js", "values.js", "page.js")
_COLORS = 256  # of a colour map
_SECONDS = (0.1, 3600.0)  # that playing may take
_FULL_TAIL = 1e30

Color = tuple[float, float, float]
"""Red, green and blue, sRGB in 0 to 1."""


@dataclass(frozen=True, eq=False)
class Layer:
    """What colours may show on a surface: values (V,), or (T, V) at T increasing times.

    Between two times the page goes evenly from the one to the other; NaN is drawn in grey. Values
    are kept to 1/8190 of their range (`packing.LEVELS`).
    """

    name: str
    values: FloatArray
    colors: ColorRange
    times: FloatArray | None = None
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Ways:
    """What moves or appears on a surface: straight pieces, each gone along between two times.

    Parameters
    ----------
    starts, ends : (S, 3) arrays
        Places, in the mesh's unit.
    times : (S, 2) array
        When each piece begins and ends; a disc is at its place on the piece in between.
    tail : float
        How long after it was gone along a piece is seen, fading.
    disc, line, arrow : float
        Radius of the disc, and widths of the line and of the shaft of an arrow that is there
        between the two times, in pixels; 0 for none.
    normals : (S, 3) array, optional
        Of the surface there: arrows are not seen where it is steep, as an outline would cut them.
    opacities : (S,) array, optional
        Of each piece, from 0 to 1, times that of all.
    shown : bool
        Whether it is seen before anybody asks for it.
    """

    name: str
    starts: FloatArray
    ends: FloatArray
    times: FloatArray
    color: Color
    tail: float = _FULL_TAIL
    disc: float = 4.5
    line: float = 2.5
    opacity: float = 1.0
    arrow: float = 0.0
    normals: FloatArray | None = None
    opacities: FloatArray | None = None
    shown: bool = True

    @classmethod
    def along(
        cls, name: str, paths: Sequence[tuple[ArrayLike, ArrayLike]], color: Color, **look: Any
    ) -> Ways:
        """Make ways of paths, each of times (N,) and points (N, 3), N at least 2."""
        pieces = [(np.asarray(t, float), np.asarray(p, float)) for t, p in paths if np.size(t) > 1]
        starts = [np.zeros((0, 3)), *(points[:-1] for _, points in pieces)]
        ends = [np.zeros((0, 3)), *(points[1:] for _, points in pieces)]
        spans = [np.stack([times[:-1], times[1:]], axis=1) for times, _ in pieces]
        times = np.concatenate([np.zeros((0, 2)), *spans])
        ways = cls(name, np.concatenate(starts), np.concatenate(ends), times, color)
        return replace(ways, **look)

    @classmethod
    def points(
        cls, name: str, places: FloatArray, spans: ArrayLike, color: Color, disc: float = 4.5
    ) -> Ways:
        """Make ways of points (N, 3) that are there between times (N, 2), or (2,) for all."""
        times = np.broadcast_to(np.asarray(spans, float), (len(places), 2))
        return cls(name, places, places, times, color, disc=disc, line=0.0)


@dataclass(frozen=True, eq=False)
class Panel:
    """A surface in its own part of the page; the panels of a page turn together, each from its
    front. Where several layers may be chosen, the nth of each panel is shown; of fewer the last.
    """

    title: str
    mesh: TriangleMesh
    layers: Sequence[Layer]
    front: Front
    ways: Sequence[Ways] = ()


@dataclass(frozen=True)
class Span:
    """What is said of a part of the time bar."""

    start: float
    end: float
    text: str
    tone: Tone = "ink"


@dataclass(frozen=True, eq=False)
class Clock:
    """The times of a page, and how many seconds it takes to play them at speed 1."""

    start: float
    end: float
    seconds: float = 4.0
    unit: str = ""
    first: float | None = None  # that is shown at first, by default the start
    ticks: Sequence[float] = ()
    spans: Sequence[Span] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.start) and math.isfinite(self.end) and self.start < self.end):
            raise ParameterError(
                f"a page's times go from {self.start:g} to {self.end:g}; expected a later end"
            )


@dataclass(frozen=True, eq=False)
class Page:
    """Panels under a headline, and facts and notes below them; without a clock nothing moves."""

    title: str
    headline: str
    panels: Sequence[Panel]
    clock: Clock | None = None
    tone: Tone = "ink"
    about: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()

    def html(self, is_embedded: bool = False) -> str:
        """Return the whole page; one that is embedded has neither title nor text below."""
        store = Store()
        script = "\n".join(_text(name) for name in _SCRIPTS)
        script, style = f'"use strict";\n{script}', stylesheet(TEMPLATES / "page.css")
        template = environment().get_template("page.html")
        return template.render(
            policy=_policy(script, style),
            title=self.title,
            style=style,
            page=self,
            is_embedded=is_embedded,
            moving="hidden" if self.clock is None else "",
            version=version("abfm"),
            told=_PageData(self, store).page(),
            data=store.text(),
            script=script,
        )

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the page, whole or not at all, or raise a `ResultError`."""
        with step("writing the page"):
            text = self.html()
        write_whole(path, text)


class _PageData:
    """What the script is told of a page; arrays go into the store."""

    def __init__(self, page: Page, store: Store) -> None:
        self._page, self._store = page, store
        self._clock = page.clock or Clock(0.0, 1.0)
        self._meshes: dict[TriangleMesh, int] = {}
        self._colormaps: dict[str, int] = {}

    def page(self) -> dict[str, Any]:
        panels = [self._panel(panel) for panel in self._page.panels]
        return {
            "panels": panels,
            "meshes": [self._mesh(mesh) for mesh in self._meshes],
            "colormaps": [self._store.add(_bytes(name)) for name in self._colormaps],
            "gradients": [gradient(name) for name in self._colormaps],
            "clock": _clock(self._clock),
        }

    def _shares(self, times: ArrayLike) -> FloatArray:
        """Return times as shares of the clock's: single precision cannot tell dates apart."""
        start, end = self._clock.start, self._clock.end
        shares = (np.asarray(times, dtype=float) - start) / (end - start)
        return np.clip(shares, -_FULL_TAIL, _FULL_TAIL)

    def _mesh(self, mesh: TriangleMesh) -> dict[str, Any]:
        drawn = drawn_mesh(mesh)
        numbers, low, step = quantised_places(_placed(mesh, mesh.vertices)[drawn.origin])
        add = self._store.add
        return {
            "positions": add(numbers),
            "faces": add(drawn.faces.astype(np.uint32)),
            "ids": add(mesh.vertex_ids[drawn.origin].astype(np.uint32)[:, None]),
            "low": low.tolist(),
            "step": step.tolist(),
            "culls": mesh.is_closed and not mesh.is_inside_out,
        }

    def _panel(self, panel: Panel) -> dict[str, Any]:
        origin = drawn_mesh(panel.mesh).origin
        return {
            "title": panel.title,
            "mesh": self._meshes.setdefault(panel.mesh, len(self._meshes)),
            "axes": panel.front.axes.ravel().tolist(),
            "layers": [self._layer(layer, origin) for layer in panel.layers],
            "ways": [self._ways(ways, panel.mesh) for ways in panel.ways],
        }

    def _layer(self, layer: Layer, origin: IntArray) -> dict[str, Any]:
        values, colors = np.atleast_2d(layer.values)[:, origin], layer.colors
        found = quantised(values)
        colormap = self._colormaps.setdefault(colors.colormap, len(self._colormaps))
        times = None if layer.times is None else self._shares(layer.times).astype(np.float32)
        if (1 if times is None else len(times)) != len(values):
            given = "no times" if times is None else f"{len(times)} times"
            raise ParameterError(f"{layer.name} has {len(values)} frames, and {given}")
        return {
            "name": layer.name,
            "unit": layer.unit,
            "ends": [colors.low, colors.high],
            "low": found.place(colors.low),
            "high": found.place(colors.high),
            "least": found.least,
            "step": found.step,
            "colormap": colormap,
            "values": self._store.add(found.numbers),
            "times": None if times is None else self._store.add(times[:, None]),
        }

    def _ways(self, ways: Ways, mesh: TriangleMesh) -> dict[str, Any]:
        ends = [_placed(mesh, np.asarray(each)) for each in (ways.starts, ways.ends)]
        normals = np.zeros_like(ends[0]) if ways.normals is None else ways.normals
        opacities = np.ones(len(ends[0])) if ways.opacities is None else ways.opacities
        parts = [*ends, self._shares(ways.times), normals, opacities[:, None]]
        pieces = np.hstack(parts).astype(np.float32)
        in_time = np.argsort(pieces[:, 6], kind="stable")  # the page draws those until now
        return {
            "name": ways.name,
            "color": list(ways.color),
            "tail": min(ways.tail / (self._clock.end - self._clock.start), _FULL_TAIL),
            "disc": ways.disc,
            "line": ways.line,
            "arrow": ways.arrow,
            "shown": ways.shown,
            "opacity": ways.opacity,
            "places": self._store.add(pieces[in_time]),
        }


def _placed(mesh: TriangleMesh, points: FloatArray) -> FloatArray:
    """Return points about the mesh's middle, in sqrt(area): graphics cards have 7 digits."""
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    return np.asarray((points - middle) / mesh.length_scale)


def _clock(clock: Clock) -> dict[str, Any]:
    return {
        "start": clock.start,
        "end": clock.end,
        "seconds": min(max(clock.seconds, _SECONDS[0]), _SECONDS[1]),
        "unit": clock.unit,
        "first": clock.start if clock.first is None else clock.first,
        "ticks": [float(tick) for tick in clock.ticks],
        "spans": [vars(span) for span in clock.spans],
    }


def _bytes(colormap: str) -> Any:
    """Return the colours of a map as (1, 4 * 256) bytes, red, green, blue and opaque."""
    colors = np.full((_COLORS, 4), 255, dtype=np.uint8)
    colors[:, :3] = np.round(255 * table(colormap, _COLORS))
    return colors.reshape(1, -1)


def _text(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def _policy(script: str, style: str) -> str:
    """Allow this script and this style, and nothing else: no network, no other script."""
    hashes = (
        base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        for text in (script, style)
    )
    of_script, of_style = hashes
    return (
        f"default-src 'none'; script-src 'sha256-{of_script}'; style-src 'sha256-{of_style}'; "
        "base-uri 'none'; form-action 'none'"
    )
