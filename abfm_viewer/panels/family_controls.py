"""The widgets of a family of functions, made from the parameters that it declares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

from abfm import TriangleMesh, functions
from abfm_viewer.widgets.toolkit import Ui

Put: TypeAlias = "Callable[[functions.Family, str], None]"
"""Takes a changed function and the label of the widget that changed it."""


def begun(example: str, mesh: TriangleMesh, vertex: int) -> functions.Spec:
    """A family's example, made for a mesh and a vertex as its file counts."""
    return functions.parse(example.format(vertex=vertex, middle=f"{mesh.vertices[:, 1].mean():.3g}"))


def draw(ui: Ui, function: functions.Family, mesh: TriangleMesh, put: Put) -> None:
    """Draw a widget for each parameter that the function has, and first the choice of its shape."""
    function = _draw_shape(ui, function, mesh, put)
    shape = function.shapes.get(function.shape())
    for parameter in function.parameters():
        is_replaced = parameter.instead_of and getattr(function, parameter.name) is None
        if not is_replaced and (shape is None or parameter.name in shape.parameters):
            _draw_parameter(ui, function, parameter, mesh, put)


def _draw_shape(ui: Ui, function: functions.Family, mesh: TriangleMesh, put: Put) -> functions.Family:
    if not function.shapes:
        return function
    about = ", or ".join(shape.summary for shape in function.shapes.values())
    now = function.shape()
    chosen = ui.combo("shape", now, tuple(function.shapes), f"{about[0].upper()}{about[1:]}.")
    if chosen != now:
        other = begun(function.shapes[chosen].example, mesh, int(mesh.vertex_ids[0]))
        assert isinstance(other, functions.Family)
        put(other, "shape")
        return other
    return function


def _draw_parameter(
    ui: Ui, function: functions.Family, parameter: functions.Parameter, mesh: TriangleMesh, put: Put
) -> None:
    """Draw a combo, a slider or a box to type into, whichever the kind of value asks for."""
    name, kind, value = parameter.name, parameter.kind, getattr(function, parameter.name)
    unit = f" ({parameter.unit})" if parameter.unit else ""
    tip = f"{parameter.summary[0].upper()}{parameter.summary[1:]}{unit}."
    ends = parameter.slider(function, mesh) if callable(parameter.slider) else parameter.slider
    new: object = value
    if kind.choices and value is not None:
        new = ui.combo(name, value, kind.choices, tip)
    elif ends is not None and value is not None:
        number = ui.number(name, float(value), ends.low, ends.high, tip, log=ends.log, whole=kind.whole)
        if number is not None:
            new = round(number) if kind.whole and number == round(number) else number
    else:
        written = ",".join(map(str, value)) if isinstance(value, tuple) else str("" if value is None else value)
        typed = ui.text(name, written, tip, hint="" if parameter.required else parameter.empty)
        if typed is not None:
            new = typed if typed.strip() or parameter.required else parameter.default
    if new != value:
        _change(ui, function, name, new, mesh, put)
    if ends is None or value is None:  # a number shows it itself
        ui.refusal(name)


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
