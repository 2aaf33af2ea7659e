"""What the monkey can do: each action does something that a user could, and may say what in a
few words.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from abfm import FunctionError
from abfm_viewer.errors import DriverError
from abfm_viewer.widgets.widget_record import Widget

if TYPE_CHECKING:
    from tests.attack.monkey import Monkey

_NONSENSE = (
    *("", " ", "%s%n", "\\", "9" * 500, "coordinate:x + coordinate:y"),
    *["nan", "inf", "-inf", "-1", "0", "0.5", "3", "1e-300", "1e300", "1e9", "1,5", "abc", "🦆"],
    *["gaussian:", "gaussian:vertex=1", "gaussian:vertex=999999,width=0.2"],
    *["gaussian:vertex=1,width=nan", "eigenfunction:2", "eigenfunction:100000", "expression:1/0"],
    *["expression:sin(5*x)*z", "expression:x**x**x", "file:nothing.npy", "geodesic:vertex=3"],
    *["curvature:mean", "permuted:no.txt(x)"],
)
_KEYS = (
    "ctrl+z ctrl+z ctrl+y ctrl+shift+z space left right home end esc esc p l f1 tab enter "
    "ctrl+enter ctrl+s ctrl+o ctrl+q up down a r w f 1 2 3"
)
LEFT_ALONE = ("Samples", "Save movie...", "Save picture...", "iterations", "UI scale", "Quit")
_CLICKED = ("button", "checkbox", "choice", "tab", "section", "item")


def _press(label: str) -> Callable[[Monkey, random.Random], str]:
    def press(monkey: Monkey, chance: random.Random) -> str:
        monkey.gui._click(monkey.widget(chance, "button", label=label))
        return ""

    return press


def _wait(monkey: Monkey, chance: random.Random) -> str:
    count = chance.choice((1, 2, 5, 20, 60))
    for _ in range(count):
        monkey.gui.frames(1)
        time.sleep(0.002)
    return str(count)


def _key(monkey: Monkey, chance: random.Random) -> str:
    key = chance.choice(_KEYS.split())
    monkey.gui.key(key)
    return key


def _slide(monkey: Monkey, chance: random.Random) -> str:
    widget = monkey.widget(chance, "slider")
    share = chance.choice((0.0, 1.0, chance.random()))
    ends = widget.ends
    value = ends.nearest(ends.low + share * (ends.high - ends.low))
    monkey.gui.drag(widget.label, value, within=_within(widget))
    return f"{widget.label} {value:.3g}"


def _type(monkey: Monkey, chance: random.Random) -> str:
    widget, text = monkey.widget(chance, "box"), chance.choice(_NONSENSE)
    monkey.gui.type(widget.label, text, within=_within(widget), enter=chance.random() < 0.8)
    return f"{widget.label} {text[:40]!r}"


def _choose(monkey: Monkey, chance: random.Random) -> str:
    widget = monkey.widget(chance, "combo")
    monkey.gui.click(widget.label, within=_within(widget))
    choices = [
        w.label
        for w in monkey.gui.window.ui.widgets
        if w.kind == "choice" and widget.label in w.section
    ]
    if not choices:
        monkey.gui.key("esc")
        return widget.label
    choice = chance.choice(choices)
    monkey.gui.click(choice, within=widget.name or widget.label)
    return f"{widget.label} {choice}"


def _click(monkey: Monkey, chance: random.Random) -> str:
    widget = monkey.widget(chance, *_CLICKED)
    monkey.gui.click(widget.label, within=_within(widget))
    return f"{widget.section}/{widget.label}"


def _menu(monkey: Monkey, chance: random.Random) -> str:
    menu = monkey.widget(chance, "menu").label
    monkey.gui.click(menu)
    for _ in range(3):
        items = [
            w
            for w in monkey.gui.window.ui.widgets
            if w.kind in ("item", "menu") and w.section and w.enabled and w.label not in LEFT_ALONE
        ]
        if not items:
            break
        chosen = chance.choice(items)
        monkey.gui._click(chosen)
        if chosen.kind == "item":
            return f"{menu}/{chosen.label}"
    monkey.gui.key("esc")
    return menu


def _tab(monkey: Monkey, chance: random.Random) -> str:
    tab = chance.choice(("Functions", "Match", "Look", "Export"))
    monkey.gui.window.ui.open_tab = tab
    monkey.gui.frames(2)
    return tab


def _pick(monkey: Monkey, chance: random.Random) -> str:
    ids = monkey.gui.session.surface().mesh.vertex_ids
    vertices = [int(chance.choice(ids)) for _ in range(chance.choice((1, 1, 3)))]
    side, modifiers = (
        chance.choice(("source", "target", "advected")),
        chance.choice((("shift",), ("shift",), ())),
    )
    try:
        monkey.gui.drag_on_surface(vertices, side, modifiers)
    except FunctionError as error:  # another mesh came meanwhile
        raise DriverError(str(error)) from error
    return f"{side} {vertices}"


def _wheel(monkey: Monkey, chance: random.Random) -> str:
    modifiers = chance.choice((("shift",), ()))
    vertex = int(chance.choice(monkey.gui.session.surface().mesh.vertex_ids))
    try:
        monkey.gui.wheel(
            chance.uniform(-5, 5), vertex, chance.choice(("source", "target")), modifiers
        )
    except FunctionError as error:
        raise DriverError(str(error)) from error
    return ""


def _open(monkey: Monkey, chance: random.Random) -> str:
    path = chance.choice(monkey.files)
    monkey.gui.window._dropped([str(path)])
    for _ in range(chance.choice((0, 3, 30))):
        monkey.gui.frames(1)
        time.sleep(0.003)
    return path.name


def _answer(monkey: Monkey, chance: random.Random) -> str:
    return _click(monkey, chance)


def _export(monkey: Monkey, chance: random.Random) -> str:
    name = chance.choice(
        ("out.npz", "out.ply", "out.vtu", "out.csv", "out.nothing", "no/such/folder/out.npz")
    )
    monkey.gui.click("Save result...")
    monkey.gui.type("file name", str(monkey.folder / name))
    return name


def _match(monkey: Monkey, chance: random.Random) -> str:
    monkey.gui._click(monkey.widget(chance, "button", label="Match"))
    _wait(monkey, chance)
    if chance.random() < 0.5:
        monkey.gui.wait(
            lambda session: not session.solver.running or session.solver.paused, seconds=20
        )
        return "to its end"
    return ""


def _labelled(label: str) -> Callable[[Monkey], bool]:
    return lambda monkey: bool(monkey.usable("button", label=label))


def _there(*kinds: str) -> Callable[[Monkey], bool]:
    return lambda monkey: bool(monkey.usable(*kinds))


def _asked(monkey: Monkey) -> bool:
    return monkey.gui.window.dialogs.is_open and bool(monkey.usable(*_CLICKED))


def _has_result(monkey: Monkey) -> bool:
    return monkey.gui.session.result is not None and not monkey.gui.window.dialogs.is_open


@dataclass(frozen=True)
class Action:
    """Something to do, how often, and when: what is there to be used is what a user would do
    something with.
    """

    weight: int
    act: Callable[[Monkey, random.Random], str]
    is_possible: Callable[[Monkey], bool] = lambda monkey: True


ACTIONS = {
    "match": Action(8, _match, _labelled("Match")),
    "pause": Action(4, _press("Pause"), _labelled("Pause")),
    "resume": Action(6, _press("Resume"), _labelled("Resume")),
    "cancel": Action(4, _press("Cancel"), _labelled("Cancel")),
    "wait": Action(6, _wait),
    "key": Action(8, _key),
    "slide": Action(7, _slide, _there("slider")),
    "type": Action(7, _type, _there("box")),
    "choose": Action(7, _choose, _there("combo")),
    "click": Action(8, _click, _there(*_CLICKED)),
    "menu": Action(4, _menu, _there("menu")),
    "tab": Action(4, _tab),
    "pick": Action(5, _pick),
    "wheel": Action(2, _wheel),
    "open": Action(5, _open),
    "answer": Action(20, _answer, _asked),
    "export": Action(2, _export, _has_result),
}


def _within(widget: Widget) -> str:
    return widget.section.split("/")[-1] if widget.section else ""
