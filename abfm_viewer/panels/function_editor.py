"""One side of a channel: which family its function is of, and that family's parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from abfm import FunctionError
from abfm.functions import Family, Parameter, Spec, Sum, families, parse
from abfm.functions.permuted import Permuted
from abfm.mesh import TriangleMesh
from abfm_viewer import bumps
from abfm_viewer.document import Side
from abfm_viewer.session import Session
from abfm_viewer.ui import Ui

VALUES = (".npy", ".csv", ".txt", ".gii")
_SEVERAL = "several terms"
_FIRST = {
    "eigenfunction": "eigenfunction:1",
    "hks": "hks",
    "wks": "wks",
    "curvature": "curvature:mean",
    "coordinate": "coordinate:y",
    "geodesic": "geodesic:vertex={vertex}",
    "shape-diameter": "shape-diameter",
    "indicator": "indicator:vertex={vertex},radius=0.2",
    "expression": "expression:sin(10*x)*z",
    "gaussian": "gaussian:vertex={vertex},width=0.1",
}
"""What a family begins with; `vertex` is where the side's Gaussian was."""


@dataclass(frozen=True)
class _Range:
    low: float
    high: float
    log: bool = False
    whole: bool = False


_RANGES = {
    "width": _Range(0.01, 1, log=True),
    "height": _Range(-2, 2),
    "radius": _Range(0.01, 1, log=True),
    "index": _Range(0, 50, whole=True),
    "time": _Range(1e-4, 1, log=True),
    "energy": _Range(0, 10),
    "eigenpairs": _Range(1, 256, whole=True),
}


def draw(ui: Ui, session: Session, side: Side) -> None:
    """Draw the controls of the active channel's source or target."""
    assert session.active is not None
    spec = session.active.spec(side)
    tree = parse(spec)
    inner = tree.function if isinstance(tree, Permuted) else tree
    editor = _Editor(ui, session, side, tree if isinstance(tree, Permuted) else None)
    family = _family(inner)
    names = [cls.family for cls in families() if cls is not Permuted]
    tip = "What kind of function it is; the tooltip of each control says what it does."
    chosen = ui.combo("family", family, names if family in names else [*names, _SEVERAL], tip)
    if chosen != family:
        editor.choose(chosen, str(inner))
    elif family == "gaussian":
        _draw_gaussians(ui, session, side, editor, str(inner))
    elif isinstance(inner, Family):
        for parameter in inner.parameters():
            _draw_parameter(ui, session, inner, parameter, editor)
        if inner.family == "expression":
            editor.formula(inner)
    editor.draw_map(spec)
    typed = ui.text("spec", spec, "The function as text; sums with +, anything by hand. Enter takes it.")
    if typed is not None:
        editor.put(typed, "spec")
    ui.refusal("spec")
    problem = session.error(spec)
    if problem:
        ui.note(problem, "error")


def _family(inner: Spec) -> str:
    if isinstance(inner, Family):
        return inner.family
    only_gaussians = isinstance(inner, Sum) and len(bumps.gaussians(str(inner))) == len(inner.terms)
    return "gaussian" if only_gaussians else _SEVERAL


class _Editor:
    """Puts a changed function into its place: the side, inside its vertex map if it has one."""

    def __init__(self, ui: Ui, session: Session, side: Side, wrapper: Permuted | None) -> None:
        self._ui, self._session, self._side, self._wrapper = ui, session, side, wrapper

    def put(self, spec: str, label: str, merge: str = "") -> None:
        """Take a whole spec; if it is refused, say why under the widget of the label."""
        try:
            self._session.set_spec(self._side, spec, merge)
            self._ui.refuse(label, "")
        except FunctionError as error:
            self._ui.refuse(label, str(error))

    def put_inner(self, spec: str, label: str) -> None:
        """Take the function inside the vertex map; a drag of the widget is one step."""
        whole = spec if self._wrapper is None else str(replace(self._wrapper, function=parse(spec)))
        self.put(whole, label, f"{self._side} {label}")

    def choose(self, family: str, now: str) -> None:
        """Begin with another family, near where the function was."""
        if family == "file":
            take = partial(self._take_file, lambda path: f'file:"{path}"')
            self._ui.choose_to_open("Open values at the vertices", VALUES, take)
        elif family != _SEVERAL:
            spec = _FIRST[family].format(vertex=_near(now, self._session))
            self.put_inner(spec, "family")

    def formula(self, inner: Family) -> None:
        """A box for an expression."""
        text = str(inner).partition(":")[2]
        typed = self._ui.text("formula", text, "In x, y and z, with sin, exp, sqrt, abs, ... and comparisons.")
        if typed is not None:
            self.put_inner(f"expression:{typed}", "formula")
        self._ui.refusal("formula")

    def draw_map(self, spec: str) -> None:
        """Buttons to compose the function with a vertex map, or not."""
        if self._wrapper is None:
            tip = "Compose the function with a map of the vertices: a file with one vertex number per vertex."
            if self._ui.button("Vertex map...", tip):
                take = partial(self._take_file, lambda path: f'permuted:"{path}"({spec})')
                self._ui.choose_to_open("Open a vertex map", VALUES, take)
        else:
            if self._ui.button("Remove the map", "Take the function as it is."):
                self.put(str(self._wrapper.function), "spec")
            self._ui.beside()
            self._ui.note(f"through {Path(self._wrapper.path).name}")

    def _take_file(self, form: Callable[[str], str], path: Path) -> None:
        try:
            self._session.set_spec(self._side, form(str(path).replace('"', '""')))
        except FunctionError as error:
            self._session.say(str(error), is_error=True)


def _draw_gaussians(ui: Ui, session: Session, side: Side, editor: _Editor, spec: str) -> None:
    known = bumps.gaussians(spec)
    is_active = session.document.side == side
    bump = min(session.document.bump, len(known) - 1) if is_active else 0
    if len(known) > 1:
        words = [f"bump {number + 1}" for number in range(len(known))]
        chosen = ui.radio(words, words[bump], ["The Gaussian that the mouse and the sliders change."] * len(words))
        if words.index(chosen) != bump:
            session.select(side=side, bump=words.index(chosen))
    gaussian = known[bump]
    for parameter in gaussian.parameters():
        if parameter.name in ("x", "y", "z"):
            continue
        if parameter.name == "vertex":
            _draw_centre(ui, session, editor, spec, bump)
        else:
            _draw_parameter(ui, session, gaussian, parameter, editor, partial(_with_bump, spec, bump))
    if ui.button("Add Gaussian", "One more bump, as far as possible from the others."):
        editor.put_inner(bumps.added(spec, session.mesh), "family")
        session.select(side=side, bump=len(known))
    if len(known) > 1:
        ui.beside()
        if ui.button("Remove Gaussian", "Remove the bump that is chosen."):
            editor.put_inner(bumps.removed(spec, bump), "family")
            session.select(side=side, bump=max(bump - 1, 0))


def _with_bump(spec: str, bump: int, gaussian: Family) -> str:
    values = {entry.name: getattr(gaussian, entry.name) for entry in fields(gaussian) if entry.name != "vertex"}
    return bumps.changed(spec, bump, **values)


def _draw_centre(ui: Ui, session: Session, editor: _Editor, spec: str, bump: int) -> None:
    """The vertex of a Gaussian, as the mesh file counts."""
    try:
        now = str(bumps.centre(bumps.gaussians(spec)[bump], session.mesh))
    except FunctionError:
        now = "?"
    tip = "Where it sits, counted as in the mesh file. Or Shift-click, or Shift-drag, on the surface."
    typed = ui.text("vertex", now, tip)
    if typed is not None:
        try:
            session.mesh.local_vertex(int(typed))
            editor.put_inner(bumps.changed(spec, bump, vertex=int(typed)), "vertex")
        except ValueError:
            ui.refuse("vertex", f"{typed!r} is no whole number")
        except FunctionError as error:
            ui.refuse("vertex", str(error))
    ui.refusal("vertex")


def _draw_parameter(
    ui: Ui,
    session: Session,
    function: Family,
    parameter: Parameter,
    editor: _Editor,
    text: Callable[[Family], str] = str,
) -> None:
    """The widget of one parameter; `text` makes the whole function of the changed family."""
    name, value = parameter.name, getattr(function, parameter.name)
    tip = parameter.summary + (f" ({parameter.unit})" if parameter.unit else "")
    new: Any = None
    if function.family == "expression":
        return
    if parameter.kind.choices:
        chosen = ui.combo(name, value or "", parameter.kind.choices, tip)
        new = chosen if chosen != value else None
    elif name in _RANGES and value is not None:
        r = _RANGES[name]
        new = ui.number(name, float(value), r.low, r.high, tip, log=r.log, whole=r.whole)
        new = new if new is None or not r.whole else round(new)
    else:
        shown = "" if value is None else ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
        typed = ui.text(name, shown, tip, hint="none" if not parameter.required else "")
        new = typed if typed is not None else None
        if typed == "":
            new = _Cleared
    if new is not None:
        try:
            changed = replace(function, **{name: None if new is _Cleared else new})
            editor.put_inner(text(changed), name)
        except FunctionError as error:
            ui.refuse(name, str(error))
    if not (name in _RANGES and value is not None):
        ui.refusal(name)


class _Cleared:
    """A parameter whose text was deleted."""


def _near(spec: str, session: Session) -> int:
    """A vertex where the function now is: its Gaussian's, or of its largest value."""
    mesh: TriangleMesh = session.mesh
    known = bumps.gaussians(spec)
    if known:
        return bumps.centre(known[0], mesh)
    values = session.values("source")
    return int(mesh.vertex_ids[int(values.argmax())]) if values is not None else int(mesh.vertex_ids[0])
