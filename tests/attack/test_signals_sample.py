"""A few of the signals and kills that `signals` and `kills` send in great numbers."""

from __future__ import annotations

import random
import sys

import pytest

from tests.attack import kills, signals

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="looks at processes through /proc"
)


def test_a_signal_ends_a_command_with_one_line_and_nothing_left(tmp_path):
    attack = signals.Attack(tmp_path, random.Random(3), {"match": 2.0, "map": 1.0})
    assert [outcome for name in ("match", "map") if (outcome := attack.one(name)).faults] == []


def test_a_kill_leaves_the_old_file_or_the_new_one(tmp_path):
    attack = kills.Attack(tmp_path, random.Random(1))
    outcomes = [attack.one(what) for what in attack.savings for _ in range(3)]
    assert [outcome for outcome in outcomes if outcome.faults] == []
    assert any(outcome.left for outcome in outcomes)  # else nothing was killed while it wrote
