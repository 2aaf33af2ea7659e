"""The widgets of a family of functions, made from the parameters that it declares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeAlias

from abfm import TriangleMesh, functions
from abfm_viewer.document.verdict_words import sentence
from abfm_viewer.widgets.slider_range import Range
from abfm_viewer.widgets.toolkit import Ui

Put: TypeAlias = "Callable[[functions.Family, str], None]"
"""Takes a changed function and the label of the widget that changed it."""


def begun(example: str, mesh: TriangleMesh, vertex: int) -> functions.Spec:
    """Return a family's example, made for a mesh and a vertex as its file counts."""
    middle = f"{mesh.vertices[:, 1].mean():.3g}"
    return functions.parse(example.format(vertex=vertex, middle=middle))


def draw(ui: Ui, function: functions.Family, mesh: TriangleMesh, put: Put) -> None:
    """Draw a widget for each parameter that the function has, and first the choice of its shape.

    Those without a slider come first, two in a line where there is room.
    """
    controls = _Controls(ui, _draw_shape(ui, function, mesh, put), mesh, put)
    function = controls.function
    shape = function.shapes.get(function.shape())
    drawn = [
        parameter
        for parameter in function.parameters()
        if not (parameter.instead_of and getattr(function, parameter.name) is None)
        and (shape is None or parameter.name in shape.parameters)
    ]
    short = [parameter for parameter in drawn if controls.ends(parameter) is None]
    for left, right in zip(short[::2], short[1::2], strict=False):
        widths = ui.halves(left.name, right.name)
        controls.draw(left, widths[0])
        if widths[1]:
            ui.beside()
        controls.draw(right, widths[1])
        for parameter in (left, right):
            ui.refusal(parameter.name)
    if len(short) % 2:
        controls.draw(short[-1])
        ui.refusal(short[-1].name)
    for parameter in drawn:
        if parameter not in short:
            controls.draw(parameter)


def _draw_shape(
    ui: Ui, function: functions.Family, mesh: TriangleMesh, put: Put
) -> functions.Family:
    if not function.shapes:
        return function
    about = ", or ".join(shape.summary for shape in function.shapes.values())
    now = function.shape()
    chosen = ui.combo("shape", now, tuple(function.shapes), sentence(about))
    if chosen != now:
        other = begun(function.shapes[chosen].example, mesh, int(mesh.vertex_ids[0]))
        assert isinstance(other, functions.Family)
        put(other, "shape")
        return other
    return function


@dataclass(frozen=True)
class _Controls:
    """Draws widgets of a function's parameters, and puts the changed function into its place."""

    ui: Ui
    function: functions.Family
    mesh: TriangleMesh
    put: Put

    def ends(self, parameter: functions.Parameter) -> Range | None:
        """Return the ends of a parameter's slider; None for one that is chosen or typed."""
        if parameter.kind.choices or getattr(self.function, parameter.name) is None:
            return None
        slider = parameter.slider
        found = slider(self.function, self.mesh) if callable(slider) else slider
        return found and Range(found.low, found.high, found.log, parameter.kind.whole)

    def draw(self, parameter: functions.Parameter, width: float = 0) -> None:
        """Draw a combo, a slider or a box to type into, whichever the kind of value asks for."""
        name, kind, value = parameter.name, parameter.kind, getattr(self.function, parameter.name)
        unit = f" ({parameter.unit})" if parameter.unit else ""
        tip = sentence(f"{parameter.summary}{unit}")
        new: object = value
        if kind.choices and value is not None:
            new = self.ui.combo(name, value, kind.choices, tip, width)
        elif (ends := self.ends(parameter)) is not None:
            number = self.ui.number(name, float(value), ends, tip)
            if number is not None:
                new = round(number) if kind.whole and number == round(number) else number
        else:
            hint = "" if parameter.required else parameter.empty
            typed = self.ui.text(name, _written(value), tip, hint=hint, width=width)
            if typed is not None:
                new = typed if typed.strip() or parameter.required else parameter.default
        if new != value:
            self._change(name, new)

    def _change(self, name: str, new: object) -> None:
        """Take a new value, or say in place why not."""
        parameters = self.function.parameters()
        replaced = {other.name: None for other in parameters if other.instead_of == name}
        with self.ui.refusals.refusing(name):
            changed = replace(self.function, **{name: new}, **replaced)
            for parameter in changed.parameters():
                if parameter.kind is functions.VERTICES:
                    for vertex in getattr(changed, parameter.name) or ():
                        self.mesh.local_vertex(vertex)
            self.put(changed, name)


def _written(value: object) -> str:
    """Return a value as it is typed."""
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return "" if value is None else str(value)
