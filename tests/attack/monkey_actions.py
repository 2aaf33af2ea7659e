"""What the monkey can do: what a user could; each may say what in a few words."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from abfm import FunctionError
from abfm_viewer.errors import DriverError

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
_OUTPUTS = ("out.npz", "out.ply", "out.vtu", "out.csv", "out.nothing", "no/such/folder/out.npz")


def _press(label):
    return lambda monkey, chance: monkey.gui._click_on(monkey.widget(chance, "button", label=label))


def _frames(monkey, count, seconds):
    for _ in range(count):
        monkey.gui.frames(1)
        time.sleep(seconds)
    return str(count)


def _wait(monkey, chance):
    return _frames(monkey, chance.choice((1, 2, 5, 20, 60)), 0.002)


def _key(monkey, chance):
    key = chance.choice(_KEYS.split())
    monkey.gui.key(key)
    return key


def _slide(monkey, chance):
    widget = monkey.widget(chance, "slider")
    share, ends = chance.choice((0.0, 1.0, chance.random())), widget.ends
    value = ends.nearest(ends.low + share * (ends.high - ends.low))
    monkey.gui.drag(widget.label, value, within=_within(widget))
    return f"{widget.label} {value:.3g}"


def _type(monkey, chance):
    widget, text = monkey.widget(chance, "box"), chance.choice(_NONSENSE)
    monkey.gui.type(widget.label, text, within=_within(widget), enter=chance.random() < 0.8)
    return f"{widget.label} {text[:40]!r}"


def _choose(monkey, chance):
    widget = monkey.widget(chance, "combo")
    monkey.gui.click(widget.label, within=_within(widget))
    drawn = monkey.gui.window.ui.widgets
    choices = [w.label for w in drawn if w.kind == "choice" and widget.label in w.section]
    if not choices:
        monkey.gui.key("esc")
        return widget.label
    choice = chance.choice(choices)
    monkey.gui.click(choice, within=widget.name or widget.label)
    return f"{widget.label} {choice}"


def _click(monkey, chance):
    widget = monkey.widget(chance, *_CLICKED)
    monkey.gui.click(widget.label, within=_within(widget))
    return f"{widget.section}/{widget.label}"


def _menu(monkey, chance):
    menu = monkey.widget(chance, "menu").label
    monkey.gui.click(menu)
    for _ in range(3):
        items = [w for w in monkey.usable("item", "menu") if w.section]
        if not items:
            break
        chosen = chance.choice(items)
        monkey.gui._click_on(chosen)
        if chosen.kind == "item":
            return f"{menu}/{chosen.label}"
    monkey.gui.key("esc")
    return menu


def _tab(monkey, chance):
    tab = chance.choice(("Functions", "Match", "Look", "Export"))
    monkey.gui.window.ui.open_tab = tab
    monkey.gui.frames(2)
    return tab


def _pick(monkey, chance):
    ids = monkey.gui.session.surface().mesh.vertex_ids
    vertices = [int(chance.choice(ids)) for _ in range(chance.choice((1, 1, 3)))]
    side = chance.choice(("source", "target", "advected"))
    modifiers = chance.choice((("shift",), ("shift",), ()))
    try:
        monkey.gui.drag_on_surface(vertices, side, modifiers)
    except FunctionError as error:  # another mesh came meanwhile
        raise DriverError(str(error)) from error
    return f"{side} {vertices}"


def _wheel(monkey, chance):
    modifiers = chance.choice((("shift",), ()))
    vertex = int(chance.choice(monkey.gui.session.surface().mesh.vertex_ids))
    notches, side = chance.uniform(-5, 5), chance.choice(("source", "target"))
    try:
        monkey.gui.wheel(notches, vertex, side, modifiers)
    except FunctionError as error:
        raise DriverError(str(error)) from error


def _open(monkey, chance):
    path = chance.choice(monkey.files)
    monkey.gui.window._dropped([str(path)])
    _frames(monkey, chance.choice((0, 3, 30)), 0.003)
    return path.name


def _export(monkey, chance):
    name = chance.choice(_OUTPUTS)
    monkey.gui.click("Save result...")
    monkey.gui.type("file name", str(monkey.folder / name))
    return name


def _match(monkey, chance):
    _press("Match")(monkey, chance)
    _wait(monkey, chance)
    if chance.random() < 0.5:
        monkey.gui.wait(lambda s: not s.solver.running or s.solver.paused, seconds=20)
        return "to its end"
    return ""


def _within(widget):
    return widget.section.split("/")[-1]


def _there(*kinds, label=""):
    return lambda monkey: bool(monkey.usable(*kinds, label=label))


def _asked(monkey):
    return monkey.gui.window.dialogs.is_open and bool(monkey.usable(*_CLICKED))


def _has_result(monkey):
    return monkey.gui.session.result is not None and not monkey.gui.window.dialogs.is_open


@dataclass(frozen=True)
class Action:
    """Something to do, how often, and when it is possible."""

    weight: int
    act: Callable
    is_possible: Callable = lambda monkey: True


ACTIONS = {
    "match": Action(8, _match, _there("button", label="Match")),
    "pause": Action(4, _press("Pause"), _there("button", label="Pause")),
    "resume": Action(6, _press("Resume"), _there("button", label="Resume")),
    "cancel": Action(4, _press("Cancel"), _there("button", label="Cancel")),
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
    "answer": Action(20, _click, _asked),
    "export": Action(2, _export, _has_result),
}
