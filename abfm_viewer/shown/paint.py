"""What each surface shows: values and their range, decided from the session without drawing anything."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from abfm.types import FloatArray
from abfm_viewer.appearance.colormaps import ColorRange, color_range, place_colors
from abfm_viewer.document.document import HODGE_PARTS, Front, Side
from abfm_viewer.session.session import Session
from abfm_viewer.shown.field_quantities import Field, Texture

Kind = Literal["vertex values", "face values", "colors", "checker", "texture"]
_LEAST_RANGE = 1e-12
_NO_VALUES = 0.3  # grey, in linear light


@dataclass(frozen=True, eq=False)
class Paint:
    """One surface's colours.

    Attributes
    ----------
    kind : Kind
    values : array
        (V,), (F,), (V, 3) colours in linear light, (V, 2) texture coordinates, or (size, size, 3) texture.
    title : str
        What is shown, for the label above the surface.
    colors : ColorRange or None
        None where the values are colours themselves and no function's.
    bar : str
        Title of the colour bar; surfaces with the same title share one.
    corners : (3F, 2) array or None
        Places of the corners in a texture.
    """

    kind: Kind
    values: FloatArray | NDArray[np.float32]
    title: str
    colors: ColorRange | None = None
    bar: str = ""
    corners: FloatArray | None = None


def surfaces(session: Session) -> tuple[str, ...]:
    """Names of the surfaces that the view shows, in their order."""
    view = session.view
    wanted = {"linear blend": view.blend, "optimal transport": view.transport, "error": view.error}
    extra = [name for name, is_wanted in wanted.items() if is_wanted]
    if view.layout == "advected only":
        return ("advected", *extra)
    return ("source", "advected", *extra, "target")


class Painter:
    """Decides the paint of every surface; a paint stays the same object while what it is made of does.

    Attributes
    ----------
    largest_error : float or None
        The end of the error's range, for a movie, in which it must not change; by default the shown error's maximum.
    """

    def __init__(self) -> None:
        self.largest_error: float | None = None
        self._kept: dict[str, tuple[tuple[object, ...], Paint]] = {}
        self._range: tuple[object, object, str, ColorRange] | None = None

    def paint(self, session: Session, name: str) -> Paint | None:
        """What a surface shows now; None while nothing is known."""
        if session.active and name in ("source", "target"):
            side: Side = "source" if name == "source" else "target"
            if session.error(session.active.spec(side)):
                return self._without_values(session, name)
        source, target = session.values("source"), session.values("target")
        if source is None or target is None:
            return None
        colors = self._function_range(session, source, target)
        view = session.view
        if name in ("source", "target"):
            if view.coloring in ("coordinates", "checker"):
                return self._carried(session, name, session.mesh.vertices, name)
            return self._kept_paint(name, "vertex values", source if name == "source" else target, name, colors)
        advected = session.shown.advected()
        if advected is None:
            return None
        if name == "linear blend":
            return self._blend(session, source, target, colors)
        if name == "optimal transport":
            return self._transport(session, colors)
        if name == "error":
            return self._error(session, target, advected)
        return self._advected(session, advected, colors)

    def _without_values(self, session: Session, name: str) -> Paint:
        count = len(session.mesh.vertices)
        title = f"{name}: no values"
        return self._keep(name, (count, title), lambda: Paint("colors", np.full((count, 3), _NO_VALUES), title))

    def _advected(self, session: Session, advected: FloatArray, colors: ColorRange) -> Paint:
        """The middle surface, by the view's colouring."""
        special = self._by_coloring(session, advected, colors)
        return special or self._kept_paint("advected", "vertex values", advected, "advected", colors)

    def _by_coloring(self, session: Session, advected: FloatArray, colors: ColorRange) -> Paint | None:
        """What the view asks for instead of the function's colours; None where there is nothing of it yet."""
        kind = session.view.coloring
        if kind == "function":
            texture = session.quantities.texture(session, advected, colors) if session.view.streaks else None
            return None if texture is None else self._textured(texture, colors)
        if kind in ("coordinates", "checker"):
            carried = session.shown.coordinates()
            title = "carried coordinates" if kind == "coordinates" else "carried checker"
            return None if carried is None else self._carried(session, "advected", carried, title)
        if kind in ("area distortion", "conformal distortion"):
            return self._distortion(session, kind)
        return self._of_field(session)

    def _of_field(self, session: Session) -> Paint | None:
        """Speed, divergence or curl."""
        kind, part = session.view.coloring, session.view.part
        suffix = "" if part == "whole" else f", {part} part" if part in HODGE_PARTS else f", {part}"
        if kind == "speed":
            field = session.quantities.field(session)
            if field is None:
                return None
            return self._speed(session, field, f"speed{suffix}")
        values = session.quantities.scalar(session)
        if values is None:
            return None
        top = max(float(np.percentile(np.abs(values), 99.5)), _LEAST_RANGE)
        colors = _ranged(session, -top, top)
        return self._kept_paint("advected", "vertex values", values, f"{kind}{suffix}", colors, kind)

    def _speed(self, session: Session, field: Field, title: str) -> Paint:
        """With sqrt(area) as the unit of length: graphics cards know no numbers like some meshes'."""

        def make() -> Paint:
            values = field.speed * field.mesh.length_scale**-field.dimension
            unit = field.unit.replace("the mesh's length", "length").replace("length", "sqrt(area)")
            top = max(float(values.max()), _LEAST_RANGE)
            return Paint("face values", values, title, _ranged(session, 0.0, top), f"speed, in {unit}")

        return self._keep("advected", (field, title, session.view.colormap), make)

    def _distortion(self, session: Session, kind: str) -> Paint | None:
        found = session.quantities.distortion(session)
        if found is None:
            return None
        source = found.area if kind == "area distortion" else found.conformal

        def make() -> Paint:
            from abfm.calculus.operators import face_areas  # not before: it loads what the first frame does without

            values = np.log2(np.clip(source, 1e-6, 1e6))
            top = max(_most(np.abs(values), face_areas(session.mesh)), 0.05)
            low = -top if kind == "area distortion" else 0.0
            bar = "log2 of the area's factor" if kind == "area distortion" else "log2 of the stretches' ratio"
            return Paint("face values", values, kind, _ranged(session, low, top), bar)

        return self._keep("advected", (source, session.view.colormap), make)

    def _carried(self, session: Session, name: str, coordinates: FloatArray, title: str) -> Paint:
        """Coordinates as colours, or as places in a checkerboard."""
        kind, vertices = session.view.coloring, session.mesh.vertices
        front = session.view.front or Front((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))

        def make() -> Paint:
            if kind == "coordinates":
                return Paint("colors", place_colors(vertices, coordinates), title)
            return Paint("checker", (coordinates @ front.axes[:2].T) / session.mesh.length_scale, title)

        return self._keep(name, (coordinates, kind, front, title), make)

    def _textured(self, texture: Texture, colors: ColorRange) -> Paint:
        def make() -> Paint:
            return Paint("texture", texture.colors, "advected", colors, "function", texture.corners)

        return self._keep("advected", (texture, colors), make)

    def _blend(self, session: Session, source: FloatArray, target: FloatArray, colors: ColorRange) -> Paint:
        tau = session.parameters.tau
        time = min(session.time, tau)

        def make() -> Paint:
            from abfm.baselines import linear_blend

            return Paint("vertex values", linear_blend(source, target, time, tau), "linear blend", colors, "function")

        return self._keep("linear blend", (source, target, time, tau, colors), make)

    def _transport(self, session: Session, colors: ColorRange) -> Paint | None:
        values = session.mass_transport.values(session)
        if session.mass_transport.error:
            return self._without_values(session, "optimal transport")
        if values is None:
            return None
        return self._kept_paint("optimal transport", "vertex values", values, "optimal transport", colors)

    def _error(self, session: Session, target: FloatArray, advected: FloatArray) -> Paint:
        fixed = self.largest_error

        def make() -> Paint:
            error = np.abs(target - advected)
            top = max(float(error.max()) if fixed is None else fixed, _LEAST_RANGE)
            bar = f"|target - advected|, at most {top:.3g}"
            return Paint("vertex values", error, "error", _ranged(session, 0.0, top), bar)

        return self._keep("error", (target, advected, session.view.colormap, fixed), make)

    def _kept_paint(
        self, name: str, kind: Kind, values: FloatArray, title: str, colors: ColorRange, bar: str = "function"
    ) -> Paint:
        return self._keep(name, (values, title, colors), lambda: Paint(kind, values, title, colors, bar))

    def _keep(self, name: str, made_of: tuple[object, ...], make: Callable[[], Paint]) -> Paint:
        """The paint that was made of the same things, or a new one."""
        before = self._kept.get(name)
        if before is not None and _same(before[0], made_of):
            return before[1]
        paint = make()
        self._kept[name] = (made_of, paint)
        return paint

    def _function_range(self, session: Session, source: FloatArray, target: FloatArray) -> ColorRange:
        known, wanted = self._range, session.view.colormap
        if known is None or known[0] is not source or known[1] is not target or known[2] != wanted:
            colors = color_range(source, target)
            if wanted != "automatic":
                colors = replace(colors, colormap=wanted)
            known = self._range = (source, target, wanted, colors)
        return known[3]


def _same(before: tuple[object, ...], now: tuple[object, ...]) -> bool:
    """Whether two keys have the same arrays, as objects, and equal values besides."""
    return len(before) == len(now) and all(
        a is b or (not isinstance(a, np.ndarray) and not isinstance(b, np.ndarray) and a == b)
        for a, b in zip(before, now, strict=True)
    )


def _most(values: FloatArray, weights: FloatArray) -> float:
    """What a twentieth of the weight exceeds: slivers and a few faces that fold do not count."""
    order = np.argsort(values)
    below = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(below, 0.95 * below[-1])]])


def _ranged(session: Session, low: float, high: float) -> ColorRange:
    automatic = "abfm diverging" if low < 0 else "abfm sequential"
    return ColorRange(automatic if session.view.colormap == "automatic" else session.view.colormap, low, high)
