"""Texts and widgets of each panel in each state, compared with tests/snapshots/panels.txt.

This file is also a program that draws the states without a screen and prints them.
"""

import re
import sys
from concurrent.futures import Future
from dataclasses import replace
from difflib import unified_diff
from pathlib import Path
from types import SimpleNamespace

import numpy as np

import abfm
from abfm.matching import Remedy, StopReason, Verdict
from abfm.outcome import Facts, Outcome
from abfm.sequences import defaults
from abfm.sequences.frames import check_frames
from abfm.workers.control import Control
from abfm_viewer.automation import Driver
from abfm_viewer.computing.iterates import IteratePicture
from abfm_viewer.computing.matching import Snapshot
from abfm_viewer.computing.run import RunState
from abfm_viewer.document.comparison import Comparison
from abfm_viewer.document.document import Channel, RunRecord, Surface
from abfm_viewer.document.frame_sequence import FrameSequence
from abfm_viewer.document.kinds import PairDocument, SequenceDocument, SubjectDocument
from abfm_viewer.document.result_table import ResultRow, ResultTable
from abfm_viewer.panels.right_panel import TABS
from abfm_viewer.session.result_tables import FoundTable
from abfm_viewer.shown import quantities
from abfm_viewer.widgets.toolkit import Ui
from abfm_viewer.widgets.widget_record import WidgetRecord
from tests.processes import run
from tests.shapes import ellipsoid
from tests.viewer.computing.test_matching import iterate

SNAPSHOT = Path(__file__).parents[2] / "snapshots" / "panels.txt"
MESH = ellipsoid(2, 1.0, 0.7, 0.55)
PARAMETERS = abfm.Parameters.of(iterations=3, refine=0)
CHANNEL = Channel("coordinate:x", "coordinate:y")
MASKED = (re.compile(r"\d+ fps"), re.compile(r"\d+(\.\d+)? (ms|s|min)\b"))


# The program


class Drawn:
    """Texts and widgets in the order in which they are drawn."""

    def __init__(self):
        self.lines = []
        for name in ("line", "note", "heading"):
            self._record(name)
        add = WidgetRecord.add

        def added(record, label, kind, rect, *given, **details):
            add(record, label, kind, rect, *given, **details)
            widget = record._drawn[-1]
            if kind not in ("menu", "tab") and rect[0] > -1e3:
                state = "" if widget.enabled else " (disabled)"
                self.lines.append(f"[{kind}] {label}: {widget.text}".rstrip(": ") + state)

        WidgetRecord.add = added

    def _record(self, name):
        write = getattr(Ui, name)

        def written(ui, text, *given, **more):
            write(ui, text, *given, **more)
            if text:
                self.lines.append(text)

        setattr(Ui, name, written)


def result_of(match, kind, reason="", *remedies, stop_reason=StopReason.CONVERGED):
    residual = {Outcome.MATCHED: 0.04, Outcome.NEARLY: 0.1}.get(kind, 0.6)
    verdict = Verdict(kind, reason, "smooth the functions", remedies)
    return replace(
        match,
        verdict=verdict,
        stop_reason=stop_reason,
        residual=residual,
        verified_residual=residual + 0.005,
        folded=0.0,
    )


def begin_match(session):
    """Let a match run that computes nothing."""
    solver, matching = session.solver, session.matching
    now = iterate(iteration=7, vertices=162, view=IteratePicture(None), attempt=2, attempts=2)
    now = replace(now, residual=0.5)
    matching.problem = session.work.problem
    matching.snapshot = Snapshot(matching.problem, now, replace(now, residual=0.2))
    for number in range(3):
        matching._history.add(replace(now, attempt=1 + number // 2))
    solver._working, solver._control = Future(), Control()
    matching.running, solver.state = True, RunState.RUNNING


def end_match(session):
    session.matching.running, session.matching.snapshot = False, None
    session.solver.state = RunState.ENDED


def states_of_a_match(gui):
    session = gui.session
    session.editor.amend(channels=(CHANNEL,), parameters=PARAMETERS)
    gui.wait(lambda s: not s.obstacle)
    gui.wait(lambda s: s.work.expected_facts is not None)
    yield "no match", TABS
    begin_match(session)
    yield "running", TABS
    session.solver.state = RunState.PAUSED
    yield "paused", ["Match"]
    end_match(session)
    session.solver.state, session.solver.reason = RunState.FAILED, "memory ran out"
    yield "failed", ["Match"]
    end_match(session)
    match = abfm.match(MESH, MESH.vertices[:, 0], MESH.vertices[:, 1], PARAMETERS)
    record = RunRecord(match.energy_history, match.stages, (), 0.04, "")
    more = Remedy("More time", "use more iterations, such as 100", {"iterations": 100})
    session.editor.amend(result=result_of(match, Outcome.MATCHED), runs=(record,))
    yield "matched", TABS
    session.editor.amend(result=result_of(match, Outcome.NEARLY, "a reason", more))
    yield "nearly matched", ["Match"]
    session.editor.amend(result=result_of(match, Outcome.NOT_REACHED, "a reason", more))
    yield "not reached", ["Match"]
    session.editor.amend(result=result_of(match, Outcome.IMPOSSIBLE, "the ranges differ"))
    yield "impossible", ["Match"]
    interrupted = result_of(match, Outcome.NEARLY, "stopped", stop_reason=StopReason.CANCELLED)
    session.editor.amend(result=interrupted)
    yield "interrupted", ["Match"]
    session.editor.set_parameter(alpha=0.5)
    gui.wait(lambda s: s.work.expected_facts is not None)
    yield "outdated", TABS


def states_of_a_pair(gui):
    surfaces = Surface(MESH, "a.off"), Surface(MESH, "b.off")
    document = PairDocument(surfaces, (CHANNEL,), initial="connectivity", parameters=PARAMETERS)
    gui.session.restore(document, {}, None)
    gui.wait(lambda s: not s.obstacle)
    gui.wait(lambda s: s.work.expected_facts is not None)
    yield "no match", TABS
    begin_match(gui.session)
    yield "running", ["Match", "Export"]
    end_match(gui.session)
    match = abfm.match(MESH, MESH.vertices[:, 0], MESH.vertices[:, 1], PARAMETERS)
    initial = gui.session.work.prepared.initial
    gui.session.editor.amend(result=result_of(match, Outcome.MATCHED), initial_map=initial)
    gui.wait(lambda s: s.work.facts is not None and s.work.facts.is_complete)
    yield "matched", ["Match", "Look", "Export"]
    gui.session.editor.set_parameter(alpha=0.5)
    gui.wait(lambda s: s.work.expected_facts is not None)
    yield "outdated", ["Match", "Export"]


def states_of_a_subject(gui):
    values = np.stack([MESH.vertices, MESH.vertices[:, [1, 2, 0]]])
    population = SimpleNamespace(
        names=["sub-1", "sub-2"],
        fits=np.array([False, True]),
        values=values,
        verdicts=["registered", "registered"],
        reasons=["the correlation is low", ""],
        mean_of_others=lambda subject, channel: values[1 - subject, :, channel],
    )
    comparison = Comparison(population, 0, {CHANNEL.specs: 0})
    document = SubjectDocument((Surface(MESH, "sub-1"),), (CHANNEL,), comparison=comparison)
    gui.session.restore(document, {}, None)
    gui.wait(lambda s: not s.obstacle)
    yield "an outlier", ["Match"]


def states_of_a_sequence(gui):
    frames = np.stack([MESH.vertices[:, 0], MESH.vertices[:, 1]])
    sequence = FrameSequence("frames.npy", check_frames(MESH, frames, None, None, None))
    document = SequenceDocument((Surface(MESH, "a.off"),), sequence)
    gui.session.restore(document, {}, None)
    gui.frames(2)
    yield "no match", TABS
    found = abfm.sequence(MESH, frames, None, defaults(sigma=0.5))
    run, solver = gui.session.sequence_match, gui.session.solver
    run.running_document, run._fields = document, {0: found.velocity[0]}
    solver._working, solver._control, solver.state = Future(), Control(), RunState.RUNNING
    yield "running", ["Match", "Look", "Export"]
    run.running_document, run._fields, solver.state = None, {}, RunState.ENDED
    gui.session.editor.amend(result=found)
    yield "matched", ["Match", "Look", "Export"]
    gui.session.editor.amend(settings=replace(document.settings, gamma=0.5))
    yield "outdated", ["Match", "Export"]


def states_of_a_table(gui):
    numbers = {"residual": 0.0123, "verified_residual": 0.02, "folded": 0.0, "log2_area": 0.25}
    facts = Facts(Outcome.MATCHED, "matched", "confirmed", numbers=numbers)
    failed = Facts(Outcome.FAILED, "failed", "the file does not exist")
    rows = ResultRow(0, "one", facts, Path("one.npz")), ResultRow(1, "two", failed)
    table, tables = ResultTable(Path("results"), "a batch", rows), gui.window.files.tables
    reader = SimpleNamespace(read=lambda anew: table)
    tables.take(FoundTable(reader, table, rows[0], None))
    yield "a row", ["Match"]
    tables.selected = tuple(row.key for row in rows)
    tables.is_comparing = True
    yield "two rows", ["Match"]


def main():
    quantities.TEXELS = 128  # nothing is drawn
    drawn = Drawn()
    kinds = {
        "match": states_of_a_match,
        "pair": states_of_a_pair,
        "subject": states_of_a_subject,
        "sequence": states_of_a_sequence,
        "table": states_of_a_table,
    }
    with Driver(MESH, backend="openGL_mock", size=(1600, 1000)) as gui:
        for kind, states in kinds.items():
            for state, tabs in states(gui):
                gui.session.player.playing = False
                for tab in tabs:
                    gui.window.ui.open_tab = tab
                    gui.frames(2)
                    gui.wait(lambda _: not gui.window.shown.busy)
                    drawn.lines.clear()
                    gui.frames(1)
                    assert not gui.errors, gui.errors
                    print(f"\n== {kind}, {state}: {tab}")
                    print("\n".join(drawn.lines))
        gui.session.solver.state = RunState.ENDED


# The test


def test_panels_are_as_in_the_snapshot(request):
    """Each panel in each state has the texts, widgets and values of the snapshot."""
    root = Path(__file__).parents[3]
    done = run(sys.executable, "-m", "tests.viewer.panels.test_panel_states", cwd=root)
    assert done.returncode == 0, done.stderr
    drawn = done.stdout
    for pattern in MASKED:
        drawn = pattern.sub("N", drawn)
    if request.config.getoption("--update-snapshots"):
        SNAPSHOT.write_text(drawn, encoding="utf-8")
        return
    expected = SNAPSHOT.read_text(encoding="utf-8")
    changes = unified_diff(expected.splitlines(), drawn.splitlines(), lineterm="", n=3)
    assert drawn == expected, "\n".join(["--update-snapshots accepts:", *changes])


if __name__ == "__main__":
    main()
