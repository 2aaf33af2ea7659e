"""Model of a page with rotating surfaces and a time bar, written as one HTML file.

The scripts next to this file draw the page by WebGL2, and the file contains them. A content
security policy prevents the page from loading anything else.
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
from abfm.io import write_file
from abfm.mesh import TriangleMesh
from abfm.outcome import Tone
from abfm.pages.color_ranges import few_ticks
from abfm.pages.colormaps import ColorRange, gradient, table
from abfm.pages.creases import drawn_mesh
from abfm.pages.front import Front
from abfm.pages.html import TEMPLATES, environment, stylesheet
from abfm.pages.packing import Store, quantized, quantized_points
from abfm.types import FloatArray, IntArray
from abfm.workers.progress import step

_SCRIPTS = ("packing.js", "drawing.js", "camera.js", "player.js", "values.js", "page.js")
_COLORS = 256  # entries of a colour map
_PLAY_SECONDS = (0.1, 3600.0)  # minimum and maximum duration of playing
_TAIL_MAX = 1e30  # duration of a tail that never fades

Color = tuple[float, float, float]  # red, green and blue in sRGB, 0 to 1


@dataclass(frozen=True, eq=False)
class Layer:
    """Values shown by colours: (V,), or (T, V) at T increasing times.

    The page interpolates linearly between two times. NaN is drawn in grey. The precision is
    1/8190 of the range of the colours (``packing.LEVELS``), or 1/131068 of all values if coarser.
    """

    name: str
    values: FloatArray
    colors: ColorRange
    times: FloatArray | None = None
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Paths:
    """Objects that move or appear on a surface: straight pieces, each traversed between two times.

    Parameters
    ----------
    starts, ends : (S, 3) arrays
        Ends of S straight pieces of paths, in the unit of the mesh.
    times : (S, 2) array
        Start and end of each piece. Between them, a disc moves along the piece.
    tail : float
        Time for which a traversed piece stays visible while it fades.
    disc, line, arrow : float
        Radius of the disc, width of the line, and width of the shaft of an arrow, in pixels; 0 for
        none. An arrow is visible between the two times.
    normals : (S, 3) array, optional
        Normals of the surface at the pieces. Arrows are hidden at a steep angle, where the outline
        of the surface would cut them.
    opacities : (S,) array, optional
        Opacity of each piece, 0 to 1; multiplied by ``opacity``.
    shown : bool
        Whether the paths are visible when the page is opened.
    """

    name: str
    starts: FloatArray
    ends: FloatArray
    times: FloatArray
    color: Color
    tail: float = _TAIL_MAX
    disc: float = 4.5
    line: float = 2.5
    opacity: float = 1.0
    arrow: float = 0.0
    normals: FloatArray | None = None
    opacities: FloatArray | None = None
    shown: bool = True

    @classmethod
    def along(
        cls, name: str, paths: Sequence[tuple[ArrayLike, ArrayLike]], color: Color, **style: Any
    ) -> Paths:
        """Create paths, each from times (N,) and points (N, 3); paths of one point are omitted."""
        pieces = [(np.asarray(t, float), np.asarray(p, float)) for t, p in paths if np.size(t) > 1]
        starts = [np.zeros((0, 3)), *(points[:-1] for _, points in pieces)]
        ends = [np.zeros((0, 3)), *(points[1:] for _, points in pieces)]
        spans = [np.stack([times[:-1], times[1:]], axis=1) for times, _ in pieces]
        times = np.concatenate([np.zeros((0, 2)), *spans])
        found = cls(name, np.concatenate(starts), np.concatenate(ends), times, color)
        return replace(found, **style)

    @classmethod
    def points(
        cls, name: str, places: FloatArray, spans: ArrayLike, color: Color, disc: float = 4.5
    ) -> Paths:
        """Create discs at points (N, 3), visible between the times ``spans``, (N, 2) or (2,)."""
        times = np.broadcast_to(np.asarray(spans, float), (len(places), 2))
        return cls(name, places, places, times, color, disc=disc, line=0.0)


@dataclass(frozen=True, eq=False)
class Panel:
    """A part of the page with one surface.

    The panels of a page rotate together, each from its own front. If the reader chooses the nth
    layer, each panel shows its nth layer, or its last one if it has fewer.
    """

    title: str
    mesh: TriangleMesh
    layers: Sequence[Layer]
    front: Front
    paths: Sequence[Paths] = ()


@dataclass(frozen=True)
class Span:
    """A part of the time bar with a text."""

    start: float
    end: float
    text: str
    tone: Tone = "ink"


@dataclass(frozen=True, eq=False)
class Clock:
    """Times of the frames that a page shows, and the duration of playing at speed 1, in seconds."""

    start: float
    end: float
    seconds: float = 4.0
    unit: str = ""
    first: float | None = None  # time shown when the page is opened; by default the start
    ticks: Sequence[float] = ()
    spans: Sequence[Span] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.start) and math.isfinite(self.end) and self.start < self.end):
            raise ParameterError(
                f"the times of a page are {self.start:g} to {self.end:g}; expected finite times "
                "with the end after the start"
            )


@dataclass(frozen=True, eq=False)
class Page:
    """Panels below a headline, with facts and notes. Without a clock the page has no time bar.

    The sections ``topics`` of ``abfm.explanations`` explain the headline.
    """

    title: str
    headline: str
    panels: Sequence[Panel]
    clock: Clock | None = None
    tone: Tone = "ink"
    about: str = ""
    facts: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()
    topics: Sequence[str] = ()

    def html(self, is_embedded: bool = False) -> str:
        """Return the HTML of the page; if ``is_embedded``, only the panels."""
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
            data=_PageData(self, store).page(),
            arrays=store.text(),
            script=script,
        )

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the page, completely or not at all, or raise a `ResultError`."""
        with step("writing the page"):
            text = self.html()
        write_file(path, text)


class _PageData:
    """JSON data of a page for its script; arrays are added to the store."""

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
            "clock": _clock(self._clock),
        }

    def _relative_times(self, times: ArrayLike) -> FloatArray:
        """Return times as fractions of the duration of the clock, 0 at its start and 1 at its end.

        The page stores single precision, which cannot distinguish large numbers such as dates.
        """
        start, end = self._clock.start, self._clock.end
        relative = (np.asarray(times, dtype=float) - start) / (end - start)
        return np.clip(relative, -_TAIL_MAX, _TAIL_MAX)

    def _mesh(self, mesh: TriangleMesh) -> dict[str, Any]:
        drawn = drawn_mesh(mesh)
        numbers, low, step = quantized_points(_centred(mesh, mesh.vertices)[drawn.origin])
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
            "paths": [self._paths(paths, panel.mesh) for paths in panel.paths],
        }

    def _layer(self, layer: Layer, origin: IntArray) -> dict[str, Any]:
        values, colors = np.atleast_2d(layer.values)[:, origin], layer.colors
        low, high = colors.full
        found = quantized(values, (high - low) / (colors.high - colors.low))
        colormap = self._colormaps.setdefault(colors.colormap, len(self._colormaps))
        times = (
            None if layer.times is None else self._relative_times(layer.times).astype(np.float32)
        )
        if (1 if times is None else len(times)) != len(values):
            count = "no" if times is None else f"{len(times)}"
            raise ParameterError(
                f"{layer.name} has {len(values)} frames but {count} times; expected one time for "
                "each frame"
            )
        return {
            "name": layer.name,
            "unit": layer.unit,
            "ends": [colors.low, colors.high],
            "gradient": gradient(colors),
            "ticks": few_ticks(colors.low, colors.high),
            "clipped": colors.clipped,
            "full": colors.full,
            "low": found.position(colors.low),
            "high": found.position(colors.high),
            "minimum": found.minimum,
            "step": found.step,
            "colormap": colormap,
            "values": self._store.add(found.numbers),
            "times": None if times is None else self._store.add(times[:, None]),
        }

    def _paths(self, paths: Paths, mesh: TriangleMesh) -> dict[str, Any]:
        ends = [_centred(mesh, np.asarray(each)) for each in (paths.starts, paths.ends)]
        normals = np.zeros_like(ends[0]) if paths.normals is None else paths.normals
        opacities = np.ones(len(ends[0])) if paths.opacities is None else paths.opacities
        parts = [*ends, self._relative_times(paths.times), normals, opacities[:, None]]
        pieces = np.hstack(parts).astype(np.float32)
        # the page draws the pieces that have started
        in_time = np.argsort(pieces[:, 6], kind="stable")
        return {
            "name": paths.name,
            "color": list(paths.color),
            "tail": min(paths.tail / (self._clock.end - self._clock.start), _TAIL_MAX),
            "disc": paths.disc,
            "line": paths.line,
            "arrow": paths.arrow,
            "shown": paths.shown,
            "opacity": paths.opacity,
            "pieces": self._store.add(pieces[in_time]),
        }


def _centred(mesh: TriangleMesh, points: FloatArray) -> FloatArray:
    """Return centred points in sqrt(area), because graphics cards have a precision of 7 digits."""
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    return np.asarray((points - middle) / mesh.length_scale)


def _clock(clock: Clock) -> dict[str, Any]:
    return {
        "start": clock.start,
        "end": clock.end,
        "seconds": min(max(clock.seconds, _PLAY_SECONDS[0]), _PLAY_SECONDS[1]),
        "unit": clock.unit,
        "first": clock.start if clock.first is None else clock.first,
        "ticks": [float(tick) for tick in clock.ticks],
        "spans": [vars(span) for span in clock.spans],
    }


def _bytes(colormap: str) -> Any:
    """Return the colours of a map as (1, 4 * 256) bytes: red, green, blue and opacity."""
    colors = np.full((_COLORS, 4), 255, dtype=np.uint8)
    colors[:, :3] = np.round(255 * table(colormap, _COLORS))
    return colors.reshape(1, -1)


def _text(name: str) -> str:
    return (TEMPLATES / name).read_text(encoding="utf-8")


def _policy(script: str, style: str) -> str:
    """Return the content security policy: only this script and this style, and no network."""
    digests = [hashlib.sha256(text.encode()).digest() for text in (script, style)]
    script_hash, style_hash = (base64.b64encode(digest).decode() for digest in digests)
    return (
        f"default-src 'none'; script-src 'sha256-{script_hash}'; style-src 'sha256-{style_hash}'; "
        "base-uri 'none'; form-action 'none'"
    )
