"""The widgets of a family of functions, made from the parameters that it declares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from abfm import FunctionError, TriangleMesh
from abfm.functions import Family, Parameter
from abfm.functions.indicator import Indicator
from abfm_viewer.widgets.toolkit import Ui

Put = Callable[[Family, str], None]
"""Takes a changed function and the label of the widget that changed it."""


@dataclass(frozen=True)
class _Range:
    """The ends of a slider."""

    low: float
    high: float
    log: bool = False
    whole: bool = False


_RANGES = {
    ("gaussian", "width"): _Range(0.01, 1, log=True),
    ("gaussian", "height"): _Range(-2, 2),
    ("eigenfunction", "index"): _Range(0, 50, whole=True),
    ("hks", "time"): _Range(1e-4, 1, log=True),
    ("hks", "eigenpairs"): _Range(1, 256, whole=True),
    ("wks", "energy"): _Range(0, 10),
    ("wks", "width"): _Range(0.01, 10, log=True),
    ("wks", "eigenpairs"): _Range(1, 256, whole=True),
    ("indicator", "radius"): _Range(0.01, 1, log=True),
}
_TIPS = {
    "vertex": "Where it is, counted as in the mesh file; of several, with commas, the nearest counts.",
    "formula": "In x, y and z, with sin, exp, sqrt, abs, min, where and the like, and comparisons. Enter takes it.",
    "eigenpairs": "How many terms the sum has: more are sharper and take longer.",
}
_DISC = ("vertex", "x", "y", "z", "radius")


def draw(ui: Ui, function: Family, mesh: TriangleMesh, put: Put) -> None:
    """Draw a widget for each parameter."""
    if isinstance(function, Indicator):
        function = _draw_shape(ui, function, mesh, put)
    for parameter in function.parameters():
        if _is_shown(function, parameter.name):
            _draw_parameter(ui, function, parameter, mesh, put)


def _is_shown(function: Family, name: str) -> bool:
    """Not x, y and z beside a vertex; of an indicator, what its shape has."""
    if name in ("x", "y", "z"):
        return getattr(function, name) is not None
    return not isinstance(function, Indicator) or (name in _DISC) == (function.radius is not None)


def _draw_shape(ui: Ui, function: Indicator, mesh: TriangleMesh, put: Put) -> Indicator:
    now = "disc" if function.radius is not None else "half-space"
    chosen = ui.combo("shape", now, ("disc", "half-space"), "A geodesic disc, or what lies above or below a plane.")
    if chosen != now:
        if chosen == "disc":
            function = Indicator(vertex=(int(mesh.vertex_ids[0]),), radius=0.2)
        else:
            function = Indicator(axis="y", above=float(f"{mesh.vertices[:, 1].mean():.3g}"))
        put(function, "shape")
    return function


def _draw_parameter(ui: Ui, function: Family, parameter: Parameter, mesh: TriangleMesh, put: Put) -> None:
    name, value = parameter.name, getattr(function, parameter.name)
    unit = f" ({parameter.unit})" if parameter.unit else ""
    tip = _TIPS.get(name) or f"{parameter.summary[0].upper()}{parameter.summary[1:]}{unit}."
    new: object = value
    ends = _range(function, name, mesh)
    if parameter.kind.choices and value is not None:
        new = ui.combo(name, value, parameter.kind.choices, tip)
    elif ends is not None and value is not None:
        number = ui.number(name, float(value), ends.low, ends.high, tip, log=ends.log, whole=ends.whole)
        if number is not None:
            new = round(number) if ends.whole and number == round(number) else number
    else:
        typed = ui.text(name, _text(value), tip, hint=_hint(function, parameter))
        if typed is not None:
            new = typed if typed.strip() or parameter.required else parameter.default
    if new != value:
        _change(ui, function, name, new, mesh, put)
    if ends is None or value is None:  # a number shows it itself
        ui.refusal(name)


def _change(ui: Ui, function: Family, name: str, new: object, mesh: TriangleMesh, put: Put) -> None:
    """Take a new value, or say in place why not."""
    values = {"vertex": new, "x": None, "y": None, "z": None} if name == "vertex" else {name: new}
    try:
        changed = replace(function, **values)
        for vertex in getattr(changed, "vertex", None) or ():
            mesh.local_vertex(vertex)
        put(changed, name)
    except FunctionError as error:
        ui.refuse(name, str(error))


def _range(function: Family, name: str, mesh: TriangleMesh) -> _Range | None:
    if isinstance(function, Indicator) and name in ("above", "below") and function.axis is not None:
        along = mesh.vertices[:, "xyz".index(function.axis)]
        low, high = float(along.min()), float(along.max())
        return _Range(low, high) if low < high else None
    return _RANGES.get((function.family, name))


def _text(value: object) -> str:
    if value is None:
        return ""
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _hint(function: Family, parameter: Parameter) -> str:
    if parameter.name == "vertex":
        return "at x, y, z"
    if isinstance(function, Indicator):
        return "no bound"
    return "" if parameter.required else "automatic"
