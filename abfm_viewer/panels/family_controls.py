"""The widgets of a family of functions, made from the parameters that it declares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

from abfm import TriangleMesh, functions
from abfm_viewer.document.wording import sentence
from abfm_viewer.widgets.toolkit import Ui

if TYPE_CHECKING:
    from abfm.functions.family import Slider

Put: TypeAlias = "Callable[[functions.Family, str], None]"
"""Takes a changed function and the label of the widget that changed it."""


def begun(example: str, mesh: TriangleMesh, vertex: int) -> functions.Spec:
    """A family's example, made for a mesh and a vertex as its file counts."""
    return functions.parse(example.format(vertex=vertex, middle=f"{mesh.vertices[:, 1].mean():.3g}"))


def draw(ui: Ui, function: functions.Family, mesh: TriangleMesh, put: Put) -> None:
    """Draw a widget for each parameter that the function has, and first the choice of its shape.

    Those without a slider come first, two in a line where there is room.
    """
    function = _draw_shape(ui, function, mesh, put)
    shape = function.shapes.get(function.shape())
    drawn = [
        parameter
        for parameter in function.parameters()
        if not (parameter.instead_of and getattr(function, parameter.name) is None)
        and (shape is None or parameter.name in shape.parameters)
    ]
    short = [parameter for parameter in drawn if _slider(function, parameter, mesh) is None]
    for left, right in zip(short[::2], short[1::2], strict=False):
        widths = ui.halves(left.name, right.name)
        _draw_parameter(ui, function, left, mesh, put, widths[0])
        if widths[1]:
            ui.beside()
        _draw_parameter(ui, function, right, mesh, put, widths[1])
        for parameter in (left, right):
            ui.refusal(parameter.name)
    if len(short) % 2:
        _draw_parameter(ui, function, short[-1], mesh, put)
        ui.refusal(short[-1].name)
    for parameter in drawn:
        if parameter not in short:
            _draw_parameter(ui, function, parameter, mesh, put)


def _slider(function: functions.Family, parameter: functions.Parameter, mesh: TriangleMesh) -> Slider | None:
    """The ends of the slider of a parameter; None for one that is chosen or typed."""
    if parameter.kind.choices or getattr(function, parameter.name) is None:
        return None
    return parameter.slider(function, mesh) if callable(parameter.slider) else parameter.slider


def _draw_shape(ui: Ui, function: functions.Family, mesh: TriangleMesh, put: Put) -> functions.Family:
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


def _draw_parameter(
    ui: Ui,
    function: functions.Family,
    parameter: functions.Parameter,
    mesh: TriangleMesh,
    put: Put,
    width: float = 0,
) -> None:
    """Draw a combo, a slider or a box to type into, whichever the kind of value asks for."""
    name, kind, value = parameter.name, parameter.kind, getattr(function, parameter.name)
    unit = f" ({parameter.unit})" if parameter.unit else ""
    tip = sentence(f"{parameter.summary}{unit}")
    ends = _slider(function, parameter, mesh)
    new: object = value
    if kind.choices and value is not None:
        new = ui.combo(name, value, kind.choices, tip, width)
    elif ends is not None:
        number = ui.number(name, float(value), ends.low, ends.high, tip, log=ends.log, whole=kind.whole)
        if number is not None:
            new = round(number) if kind.whole and number == round(number) else number
    else:
        written = ",".join(map(str, value)) if isinstance(value, tuple) else str("" if value is None else value)
        typed = ui.text(name, written, tip, hint="" if parameter.required else parameter.empty, width=width)
        if typed is not None:
            new = typed if typed.strip() or parameter.required else parameter.default
    if new != value:
        _change(ui, function, name, new, mesh, put)


def _change(ui: Ui, function: functions.Family, name: str, new: object, mesh: TriangleMesh, put: Put) -> None:
    """Take a new value, or say in place why not."""
    replaced = {other.name: None for other in function.parameters() if other.instead_of == name}
    with ui.refusing(name):
        changed = replace(function, **{name: new}, **replaced)
        for parameter in changed.parameters():
            if parameter.kind is functions.VERTICES:
                for vertex in getattr(changed, parameter.name) or ():
                    mesh.local_vertex(vertex)
        put(changed, name)
