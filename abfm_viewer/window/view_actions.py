"""From which side the surfaces are seen, how they are drawn, and which: the choices of the View menu and their keys."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from abfm_viewer.document.document import Front, Look, triple
from abfm_viewer.session.session import Session
from abfm_viewer.window.action import Action

AXES = ("x", "y", "z", "-x", "-y", "-z")


def axis_front(axis: str) -> Front:
    """The side that an axis points out of, with y upwards or, from above and below, z to or from the viewer."""
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
            axis: of_view(f"look from {axis}", partial(self._look_from, axis), (_chord(axis),)) for axis in AXES
        }
        self.wireframe = of_view("wireframe", partial(self._switch, "wireframe", "the wireframe"), ("W",))
        self.flat = of_view("flat or smooth", partial(self._switch, "flat", "flat shading"), ("F",))
        self.hide = of_view("hide the surface under the mouse", self._hide, ("H",))
        self.show_all = of_view("show all surfaces", self._show_all, ("Shift+H",))
        named = (self.reset, *self.axes.values(), self.wireframe, self.flat, self.hide, self.show_all)
        self.all: tuple[Action, ...] = named

    def hide_or_show(self, name: str) -> None:
        """Hide a surface, unless it is the last one, or show it again."""
        view = self._session.view
        if name in view.hidden:
            self._session.set_view(f"show {name}", hidden=tuple(one for one in view.hidden if one != name))
        elif view.shown_surfaces == (name,):
            self._session.say(f"{name} is the only surface that is shown")
        else:
            large = "" if view.large == name else view.large
            self._session.set_view(f"hide {name}", hidden=(*view.hidden, name), large=large)

    def back(self) -> bool:
        """Show all surfaces again where one is large; whether one was."""
        view = self._session.view
        is_large = view.large in view.shown_surfaces and len(view.shown_surfaces) > 1
        if is_large:
            self._session.amend(view=replace(view, large=""))
        return is_large

    def _reset(self) -> None:
        self._session.set_view("look from the front", look=None)

    def _look_from(self, axis: str) -> None:
        look = self._session.view.look
        front = axis_front(axis)
        self._session.set_view(f"look from {axis}", look=replace(look, front=front) if look else Look(front))

    def _switch(self, name: str, what: str) -> None:
        shown = getattr(self._session.view, name)
        self._session.set_view(f"{'hide' if shown else 'show'} {what}", "", **{name: not shown})

    def _hide(self) -> None:
        if name := self._over():
            self.hide_or_show(name)
        else:
            self._session.say("H hides the surface under the mouse: point at one")

    def _show_all(self) -> None:
        self._session.set_view("show all surfaces", hidden=(), large="")


def _chord(axis: str) -> str:
    return f"Shift+{axis[1:].upper()}" if axis.startswith("-") else axis.upper()
