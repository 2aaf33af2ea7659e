"""Some of what the parts of the attack do in great numbers, and that they tell what goes wrong."""

import random
import re
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest

from abfm_viewer.document.document import Document, Surface
from tests.attack import doors, kills, monkey, signals, trial
from tests.attack.hostile import hostile
from tests.attack.monkey import Endurance, counts, differences
from tests.attack.mutations import mutant
from tests.attack.specimens import Specimen, specimens
from tests.attack.trial import Tally, Trial
from tests.attack.victim import Victim
from tests.processes import ROOT, run
from tests.shapes import icosphere

posix = pytest.mark.skipif(sys.platform == "win32", reason="bounds a process as POSIX does")
linux = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="looks at processes through /proc"
)
# what victims do that none should, and what is to be told of it
ACTS = {
    "raise KeyError('x')": "KeyError: 'x' (outside of abfm)",
    "from abfm import AbfmError; e = AbfmError(); e.args = ('two\\nlines',); raise e": "an error "
    "of 2 lines",
    "from abfm import AbfmError; raise AbfmError('None' 'Type object')": "in the words of Python",
    "import os; os.abort()": "the process died: SIGABRT",
    "import os; os.write(2, b'oh')": "it said: 'oh'",
    "import warnings; warnings.warn('beware')": "it said: 'UserWarning: beware'",
    "len(b'x' * 200 * 10**6)": " MB of memory",
    "while True: pass": "more than 1 s of CPU time",
}


def decoy(seed):
    """An attacker: the act of a number."""
    doors.DOORS["spec"] = lambda path: exec(path.read_text())
    return Specimen("a.spec", "spec", list(ACTS)[seed].encode()), "decoy"


@posix
def test_every_specimen_comes_in(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a, (b).csv").write_text("depth,x\n" + "1,2\n" * 43)
    for name, specimen in specimens().items():
        for file, content in {name: specimen.content, **specimen.beside}.items():
            (tmp_path / file).write_bytes(content)
        doors.enter(specimen.door, tmp_path / name)


def test_a_seed_gives_the_same_file_every_time():
    for attacker in (mutant, hostile):
        first, again = ([attacker(seed)[0].content for seed in range(8)] for _ in range(2))
        assert first == again
    assert len({mutant(seed)[1] for seed in range(100)}) > 50


@posix
@pytest.mark.parametrize(
    ("part", "attacker", "seeds"),
    [("mutations", "mutant", range(600)), ("hostile", "hostile", range(21))],
)
def test_files_are_opened_or_refused_in_one_line(part, attacker, seeds, tmp_path):
    tally = Tally(part)
    with Victim(part, f"tests.attack.{part}:{attacker}", tmp_path) as victim:
        for seed in seeds:
            tally.add(victim.attempt(seed))
    assert tally.faults == []
    assert tally.trials == len(seeds)
    assert min(tally.ok, tally.refused) > 0


@posix
def test_what_goes_wrong_is_told_and_kept_with_what_made_it(tmp_path):
    """That the attack itself fails, too, as where there is no such seed."""
    attacker = "tests.attack.test_attack:decoy"
    with Victim("decoy", attacker, tmp_path, seconds=1, megabytes=100) as victim:
        *trials, failed = [victim.attempt(seed) for seed in range(len(ACTS) + 1)]
    for seed, (act, told) in enumerate(ACTS.items()):
        assert trials[seed].outcome == "fault"
        assert told in trials[seed].detail
        assert (tmp_path / f"decoy-{seed}" / "a.spec").read_text() == act
    assert (failed.kind, failed.outcome) == ("the attack itself", "fault")
    assert "IndexError" in failed.detail
    assert list((tmp_path / f"decoy-{len(ACTS)}").iterdir()) == []


@posix
def test_all_parts_together_make_a_table():
    words = ["--minutes", "0.02", "--seed", "7", "--workers", "1", "--only", "mutations"]
    done = run(sys.executable, "-m", "tests.attack", *words, cwd=ROOT)
    assert (done.returncode, done.stdout.split()[0]) == (0, "part")
    assert re.search(r"^mutations +[1-9]", done.stdout, re.MULTILINE)
    words = [sys.executable, "-m", "tests.attack", "--repeat", "mutations:7"]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, check=True)
    assert Trial.from_line(done.stdout.decode()).kind == mutant(7)[1]


def test_the_page_adds_up_over_runs(tmp_path, monkeypatch):
    page = tmp_path / "promises.md"
    page.write_text(f"before\n{trial.BEGIN}\n{trial.END}\nafter\n")
    monkeypatch.setattr(trial, "PAGE", page)
    monkeypatch.setattr(trial, "TOTALS", tmp_path / "attack.json")
    for seed in range(2):
        tally = Tally("mutations")
        for one in (Trial("a", seed, "ok", seconds=seed), Trial("a", 9, "fault", "it broke")):
            tally.add(one)
        trial.write({"mutations": tally})
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "| mutations | 4 | 2 | 0 | 2 |" in text
    assert text.count("`./run attack --repeat mutations:9`") == 1


def test_nothing_falls_over_and_undo_leads_back_to_the_start():
    """In a process of its own: a process can draw in one way only."""
    command = [sys.executable, "-m", "tests.attack.monkey", "--seed", "1", "--count", "2"]
    done = run(*command, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    trials = [Trial.from_line(line) for line in done.stdout.splitlines()]
    assert [(t.seed, t.outcome, t.detail) for t in trials] == [(1, "ok", ""), (2, "ok", "")]


def test_what_undo_should_have_taken_back_is_named():
    start = Document((Surface(icosphere(0), "sphere"),))
    assert differences(start, replace(start, time=0.5)) == []
    assert differences(start, replace(start, mask="coordinate:x", lines=())) == ["mask"]
    surfaces, view = (Surface(icosphere(0), "sphere"),), replace(start.view, arrows=True)
    assert differences(start, replace(start, surfaces=surfaces, view=view)) == ["surfaces", "view"]


@linux
def test_a_signal_ends_a_command_with_one_line_and_nothing_left(tmp_path):
    attack, chance = signals.Attack(tmp_path, {"match": 2.0, "map": 1.0}), random.Random(3)
    outcomes = [attack.one(name, chance) for name in ("match", "map")]
    assert [outcome for outcome in outcomes if outcome[1]] == []


@linux
def test_a_kill_leaves_the_old_file_or_the_new_one(tmp_path):
    attack, chance = kills.Attack(tmp_path), random.Random(1)
    outcomes = [(what, *attack.one(what, chance)) for what in attack.savings for _ in range(3)]
    assert [outcome for outcome in outcomes if outcome[-1]] == []
    assert any(left for _, _, left, _ in outcomes)  # else nothing was killed while it wrote


@pytest.mark.parametrize(
    ("threads", "megabytes", "holds"),
    [(10, 320.0, True), (10, 360.0, False), (12, 300.0, False), (3, 300.0, True)],
)
def test_growth_by_more_than_a_tenth_is_told_but_not_of_a_short_run(
    threads, megabytes, holds, monkeypatch, capsys
):
    def there_is(threads, megabytes):
        now = {"threads": threads, "children": 0, "megabytes": megabytes}
        monkeypatch.setattr(monkey, "counts", lambda: now)

    short = Endurance(time.monotonic(), int)
    short.add()
    assert short.end()
    assert not capsys.readouterr().err
    rests = []
    kept = Endurance(time.monotonic() - 301, lambda: rests.append(True))
    there_is(10, 300.0)
    kept.add()
    for k in range(60):
        there_is(50, megabytes + k % 7)
        kept.add()
    there_is(threads, 1000.0)  # after the rest, and some of it in use
    assert kept.end() is holds
    assert len(rests) == 2
    assert "300" in capsys.readouterr().err


def test_threads_may_end_while_they_are_counted():
    done = threading.Event()

    def begin_and_end():
        while not done.is_set():
            threading.Thread(target=int).start()

    busy = threading.Thread(target=begin_and_end)
    busy.start()
    try:
        found = [counts() for _ in range(200)]
    finally:
        done.set()
        busy.join()
    assert all(each["threads"] >= 2 and each["megabytes"] > 10 for each in found)
