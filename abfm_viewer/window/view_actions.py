"""Actions of the View menu: from which side, how, and which surfaces are seen."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from abfm_viewer.document.document import Front, Look, triple
from abfm_viewer.session.session import Session
from abfm_viewer.window.action import Action

AXES = ("x", "y", "z", "-x", "-y", "-z")


def axis_front(axis: str) -> Front:
    """Return the side that an axis points out of; seen along y, z is upright."""
    direction = (-1.0 if axis.startswith("-") else 1.0) * np.eye(3)["xyz".index(axis[-1])]
    up = np.eye(3)[1] if axis[-1] != "y" else -direction[1] * np.eye(3)[2]
    return Front(triple(direction), triple(up))


class ViewActions:
    """Actions on a session's view; `over` names the surface under the mouse, or is empty."""

    def __init__(self, session: Session, over: Callable[[], str]) -> None:
        self._session, self._over = session, over
        of_view = partial(Action, "View")
        self.reset = of_view("look from the front again", self._reset, ("R",))
        self.axes = {
            axis: of_view(f"look from {axis}", partial(self._look_from, axis), (_chord(axis),))
            for axis in AXES
        }
        wireframe = partial(self._switch, "wireframe", "the wireframe")
        self.wireframe = of_view("wireframe", wireframe, ("W",))
        flat = partial(self._switch, "flat", "flat shading")
        self.flat = of_view("flat or smooth", flat, ("F",))
        self.hide = of_view("hide the surface under the mouse", self._hide, ("H",))
        self.show_all = of_view("show all surfaces", self._show_all, ("Shift+H",))
        how = (self.wireframe, self.flat, self.hide, self.show_all)
        self.all: tuple[Action, ...] = (self.reset, *self.axes.values(), *how)

    def hide_or_show(self, name: str) -> None:
        """Hide a surface, unless it is the last one, or show it again."""
        view = self._session.view
        if name in view.hidden:
            others = tuple(one for one in view.hidden if one != name)
            self._session.editor.set_view(f"show {name}", hidden=others)
        elif view.shown_surfaces == (name,):
            self._session.notices.say(f"{name} is the only surface that is shown")
        else:
            large = "" if view.large == name else view.large
            self._session.editor.set_view(f"hide {name}", hidden=(*view.hidden, name), large=large)

    def back(self) -> bool:
        """Show all surfaces again where one is large; whether one was."""
        view = self._session.view
        is_large = view.large in view.shown_surfaces and len(view.shown_surfaces) > 1
        if is_large:
            self._session.editor.amend(view=replace(view, large=""))
        return is_large

    def _reset(self) -> None:
        self._session.editor.set_view("look from the front", look=None)

    def _look_from(self, axis: str) -> None:
        look, front = self._session.view.look, axis_front(axis)
        seen = replace(look, front=front) if look else Look(front)
        self._session.editor.set_view(f"look from {axis}", look=seen)

    def _switch(self, name: str, what: str) -> None:
        shown = getattr(self._session.view, name)
        step = f"{'hide' if shown else 'show'} {what}"
        self._session.editor.set_view(step, "", **{name: not shown})

    def _hide(self) -> None:
        if name := self._over():
            self.hide_or_show(name)
        else:
            self._session.notices.say("H hides the surface under the mouse: point at one")

    def _show_all(self) -> None:
        self._session.editor.set_view("show all surfaces", hidden=(), large="")


def _chord(axis: str) -> str:
    return f"Shift+{axis[1:].upper()}" if axis.startswith("-") else axis.upper()
