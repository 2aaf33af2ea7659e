"""Paints of the surfaces in pictures.

A paint consists of the values that a surface shows, their colour range, and a title. Nothing is
drawn here.
"""

from collections import defaultdict
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

import abfm
from abfm import TriangleMesh
from abfm.pages.color_ranges import Quantity, color_range
from abfm.pages.colormaps import NO_VALUES, ColorRange, for_background, place_colors
from abfm.pages.front import Front
from abfm.types import BoolArray, FloatArray
from abfm_viewer.computing.background import Memo
from abfm_viewer.document.document import HODGE_PARTS, SIDES, TRANSFERRED_COLORINGS, Side, Theme
from abfm_viewer.shown.colored_values import PLAIN_COLORS, ColoredValues
from abfm_viewer.shown.quantities import Field
from abfm_viewer.shown.shown import Shown

COMPUTING_SUFFIX = ": computing"  # suffix of the title of a surface whose values are being computed
PaintKind = Literal["vertex values", "face values", "colors", "checker", "texture"]
_RANGE_TOLERANCE = 0.02  # share of the range; values farther outside are noted in the title
# titles of the colour bars if the functions on A and B have different units
_UNIT_OF_A_TITLE = "function on A, in its own unit"
_DEVIATIONS_TITLE = "function, in standard deviations"
_SQUARES = 20  # number of checkerboard squares across the front view of a mesh


@dataclass(frozen=True, eq=False)
class Paint:
    """Values and colours that a surface shows, with the titles of its picture and colour bar."""

    kind: PaintKind
    # by kind: (V,), (F,), linear colours (V, 3), coordinates (V, 2), or texture (size, size, 3)
    values: FloatArray | NDArray[np.float32]
    title: str  # text above the surface
    colors: ColorRange | None = None  # colours of a function; None if the values are colours
    bar: str = ""  # title of the colour bar; surfaces with the same title share one
    corners: FloatArray | None = None  # (3F, 2): texture coordinates of the corners
    is_dark: bool = False  # whether a checkerboard or pale colours are for a dark background
    mesh: TriangleMesh | None = None  # mesh of the values; None for that of the surface
    # (V,) or (F,): where the function has no measured values; drawn grey
    unknown: BoolArray | None = None
    # (V,) or (F,): share of the colours; the rest is the colour of a plain surface
    determined: FloatArray | None = None


class Painter:
    """Makes the paint of each surface; a paint is the same object until its inputs change."""

    def __init__(self, shown: Shown) -> None:
        self.largest_error: float | None = None  # end of the colour range in a movie
        self._shown, self._session = shown, shown.session
        self._memos: dict[str, Memo[Paint]] = defaultdict(Memo)
        self._unknowns: dict[str, Memo[BoolArray | None]] = defaultdict(Memo)
        self._ranges: dict[str, Memo[ColorRange]] = defaultdict(Memo)

    def paint(self, name: str) -> Paint | None:
        """Return the paint of a surface, such as "advected"; None until its values are known."""
        session = self._session
        side = next((side for side in SIDES if side == name), None)
        if side and session.work.error(side):
            return self._without_values(name)
        source, target = session.work.flow_values("source"), session.work.flow_values("target")
        if source is None or target is None:
            return self._before_the_map(name)
        ranged = session.values("source") if target is session.values("target") else source
        colors = self._function_range(source if ranged is None else ranged, target)
        if paint := self._on_finer(name, colors):
            return paint
        if side:
            return self._of_side(side, source if side == "source" else target, colors)
        if name == "advected" and (paint := self._compared(colors)) is not None:
            return paint
        advected = self._shown.flow.advected()
        if advected is None:
            return None
        if name == "linear blend":
            return self._blend(source, target, colors)
        if name == "optimal transport":
            return self._transport(colors)
        if name == "error":
            return self._error(target, advected)
        plain = self._by_coloring() or self._advected(advected, colors)
        return (self._streaked(plain) if session.view.streaks else None) or plain

    def _before_the_map(self, name: str) -> Paint | None:
        """Return the paint of a surface before the initial map between surfaces A and B is known.

        Source and target show their functions. Other surfaces have no values if the map failed;
        while it is computed, the result is None.
        """
        session = self._session
        source, target = session.values("source"), session.values("target")
        if source is None or target is None:
            return None
        if name not in SIDES:
            return self._without_values(name) if session.initial_maps.error else None
        colors = self._function_range(source, target)
        values = source if name == "source" else target
        return self._function(name, values, self._session.document.slot_title(name), colors)

    def _of_side(self, side: Side, values: FloatArray, colors: ColorRange) -> Paint | None:
        """Return the paint of the source or target; None before its values are known.

        The source shows the pattern of the view, if any, at time 0. A function on A is scaled as in
        the match, or shown in its own unit if this is unknown.
        """
        session, title = self._session, self._session.document.slot_title(side)
        is_of_source = session.surface(side) is session.surface("source")
        if session.view.coloring in TRANSFERRED_COLORINGS and is_of_source:
            places = session.surface(side).mesh.vertices
            if (paint := self._pattern(side, places, title)) is not None:
                return paint
        if side == "target" or session.work.flow_values(side) is session.values(side):
            return self._function(side, values, title, colors)
        if (on_a := session.values(side)) is None:  # ``values`` are on B, as they were transferred
            return None
        if session.work.flow_values("target") is session.values("target"):
            return self._function(side, on_a, title, colors)
        if (scaled := session.work.source_on_a) is not None:
            return self._function(side, scaled, title, colors)
        areas = abfm.calculus.vertex_areas(session.surface("source").mesh)
        colors = self._range("on A", on_a, areas=areas)
        return self._function(side, on_a, title, colors, _UNIT_OF_A_TITLE)

    def _without_values(self, name: str) -> Paint:
        count, title = len(self._session.surface(name).mesh.vertices), f"{name}: no values"
        get = self._memos[name].get
        return get((count, title), lambda: Paint("colors", np.full((count, 3), NO_VALUES), title))

    @property
    def _bar(self) -> str:
        """Title of the colour bar of functions; on surface B they may be in standard deviations."""
        session = self._session
        target = session.work.flow_values("target")
        has_same_unit = target is None or target is session.values("target")
        return "function" if has_same_unit else _DEVIATIONS_TITLE

    def _function(
        self, name: str, values: FloatArray, title: str, colors: ColorRange, bar: str = ""
    ) -> Paint:
        """Return the paint of values (V,), with a colour bar of title ``bar`` or of functions."""
        bar, unknown = bar or self._bar, None if bar else self._unknown(name)
        make = partial(Paint, "vertex values", values, title, colors, bar, unknown=unknown)
        return self._memos[name].get((values, title, colors, bar, unknown), make)

    def _unknown(self, name: str) -> BoolArray | None:
        """Return a mask of where the function of a surface was not measured; None if nowhere."""
        inputs, find = self._session.document.missing_values(name, self._session.functions.values)
        return self._unknowns[name].get(inputs, find)

    def _on_finer(self, name: str, colors: ColorRange) -> Paint | None:
        """Return the paint of a function on a match's finer mesh; None if that is not shown."""
        flow, is_side = self._shown.flow, name in SIDES
        view = self._session.view  # streaks are on the mesh of the field
        is_advected = name == "advected" and view.coloring == "function" and not view.streaks
        is_function = is_side or is_advected
        found = flow.on_finer_mesh(name) if is_function else None
        if found is None:
            return None
        mesh, values = found
        title = self._session.document.slot_title(name)
        title = title if is_side else self._extrapolated(title, flow.is_behind)
        make = partial(Paint, "vertex values", values, title, colors, self._bar, mesh=mesh)
        return self._memos[name].get((mesh, values, title, colors), make)

    def _advected(self, advected: FloatArray, colors: ColorRange) -> Paint:
        """Return the paint of the advected function; the title notes if it is outdated."""
        shown, is_function = self._shown, self._session.view.coloring == "function"
        is_busy = shown.flow.busy or shown.quantities.busy
        is_behind = shown.flow.is_behind if is_function else is_busy
        title = self._session.document.slot_title("advected")
        if not self._session.document.has_one_field and shown.flow.state is None:
            title = f"{title}, linear blend"
        title = self._extrapolated(title, is_behind)
        unknown = self._unknown("advected source")

        def make() -> Paint:
            full_title = title if is_behind else _with_range(title, advected, colors)
            of = advected, full_title, colors, self._bar
            return Paint("vertex values", *of, unknown=unknown)

        return self._memos["advected"].get((advected, title, colors, unknown), make)

    def _by_coloring(self) -> Paint | None:
        """Return the paint by the view's coloring; None for the function and unknown values."""
        kind = self._session.view.coloring
        if kind == "function":
            return None
        if kind in TRANSFERRED_COLORINGS:
            origins = self._shown.flow.coordinates()
            title = self._extrapolated(self._session.document.transferred_title(kind))
            return None if origins is None else self._pattern("advected", origins, title)
        if kind in ("area distortion", "conformal distortion"):
            return self._distortion(kind)
        part = self._session.view.part
        suffix = (
            "" if part == "complete" else f", {part} part" if part in HODGE_PARTS else f", {part}"
        )
        title = f"{kind}{suffix}"
        if kind == "speed":
            field = self._shown.quantities.field()
            return None if field is None else self._faded(self._speed(field, title))
        values = self._shown.quantities.scalar()
        if values is None:
            return None
        areas = abfm.calculus.vertex_areas(self._session.surface().mesh)
        colors = self._range("field", values, areas=areas, quantity="signed")
        return self._faded(self._function("advected", values, title, colors, kind))

    def _faded(self, plain: Paint) -> Paint:
        """Return the paint of a quantity of the field, pale where the field is not determined."""
        determined = self._shown.quantities.determined()
        if determined is None:
            return plain
        mesh, is_dark = self._session.surface().mesh, self._session.view.theme == "dark"

        def make() -> Paint:
            is_of_faces = plain.kind == "face values"
            shares = determined if is_of_faces else abfm.calculus.averaging(mesh) @ determined
            return replace(plain, determined=shares, is_dark=is_dark)

        return self._memos["faded"].get((plain, determined), make)

    def _speed(self, field: Field, title: str) -> Paint:
        """Return the paint of a field's speed, in a unit in which single precision suffices."""

        def make() -> Paint:
            values, unit = field.relative_speed()
            areas = abfm.calculus.face_areas(field.mesh)
            colors = self._range("field", values, areas=areas, quantity="magnitude")
            return Paint("face values", values, title, colors, f"speed, in {unit}")

        return self._memos["advected"].get((field, title, *self._appearance), make)

    def _distortion(self, kind: str) -> Paint | None:
        found = self._shown.quantities.distortion()
        if found is None:
            return None
        of_area, title = kind == "area distortion", self._extrapolated(kind)
        mesh = self._session.surface().mesh
        source = found.area if of_area else found.conformal

        def make() -> Paint:
            values = np.log2(np.clip(source, 1e-6, 1e6))
            bar = "area change, log2" if of_area else "ratio of stretches, log2"
            areas, quantity = abfm.calculus.face_areas(mesh), "signed" if of_area else "magnitude"
            colors = self._range("field", values, areas=areas, quantity=quantity, end_min=0.05)
            return Paint("face values", values, title, colors, bar)

        return self._memos["advected"].get((source, title, *self._appearance), make)

    def _pattern(self, name: str, coordinates: FloatArray, title: str) -> Paint | None:
        """Return the paint of a pattern of the source's surface, such as a checkerboard or labels.

        ``coordinates`` (V, 3) are the points of that surface whose colours the vertices show.
        """
        kind, theme = self._session.view.coloring, self._session.view.theme
        if kind == "labels":
            return self._labels(name, title)
        surface = self._session.surface("source")
        mesh, front = surface.mesh, surface.front or Front((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))

        def make() -> Paint:
            if kind == "coordinates":
                return Paint("colors", place_colors(mesh.vertices, coordinates), title)
            across = front.axes[:2].T
            width, height = np.ptp(mesh.vertices @ across, axis=0)
            places = coordinates @ across / (np.sqrt(width * height) / _SQUARES)
            return Paint("checker", places, title, is_dark=theme == "dark")

        return self._memos[name].get((coordinates, kind, front, title, theme), make)

    def _labels(self, name: str, title: str) -> Paint | None:
        """Return the paint of labels, which the flow moves except on source and target; or None."""
        labels, is_moved = self._session.document.labels, name not in SIDES
        if labels is None:
            return None
        values = self._shown.flow.labels() if is_moved else labels.values
        if values is None:
            return None
        get = self._memos[name].get
        inputs = values, labels, title
        return get(inputs, lambda: Paint("colors", labels.linear_colors(values), title))

    def _streaked(self, plain: Paint) -> Paint | None:
        """Return a paint of values with streaks along the field; None before they are known."""
        if plain.colors is None:
            return None
        is_of_faces = plain.kind == "face values"
        quantities, theme = self._shown.quantities, self._session.view.theme
        ground = None if plain.determined is None else PLAIN_COLORS[theme]
        shares = quantities.determined()
        of = ColoredValues(plain.values, plain.colors, plain.unknown, is_of_faces, shares, ground)
        texture = quantities.texture(of)
        if texture is None:
            return None
        corners = texture.streaks.atlas.corner_coordinates
        make = partial(replace, plain, kind="texture", values=texture.colors, corners=corners)
        return self._memos["streaks"].get((texture, plain.title, plain.colors, plain.bar), make)

    def _compared(self, colors: ColorRange) -> Paint | None:
        """Return the paint that compares a subject with the other subjects of its population.

        The result is None for other documents, and if a match of the subject is shown.
        """
        session, document = self._session, self._session.document
        compared, active = document.active_comparison, document.active
        if compared is None or session.result is not None or session.snapshot is not None:
            return None
        assert active is not None
        channel = compared.channels[active.source, active.target]
        unknown = self._unknown("advected")
        title = document.slot_title("advected")

        def make() -> Paint:
            found = compared.values(channel)
            known = np.isfinite(found)
            values = np.where(known, found, 0.0)
            if compared.kind == "mean":
                return Paint("vertex values", values, title, colors, self._bar, unknown=unknown)
            is_of_faces = compared.kind == "areas"
            areas = abfm.calculus.face_areas if is_of_faces else abfm.calculus.vertex_areas
            quantity: Quantity = "signed" if compared.kind == "difference" else "magnitude"
            of = areas(session.surface().mesh)
            ranged = self._range("compared", values, areas=of, quantity=quantity)
            kind: PaintKind = "face values" if is_of_faces else "vertex values"
            return Paint(kind, values, title, ranged, title, unknown=unknown)

        of = compared, channel, title, colors, *self._appearance
        return self._memos["advected"].get(of, make)

    def _blend(self, source: FloatArray, target: FloatArray, colors: ColorRange) -> Paint:
        tau = self._session.document.tau
        time, unknown = min(self._session.time, tau), self._unknown("linear blend")

        def make() -> Paint:
            blend = abfm.baselines.linear_blend(source, target, time, tau)
            of = blend, "linear blend", colors, self._bar
            return Paint("vertex values", *of, unknown=unknown)

        return self._memos["linear blend"].get((source, target, time, tau, colors, unknown), make)

    def _transport(self, colors: ColorRange) -> Paint | None:
        name, transport = "optimal transport", self._shown.mass_transport
        values = transport.values()
        if transport.error:
            return self._without_values(name)
        if values is None:
            return None
        return self._function(name, values, _labelled(name, transport.busy), colors)

    def _error(self, target: FloatArray, advected: FloatArray) -> Paint:
        fixed, unknown = self.largest_error, self._unknown("error")
        title = self._extrapolated("error", self._shown.flow.is_behind)

        def make() -> Paint:
            error = np.abs(target - advected)
            areas = abfm.calculus.vertex_areas(self._session.surface().mesh)
            colors = self._range("error", error, areas=areas, quantity="magnitude")
            if fixed is not None:
                colors = replace(colors, high=fixed or 1.0, minimum=0.0, maximum=fixed)
            bar = f"|target - advected|, at most {colors.maximum:.3g}"
            of = error, title, colors, bar
            return Paint("vertex values", *of, unknown=unknown)

        inputs = target, advected, *self._appearance, fixed, title, unknown
        return self._memos["error"].get(inputs, make)

    def _extrapolated(self, title: str, is_behind: bool = False) -> str:
        """Return a title, with notes if the time is after tau, or if new values are computed."""
        tau = self._session.document.tau
        is_beyond = self._session.time > (1 + 1e-9) * tau
        return _labelled(f"{title}, extrapolated" if is_beyond else title, is_behind)

    def _function_range(self, source: FloatArray, target: FloatArray) -> ColorRange:
        session = self._session
        key, values = session.document.color_range_values(source, target)
        surfaces = (
            session.surface(side if given is session.values(side) else "advected")
            for side, given in zip(SIDES, (source, target), strict=True)
        )
        areas = [abfm.calculus.vertex_areas(surface.mesh) for surface in surfaces]
        return self._range("function", *values(), key=key, areas=areas)

    @property
    def _appearance(self) -> tuple[str, Theme, bool]:
        view = self._session.view
        return view.colormap, view.theme, view.full_range

    def _range(
        self, name: str, *values: FloatArray, key: tuple[object, ...] = (), **options: Any
    ) -> ColorRange:
        """Return the `color_range` of values with the colour map of the view.

        ``name`` and ``key``, by default the values, identify the range in the cache.
        """
        colormap, theme, is_full = self._appearance

        def make() -> ColorRange:
            colors = color_range(*values, is_full=is_full, **options)
            chosen = colors.colormap if colormap == "automatic" else colormap
            return replace(colors, colormap=for_background(chosen, theme == "dark"))

        inputs = *(key or values), options.get("quantity"), *self._appearance
        found = self._shown.ranges[name] = self._ranges[name].get(inputs, make)
        return found


def _labelled(title: str, is_behind: bool) -> str:
    return f"{title}{COMPUTING_SUFFIX}" if is_behind else title


def _with_range(title: str, values: FloatArray, colors: ColorRange) -> str:
    """Return a title with the range of the values, if some are beyond the range of the colours."""
    low, high = float(values.min()) + 0.0, float(values.max()) + 0.0  # no -0
    shown_low, shown_high = colors.full
    slack = _RANGE_TOLERANCE * (shown_high - shown_low)
    is_beyond = low < shown_low - slack or high > shown_high + slack
    return f"{title}: {low:.2g} to {high:.2g}" if is_beyond else title
