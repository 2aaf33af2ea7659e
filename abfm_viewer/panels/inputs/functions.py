"""The tab Functions: the mesh, the channels, and both functions of the active one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TypeAlias

import abfm
from abfm import FunctionError, TriangleMesh, functions
from abfm.wording import counted, sentence
from abfm_viewer.appearance.abbreviation import abbreviated
from abfm_viewer.document import gaussians
from abfm_viewer.document.document import SIDES, Side
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.panels.context import Context
from abfm_viewer.panels.inputs import hints, initial_map, landmarks
from abfm_viewer.session.active_gaussian import active_gaussian
from abfm_viewer.session.session import Session
from abfm_viewer.widgets.containers import reserved
from abfm_viewer.widgets.toolkit import TextTone, Ui
from abfm_viewer.widgets.widget_record import Range

Put: TypeAlias = "Callable[[functions.Family, str], None]"
"""Called with a changed function and the label of the widget that changed it."""
_LABEL_LENGTH_MAX = 16  # characters
_SIDE_LINES = 6  # lines reserved for a function: title, family, three of parameters, text
_MOUSE_TIP = (
    "Shift-click on the source or target also moves its Gaussian; Shift-wheel sets the width."
)
_ADD_CHANNEL = (
    "Add another pair of functions that the same flow matches. It starts with a fixed Gaussian "
    "far from all others."
)
_REMOVE_CHANNEL = "Remove the active channel."
_ONLY_CHANNEL = "The only channel cannot be removed."
_CIRCULAR_TIP = (
    "The values are phases, which repeat after a period. Compare their cosine and sine, as two "
    "channels, instead of the values."
)
_MOUSE_HINT = "Shift-drag on a surface moves its Gaussian."
_NO_GAUSSIAN_HINT = "The mouse moves functions of the family gaussian."
_WEIGHT = "Weight of the active channel's mismatch relative to the others; 0 ignores it."
_SEVERAL_TERMS = "several terms"
_FAMILY = "Family of the function. Sums can be typed below.\n\n{name}: {summary}"
_SPEC = "The function as text. Join terms with +, and press Enter to apply."
_BUMP = "The Gaussian that the mouse and the widgets below change."
_ADD = "Add Gaussian"
_REMOVE = "Remove Gaussian"
_NO_MAP = "none"
_MAP_FILE = "file..."
_MAP = (
    "Compose the function with a map of the vertices: a detected mirror plane, a detected rotation "
    "by 180 degrees, or a file. The file has one vertex number per vertex, or pairs of vertices."
)


def draw_mesh(context: Context) -> None:
    document = context.session.document
    mesh = document.surface().mesh
    _draw_meshes(context, document.name, (_size(mesh), "muted"), 2 * [_area(mesh)])


def draw_meshes(context: Context) -> None:
    """Draw the name and size of both surfaces, and the initial map between them."""
    surfaces = context.session.document.surfaces
    names = ", ".join(f"{a}: {each.name}" for a, each in zip("AB", surfaces, strict=True))
    tips = (f"{each.name}: {_size(each.mesh)}. {_area(each.mesh)}" for each in surfaces)
    _draw_meshes(context, "", (names, "ink"), ["", "\n\n".join(tips)])
    initial_map.draw(context)


def _draw_meshes(
    context: Context, first: str, second: tuple[str, TextTone], tips: list[str]
) -> None:
    ui, document = context.ui, context.session.document
    if ui.button("Open mesh...", "Open a mesh file. It can also be dropped on the window."):
        context.open_mesh()
    place = "Stop placing" if document.view.tool == "landmark" else "Place landmarks"
    is_one_line = ui.same_line_if_fits(place, is_button=True)
    ui.align()
    room = ui.remaining_width(place)
    if is_beside := ui.text_width(first) <= room:
        ui.line(first, "ink", tips[0])
    if is_one_line or is_beside:
        ui.at_right_end(place)
    if ui.button(place, landmarks.PLACE_TIP):
        context.session.editor.switch_placing()
    if not is_beside:
        ui.line(first, "ink", tips[0])
    ui.line(*second, tips[1])
    for surface in document.surfaces:
        for message in surface.mesh.messages:
            ui.note(message)


def _size(mesh: TriangleMesh) -> str:
    loops = len(mesh.boundary_loops)
    boundary = "" if mesh.is_closed else f", {counted(loops, 'boundary loop')}"
    topology = f"{'closed, ' if mesh.is_closed else ''}genus {mesh.genus}{boundary}"
    return f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces; {topology}"


def _area(mesh: TriangleMesh) -> str:
    scale = mesh.length_scale
    return f"Area {scale**2:.4g}. Widths are fractions of its square root, {scale:.4g}."


def draw(context: Context) -> None:
    ui, session = context.ui, context.session
    if session.active is None:
        ui.note("A source and a target for this mesh are being chosen.")
        return
    _draw_channels(context)
    is_wide = any(ui.halves("", ""))
    lines = (_SIDE_LINES, _SIDE_LINES - 1) if is_wide else (_SIDE_LINES + 2, _SIDE_LINES + 1)
    for side in SIDES:
        with ui.group(side), reserved(ui, *lines):
            _Side(context, side, session.active.spec(side)).draw()
    _draw_circular(ui, session)
    can_move = any(map(gaussians.gaussians, session.active.specs))
    ui.line(_MOUSE_HINT if can_move else _NO_GAUSSIAN_HINT, tip=_MOUSE_TIP)
    hints.draw(context)


def _draw_circular(ui: Ui, session: Session) -> None:
    """Draw the checkbox "circular" if the values of the active channel are phases."""
    assert session.active is not None
    specs = session.active.specs
    is_circular = any(functions.without_circle(spec) != spec for spec in specs)
    period = session.functions.period(session.editor.draft)
    if not is_circular and period is None:
        return
    if ui.checkbox("circular", is_circular, _CIRCULAR_TIP) != is_circular:
        with ui.refusals.refusing("circular"):
            session.editor.set_circular(None if is_circular else period)
    ui.refusal("circular")


def _draw_channels(context: Context) -> None:
    ui, session, editor = context.ui, context.session, context.session.editor
    several = len(session.channels) > 1
    for number, channel in enumerate(session.channels if several else ()):
        weight = "" if channel.weight == 1 else f", weight {channel.weight:g}"
        source, target = (_display_name(session.editor.draft, spec) for spec in channel.specs)
        both = source if source == target else f"{source} to {target}"
        label = f"{number + 1}: {both}{weight}"
        if ui.row(label, number == session.document.channel)[0]:
            editor.select(channel=number, bump=0)
    buttons = (
        ("Add channel", _ADD_CHANNEL, editor.add_channel),
        ("Duplicate", "Copy the active channel.", editor.duplicate_channel),
        ("Remove", _REMOVE_CHANNEL if several else _ONLY_CHANNEL, editor.remove_channel),
        ("Swap", "Exchange the active channel's source and target.", editor.swap_channel),
    )
    for label, tip, do in buttons:
        if label != "Add channel":
            ui.same_line_if_fits(label)
        if ui.button(label, tip, enabled=several or label != "Remove"):
            do()
    if several and session.active is not None:
        changed = ui.number("weight", session.active.weight, Range(0, 10), _WEIGHT)
        if changed is not None:
            with ui.refusals.refusing("weight"):
                editor.set_weight(changed, "weight")


def _display_name(document: MatchDocument, spec: str) -> str:
    """Return a short name of a function; for a function from a result, its name in that result."""
    text = document.display_names.get(spec, spec)
    try:
        return _short(functions.parse(text))
    except FunctionError:  # the name of a channel
        return abbreviated(text, _LABEL_LENGTH_MAX, len)


def _short(tree: functions.Spec) -> str:
    """Return a short name of a function, which differs between functions of the same kind."""
    if isinstance(tree, functions.Sum):
        families = {getattr(term, "family", "function") for term in tree.terms}
        return f"{len(tree.terms)} {families.pop() + 's' if len(families) == 1 else 'terms'}"
    if isinstance(tree, functions.Permuted):
        return f"{_short(tree.function)}, {Path(tree.path).name}"
    if isinstance(tree, functions.Wrapper):
        return f"{_short(tree.function)}, {getattr(tree, 'part', None) or tree.family}"
    if not isinstance(tree, functions.Family):
        return "function"
    if tree.positional is None:
        return tree.family
    word = str(getattr(tree, tree.positional))
    if any(parameter.kind.suffixes for parameter in tree.parameters()):
        return abbreviated(Path(word).name, _LABEL_LENGTH_MAX, len)
    return (
        abbreviated(word, _LABEL_LENGTH_MAX, len) if tree.is_open_ended else f"{tree.family} {word}"
    )


def _file_of(family: type[functions.Family]) -> functions.Parameter | None:
    """Return the parameter of a function family that is a file of values; None if it has none."""
    files = (parameter for parameter in family.parameters() if parameter.kind.suffixes)
    return None if family is functions.Permuted else next(files, None)


def _families() -> list[str]:
    """Return the names of the families that do not change another function."""
    found = functions.families()
    return [cls.family for cls in found if not issubclass(cls, functions.Wrapper)]


def _unwrapped(tree: functions.Spec) -> tuple[list[functions.Wrapper], functions.Spec]:
    """Return the wrappers of a function, the outermost first, and the function inside them."""
    wrappers = []
    while isinstance(tree, functions.Wrapper):
        wrappers.append(tree)
        tree = tree.function
    return wrappers, tree


def _wrapped(wrappers: Sequence[functions.Family], inner: functions.Spec) -> functions.Spec:
    """Return a function inside wrappers, of which the first one is the outermost."""
    for wrapper in reversed(wrappers):
        assert isinstance(wrapper, functions.Wrapper)
        inner = replace(wrapper, function=inner)
    return inner


class _Side:
    def __init__(self, context: Context, side: Side, spec: str) -> None:
        self._context, self._ui, self._session = context, context.ui, context.session
        self._side, self._spec = side, spec
        self._mesh = context.session.surface(side).mesh
        self._bump = active_gaussian(context.session, side)
        wrappers, self._inner = _unwrapped(functions.parse(spec))
        self._map = next((w for w in wrappers if isinstance(w, functions.Permuted)), None)
        self._wrappers = [w for w in wrappers if w is not self._map]

    def draw(self) -> None:
        ui, inner = self._ui, self._inner
        self._draw_heading()
        left, right = ui.halves("family", "map", max(_families(), key=len))
        self._draw_family(left)
        if right:
            ui.same_line()
        self._draw_map(right)
        if self._bump is not None:
            self._draw_gaussians(self._bump)
        elif isinstance(inner, functions.Family):
            draw_parameters(ui, inner, self._mesh, partial(self._put_part, inner))
            file = _file_of(type(inner))
            if file is not None and ui.button("Browse...", "Choose the file."):
                self._choose_values(type(inner), file)
        for wrapper in self._wrappers:
            draw_parameters(ui, wrapper, self._mesh, partial(self._put_part, wrapper))
        typed = ui.text("spec", self._spec, _SPEC)
        if typed is not None:
            self._put(typed, "spec")
        ui.refusal("spec", otherwise=self._session.work.error(self._side))

    def _put(self, spec: str, label: str, bump: int | None = None) -> None:
        """Set the function, in one undo step per drag; show an error below the widget ``label``."""
        with self._ui.refusals.refusing(label):
            self._session.editor.set_spec(self._side, spec, f"{self._side} {label}", bump)

    def _put_part(self, part: functions.Family, changed: functions.Family, label: str) -> None:
        """Replace the inner function or one of its wrappers."""
        wrappers = [changed if each is part else each for each in self._wrappers]
        inner = changed if part is self._inner else self._inner
        self._put(str(self._mapped(_wrapped(wrappers, inner))), label)

    def _mapped(self, function: functions.Spec) -> functions.Spec:
        return function if self._map is None else replace(self._map, function=function)

    def _draw_heading(self) -> None:
        ui, bump = self._ui, self._bump
        document = self._session.editor.draft
        color, title = getattr(ui.colors, self._side), document.slot_title(self._side)
        if self._spec in document.display_names:
            title = f"{title}: {_display_name(document, self._spec)}"
        title = ", ".join([title, *(wrapper.family for wrapper in self._wrappers)])
        ui.align()  # the title is as high as one with buttons
        if bump is None:
            ui.heading(title, color)
            return
        count = len(gaussians.gaussians(self._spec))
        ui.heading(title, color, buttons=(_ADD, _REMOVE)[: 2 if count > 1 else 1])
        if ui.button(_ADD, "Add a Gaussian, as far as possible from the others."):
            with ui.refusals.refusing(_ADD):
                self._put(gaussians.added(self._spec, self._mesh), "family", count)
        if count > 1:
            ui.same_line_if_fits(_REMOVE, is_button=True)
            if ui.button(_REMOVE, "Remove the selected Gaussian."):
                self._put(gaussians.removed(self._spec, bump), "family", max(bump - 1, 0))
        ui.refusal(_ADD)

    def _draw_family(self, width: float) -> None:
        """Draw the list of families; a new one begins with a function that is valid on the mesh."""
        known = {cls.family: cls for cls in functions.families()}
        if isinstance(self._inner, functions.Family):
            now = self._inner.family
        else:
            terms = getattr(self._inner, "terms", ())
            is_gaussian = len(gaussians.gaussians(self._spec)) == len(terms)
            now = "gaussian" if is_gaussian else _SEVERAL_TERMS
        about = known[now].summary().replace("``", "") if now in known else "A sum of functions."
        words = [*dict.fromkeys([*_families(), now])]
        tip = _FAMILY.format(name=now, summary=about)
        chosen = self._ui.combo("family", now, words, tip, width)
        if chosen == now:
            return
        if file := _file_of(family := known[chosen]):
            self._choose_values(family, file)
        else:
            example = family.example or family.family
            made = self._mapped(_example(example, self._mesh, self._vertex()))
            self._put(str(made), "family")

    def _draw_gaussians(self, bump: int) -> None:
        known = gaussians.gaussians(self._spec)
        if len(known) > 1:
            words = [f"bump {number + 1}" for number in range(len(known))]
            chosen = words.index(self._ui.radio(words, words[bump], [_BUMP] * len(words)))
            if chosen != bump:
                self._session.editor.select(side=self._side, bump=chosen)
                bump = chosen

        def put(gaussian: functions.Family, label: str) -> None:
            names = [parameter.name for parameter in gaussian.parameters()]
            values = {name: getattr(gaussian, name) for name in names}
            self._put(gaussians.changed(self._spec, bump, **values), label, bump)

        draw_parameters(self._ui, known[bump], self._mesh, put)

    def _draw_map(self, width: float) -> None:
        now = _NO_MAP if self._map is None else Path(self._map.path).name
        words = [_NO_MAP, *abfm.maps.KINDS, _MAP_FILE]
        words = words if now in words else [now, *words]
        chosen = self._ui.combo("map##vertex map", now, words, _MAP, width)
        function = _wrapped(self._wrappers, self._inner)
        permuted = partial(functions.Permuted, function=function)
        if chosen == _MAP_FILE:
            (file,) = functions.Permuted.parameters()
            self._choose("Open a vertex map", file, lambda path: permuted(path=path))
        elif chosen == _NO_MAP != now:
            self._put(str(function), "vertex map")
        elif chosen != now:
            self._put(str(permuted(path=chosen)), "vertex map")

    def _choose_values(self, family: type[functions.Family], file: functions.Parameter) -> None:
        title, name = "Open values at the vertices", file.name
        self._choose(title, file, lambda path: self._mapped(family(**{name: path})))

    def _choose(
        self, title: str, file: functions.Parameter, function: Callable[[str], functions.Spec]
    ) -> None:
        """Let the user choose a file, and then set this side to the function of the file."""

        def take(path: Path) -> None:
            with self._session.notices.showing_errors():
                self._session.editor.set_spec(self._side, str(function(str(path))))

        self._context.dialogs.open(title, file.kind.suffixes, take)

    def _vertex(self) -> int:
        """Return the vertex, as in the mesh file, of the first Gaussian or of the largest value."""
        for gaussian in gaussians.gaussians(self._spec):
            try:
                return gaussians.centre(gaussian, self._mesh)
            except FunctionError:  # a typed vertex that the mesh does not have
                continue
        values = self._session.values(self._side)
        return int(self._mesh.vertex_ids[0 if values is None else values.argmax()])


def _example(example: str, mesh: TriangleMesh, vertex: int) -> functions.Spec:
    """Return the function that an example describes, at a vertex numbered as in the file."""
    middle = f"{mesh.vertices[:, 1].mean():.3g}"
    return functions.parse(example.format(vertex=vertex, middle=middle))


def draw_parameters(ui: Ui, function: functions.Family, mesh: TriangleMesh, put: Put) -> None:
    """Draw the widgets for the shape and the parameters of a function, those with sliders last."""

    def draw_shape(width: float) -> None:
        about = ", or ".join(shape.summary for shape in function.shapes.values())
        chosen = ui.combo("shape", now, tuple(function.shapes), sentence(about), width)
        if chosen != now:
            other = _example(function.shapes[chosen].example, mesh, int(mesh.vertex_ids[0]))
            assert isinstance(other, functions.Family)
            put(other, "shape")

    now = function.shape()
    shape = function.shapes.get(now)
    controls = [
        _Control(ui, function, mesh, put, parameter)
        for parameter in function.parameters()
        if not (parameter.instead_of and getattr(function, parameter.name) is None)
        and (shape is None or parameter.name in shape.parameters)
    ]
    short: list[tuple[str, Callable[[float], None]]] = [
        (each.parameter.name, each.draw) for each in controls if each.ends is None
    ]
    if function.shapes:
        short.insert(0, ("shape", draw_shape))
    for pair in (short[at : at + 2] for at in range(0, len(short), 2)):
        names = [name for name, _ in pair]
        widths = ui.halves(*names) if len(pair) == 2 else (0.0,)
        for number, ((_, draw_one), width) in enumerate(zip(pair, widths, strict=True)):
            if number and width:
                ui.same_line()
            draw_one(width)
        for name in names:
            ui.refusal(name)
    for control in controls:
        if control.ends is not None:
            control.draw()


@dataclass(frozen=True)
class _Control:
    ui: Ui
    function: functions.Family
    mesh: TriangleMesh
    put: Put
    parameter: functions.Parameter

    @cached_property
    def ends(self) -> Range | None:
        """Range of the slider; None if the parameter is selected from a list or typed."""
        kind, slider = self.parameter.kind, self.parameter.slider
        if kind.choices or getattr(self.function, self.parameter.name) is None:
            return None
        found = slider(self.function, self.mesh) if callable(slider) else slider
        return found and Range(found.low, found.high, found.log, kind.integers)

    def draw(self, width: float = 0) -> None:
        ui, parameter = self.ui, self.parameter
        name, kind, value = parameter.name, parameter.kind, getattr(self.function, parameter.name)
        tip = sentence(parameter.summary + (f" ({parameter.unit})" if parameter.unit else ""))
        new: object = value
        if kind.choices:
            none = [parameter.empty] if parameter.default is None and parameter.empty else []
            now = parameter.empty if value is None else value
            chosen = ui.combo(name, now, (*none, *kind.choices), tip, width)
            new = None if chosen in none else chosen
        elif self.ends is not None:
            number = ui.number(name, float(value), self.ends, tip)
            if number is not None:
                new = round(number) if kind.integers and number == round(number) else number
        else:
            hint = "" if parameter.required else parameter.empty
            written = "" if value is None else str(value)
            written = ",".join(map(str, value)) if isinstance(value, tuple) else written
            typed = ui.text(name, written, tip, hint=hint, width=width)
            if typed is not None:
                new = typed if typed.strip() or parameter.required else parameter.default
        if new != value:
            self._change(name, new)

    def _change(self, name: str, new: object) -> None:
        """Set a parameter; if the new value is refused, show the reason below the widget."""
        parameters = self.function.parameters()
        replaced = {other.name: None for other in parameters if other.instead_of == name}
        with self.ui.refusals.refusing(name):
            changed = replace(self.function, **{name: new}, **replaced)
            for parameter in changed.parameters():
                if parameter.kind is functions.VERTICES:
                    for vertex in getattr(changed, parameter.name) or ():
                        self.mesh.local_vertex(vertex)
            self.put(changed, name)
