"""One side of a channel: which family its function is of, and that family's controls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import abfm
from abfm import FunctionError, functions
from abfm_viewer.document import gaussians
from abfm_viewer.document.document import Side
from abfm_viewer.panels import family_controls
from abfm_viewer.panels.context import Context
from abfm_viewer.session.active_gaussian import active_gaussian

_SEVERAL = "several terms"
_FAMILY_TIP = "What kind of function it is. Sums can be typed below.\n\n{name}: {summary}"
_SPEC_TIP = "The function as text: terms with +, anything by hand. Enter takes it."
_ADD, _REMOVE = "Add Gaussian", "Remove Gaussian"
_NO_MAP, _MAP_FILE = "none", "file..."
_MAP_TIP = (
    "Compose the function with a map of the vertices: the mirror plane or the rotation by 180 "
    "degrees that the surface is found to have, or a file with one vertex number per vertex or "
    "pairs of vertices."
)


def draw(context: Context, side: Side) -> None:
    ui, session = context.ui, context.session
    assert session.active is not None
    spec = session.active.spec(side)
    editor = _Editor(context, side, spec)
    editor.draw_heading()
    left, right = ui.halves("family", "vertex map")
    editor.draw_family(left)
    if right:
        ui.beside()
    editor.draw_map(right)
    if editor.bump is not None:
        editor.draw_gaussians(editor.bump)
    elif isinstance(editor.inner, functions.Family):
        family_controls.draw(ui, editor.inner, session.surface(side).mesh, editor.put_inner)
        file = _file_of(type(editor.inner))
        if file is not None and ui.button("Browse...", "Choose the file."):
            editor.choose_file(type(editor.inner), file)
    typed = ui.text("spec", spec, _SPEC_TIP)
    if typed is not None:
        editor.put(typed, "spec")
    ui.refusal("spec", otherwise=session.error(side))


def _file_of(family: type[functions.Family]) -> functions.Parameter | None:
    """Return the parameter that names a file of values."""
    files = (parameter for parameter in family.parameters() if parameter.kind.suffixes)
    return None if family is functions.Permuted else next(files, None)


class _Editor:
    """Draws a side, and puts a changed function into its place, inside its vertex map."""

    def __init__(self, context: Context, side: Side, spec: str) -> None:
        self._ui, self._session, self._dialogs = context.ui, context.session, context.dialogs
        self._side, self._spec = side, spec
        self._mesh = context.session.surface(side).mesh
        self.bump = active_gaussian(context.session, side)
        tree = functions.parse(spec)
        self._map = tree if isinstance(tree, functions.Permuted) else None
        self.inner: functions.Spec = tree.function if isinstance(tree, functions.Permuted) else tree

    def put(self, spec: str, label: str, bump: int | None = None) -> None:
        """Take a whole spec, or say below the label's widget why not; a drag is one step."""
        with self._ui.refusals.refusing(label):
            self._session.editor.set_spec(self._side, spec, f"{self._side} {label}", bump)

    def put_inner(self, function: functions.Spec, label: str) -> None:
        self.put(str(self._mapped(function)), label)

    def _mapped(self, function: functions.Spec) -> functions.Spec:
        return function if self._map is None else replace(self._map, function=function)

    def draw_heading(self) -> None:
        """Draw the side's name, and at its right what adds or removes a Gaussian."""
        ui = self._ui
        color = ui.colors.source if self._side == "source" else ui.colors.target
        if self.bump is None:
            ui.heading(self._side, color)
            return
        count = len(gaussians.gaussians(self._spec))
        ui.heading(self._side, color, buttons=(_ADD, _REMOVE)[: 2 if count > 1 else 1])
        if ui.button(_ADD, "One more bump, as far as possible from the others."):
            with ui.refusals.refusing(_ADD):
                self.put(gaussians.added(self._spec, self._mesh), "family", count)
        if count > 1:
            ui.beside_if_fits(_REMOVE, is_button=True)
            if ui.button(_REMOVE, "Remove the bump that is chosen."):
                self.put(gaussians.removed(self._spec, self.bump), "family", max(self.bump - 1, 0))
        ui.refusal(_ADD)

    def draw_family(self, width: float) -> None:
        """Draw the combo of families; a new one begins with a function that is valid here."""
        known = {cls.family: cls for cls in functions.families()}
        names = [name for name in known if known[name] is not functions.Permuted]
        now = self._family()
        about = known[now].summary().replace("``", "") if now in known else "A sum of functions."
        tip = _FAMILY_TIP.format(name=now, summary=about)
        chosen = self._ui.combo("family", now, names if now in names else [*names, now], tip, width)
        if chosen == now:
            return
        if file := _file_of(family := known[chosen]):
            self.choose_file(family, file)
        else:
            example = family.example or family.family
            self.put_inner(family_controls.begun(example, self._mesh, self._vertex()), "family")

    def draw_gaussians(self, bump: int) -> None:
        """Draw the controls of one Gaussian, and which one of several it is."""
        ui, spec = self._ui, self._spec
        known = gaussians.gaussians(spec)
        if len(known) > 1:
            words = [f"bump {number + 1}" for number in range(len(known))]
            tip = "The Gaussian that the mouse and the widgets below change."
            chosen = words.index(ui.radio(words, words[bump], [tip] * len(words)))
            if chosen != bump:
                self._session.editor.select(side=self._side, bump=chosen)
                bump = chosen
        family_controls.draw(ui, known[bump], self._mesh, partial(self._put_bump, bump))

    def draw_map(self, width: float) -> None:
        """Draw the combo of vertex maps that the function is composed with."""
        now = _NO_MAP if self._map is None else Path(self._map.path).name
        words = [_NO_MAP, *abfm.maps.KINDS, _MAP_FILE]
        words = words if now in words else [now, *words]
        chosen = self._ui.combo("vertex map", now, words, _MAP_TIP, width)
        if chosen == _MAP_FILE:
            (file,) = functions.Permuted.parameters()
            self._choose("Open a vertex map", file, self._permuted)
        elif chosen == _NO_MAP != now:
            self.put(str(self.inner), "vertex map")
        elif chosen != now:
            self.put(str(self._permuted(chosen)), "vertex map")

    def _permuted(self, path: str) -> functions.Spec:
        return functions.Permuted(path=path, function=self.inner)

    def choose_file(self, family: type[functions.Family], file: functions.Parameter) -> None:
        """Let the user choose the file that a function reads; nothing changes before."""

        def read(path: str) -> functions.Spec:
            return self._mapped(family(**{file.name: path}))

        self._choose("Open values at the vertices", file, read)

    def _choose(
        self, title: str, file: functions.Parameter, function: Callable[[str], functions.Spec]
    ) -> None:
        def take(path: Path) -> None:
            try:
                self._session.editor.set_spec(self._side, str(function(str(path))))
            except FunctionError as error:
                self._session.notices.say(str(error), is_error=True)

        self._dialogs.open(title, file.kind.suffixes, take)

    def _put_bump(self, bump: int, gaussian: functions.Family, label: str) -> None:
        names = [parameter.name for parameter in gaussian.parameters()]
        values = {name: getattr(gaussian, name) for name in names}
        self.put(gaussians.changed(self._spec, bump, **values), label, bump)

    def _family(self) -> str:
        if isinstance(self.inner, functions.Family):
            return self.inner.family
        terms = getattr(self.inner, "terms", ())
        return "gaussian" if len(gaussians.gaussians(self._spec)) == len(terms) else _SEVERAL

    def _vertex(self) -> int:
        """Return the vertex, as in the file, of its first Gaussian, or where it is largest."""
        mesh = self._mesh
        for gaussian in gaussians.gaussians(self._spec):
            try:
                return gaussians.centre(gaussian, mesh)
            except FunctionError:  # a vertex that was typed and is not there
                continue
        values = self._session.values(self._side)
        return int(mesh.vertex_ids[0 if values is None else values.argmax()])
