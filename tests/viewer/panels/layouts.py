"""What the window shows at several sizes and scales and in several states, as a program: JSON on
the standard output.

It draws nothing (`openGL_mock`), which takes a process of its own.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, replace

import numpy as np
import polyscope.imgui as imgui

from abfm.matching import Verdict
from abfm.matching.judging.verdict import Outcome, advice
from abfm.matching.solving.record import StopReason
from abfm.matching.terms.functions import FunctionTerm
from abfm.parameters import Parameters
from abfm_viewer.automation import Driver
from abfm_viewer.panels.right_panel import TABS
from abfm_viewer.widgets.toolkit import Ui
from tests.viewer.sessions import EGG, ENDLESS

SIZES = ((1000, 700), (1280, 800), (2560, 1440))
SCALES = (1.0, 2.0)
_WRITTEN = "saved /a/folder/with/a/name/that/is/long/enough/to/need/more/than/one/line/picture.png"


def two_channels_with_other_peaks() -> Verdict:
    """A verdict whose advice no button carries out: flow lines refute that one peak became two."""
    heights = EGG.vertices[:, 0] / np.ptp(EGG.vertices[:, 0])
    near, far = (np.exp(-20 * (heights - place) ** 2) for place in (heights.max(), heights.min()))
    problem = FunctionTerm(EGG, np.stack([near, heights], 1), np.stack([near + far, heights], 1))
    return advice(
        problem, Outcome(problem.target, 0.01, StopReason.CONVERGED, verified=0.5), Parameters()
    )


def _states(gui: Driver) -> Iterator[str]:
    """Bring the window from one state to the next."""
    yield "start"
    gui.session.editor.amend(parameters=ENDLESS)
    gui.session.match()
    gui.wait(lambda s: s.solver.snapshot is not None)
    gui.session.player.playing = False
    yield "running"
    gui.session.solver.cancel()
    gui.wait(lambda s: s.solver.finished and s.result is not None)
    gui.session.player.playing = False
    yield "matched"
    found = gui.session.result
    assert found is not None
    verdict = two_channels_with_other_peaks()
    advised = replace(found, stop_reason=StopReason.NO_PROGRESS, verdict=verdict)
    gui.session.editor.amend(result=advised)
    yield "advised"
    gui.session.editor.amend(result=found)
    gui.window.exporter.message = _WRITTEN
    yield "exported"
    gui.window.dialogs.show("A title", ["A line."])
    yield "asked"


def _layouts(
    gui: Driver, lines: list[dict[str, object]], notes: list[dict[str, object]]
) -> Iterator[dict[str, object]]:
    for state in _states(gui):
        for scale in SCALES:
            gui.session.editor.amend(view=replace(gui.session.view, ui_scale=scale))
            for tab in TABS:
                gui.window.ui.open_tab = tab
                gui.frames(3)
                lines.clear()
                notes.clear()
                gui.frames(1)
                assert not gui.errors
                widgets = [
                    asdict(w) | {"text_width": imgui.CalcTextSize(w.shown or w.label)[0]}
                    for w in gui.window.ui.widgets
                ]
                yield {
                    "state": state,
                    "scale": scale,
                    "tab": tab,
                    "widgets": widgets,
                    "lines": list(lines),
                    "notes": list(notes),
                    "hidden": dict(gui.window.ui.hidden_heights),
                    "parts": asdict(gui.window.parts),
                }


def _recorded(method: str) -> list[dict[str, object]]:
    """Texts that a method of `Ui` writes from now on, with their places."""
    found: list[dict[str, object]] = []
    write = getattr(Ui, method)

    def recorded(ui: Ui, text: str, *options: object, **more: object) -> None:
        write(ui, text, *options, **more)
        rect = (*imgui.GetItemRectMin(), *imgui.GetItemRectMax())
        found.append({"text": text, "rect": rect, "area": ui.record._areas[-1]})

    setattr(Ui, method, recorded)
    return found


def main() -> None:
    lines, notes = _recorded("line"), _recorded("note")
    found = []
    for size in SIZES:
        with Driver(EGG, backend="openGL_mock", size=size) as gui:
            found += [layout | {"size": size} for layout in _layouts(gui, lines, notes)]
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
