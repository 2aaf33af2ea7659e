"""A few sequences of the monkey, in a process of their own: a process can draw in one way only."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from abfm_viewer.document.document import Document, Surface
from tests.attack.monkey import differences
from tests.attack.trial import Trial
from tests.processes import run
from tests.shapes import icosphere

ROOT = Path(__file__).parents[2]


def test_nothing_falls_over_and_undo_leads_back_to_the_start():
    command = [sys.executable, "-m", "tests.attack.monkey", "--seed", "1", "--count", "2"]
    done = run(*command, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    trials = [Trial.from_line(line) for line in done.stdout.splitlines()]
    assert [(trial.seed, trial.outcome, trial.detail) for trial in trials] == [
        (s, "ok", "") for s in range(1, 3)
    ]


def test_what_undo_should_have_taken_back_is_named():
    start = Document((Surface(icosphere(0), "sphere"),))
    assert differences(start, replace(start, time=0.5)) == []
    assert differences(start, replace(start, mask="coordinate:x", lines=())) == ["mask"]
    surfaces, view = (Surface(icosphere(0), "sphere"),), replace(start.view, arrows=True)
    assert differences(start, replace(start, surfaces=surfaces, view=view)) == ["surfaces", "view"]
