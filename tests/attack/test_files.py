"""Some of the mutated and hostile files that `mutations` and `hostile` make in great numbers."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from tests.attack import promises
from tests.attack.decoy import ACTS
from tests.attack.doors import enter
from tests.attack.hostile import hostile
from tests.attack.mutant import mutant
from tests.attack.specimens import specimens
from tests.attack.tally import Tally
from tests.attack.trial import Trial
from tests.attack.victim import ROOT, Victim
from tests.processes import run

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="bounds a process as POSIX does")


def test_every_specimen_comes_in(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a, (b).csv").write_text("depth,x\n" + "1,2\n" * 43)
    for name, specimen in specimens().items():
        for file, content in {name: specimen.content, **specimen.beside}.items():
            (tmp_path / file).write_bytes(content)
        enter(specimen.door, tmp_path / name)


def test_a_seed_gives_the_same_file_every_time():
    for attacker in (mutant, hostile):
        assert [attacker(seed)[0].content for seed in range(8)] == [
            attacker(seed)[0].content for seed in range(8)
        ]
    assert len({mutant(seed)[1] for seed in range(100)}) > 50


@pytest.mark.parametrize(
    ("part", "attacker", "seeds"),
    [
        ("mutations", "tests.attack.mutant:mutant", range(600)),
        ("hostile", "tests.attack.hostile:hostile", range(21)),
    ],
)
def test_files_are_opened_or_refused_in_one_line(part, attacker, seeds, tmp_path):
    tally = Tally(part)
    with Victim(part, attacker, tmp_path) as victim:
        for seed in seeds:
            tally.add(victim.attempt(seed))
    assert tally.faults == []
    assert tally.trials == len(seeds)
    assert min(tally.ok, tally.refused) > 0


def test_what_goes_wrong_is_told_and_kept_with_what_made_it(tmp_path):
    """That the attack itself fails, too, as where there is no such seed."""
    with Victim("decoy", "tests.attack.decoy:decoy", tmp_path, seconds=1, megabytes=100) as victim:
        *trials, failed = [victim.attempt(seed) for seed in range(len(ACTS) + 1)]
    for seed, (act, told) in enumerate(ACTS.items()):
        assert trials[seed].outcome == "fault"
        assert told in trials[seed].detail
        assert (tmp_path / f"decoy-{seed}" / "a.spec").read_text() == act
    assert (failed.kind, failed.outcome) == ("the attack itself", "fault")
    assert "IndexError" in failed.detail
    assert list((tmp_path / f"decoy-{len(ACTS)}").iterdir()) == []


def test_all_parts_together_make_a_table():
    words = ["--minutes", "0.02", "--seed", "7", "--workers", "1", "--only", "mutations"]
    done = run(sys.executable, "-m", "tests.attack", *words, cwd=ROOT)
    assert (done.returncode, done.stdout.split()[0]) == (0, "part")
    assert re.search(r"^mutations +[1-9]", done.stdout, re.MULTILINE)
    words = ["--repeat", "mutations:7"]
    done = subprocess.run(
        [sys.executable, "-m", "tests.attack", *words], cwd=ROOT, capture_output=True, check=True
    )
    assert Trial.from_line(done.stdout.decode()).kind == mutant(7)[1]


def test_the_page_adds_up_over_runs(tmp_path, monkeypatch):
    page = tmp_path / "promises.md"
    page.write_text(f"before\n{promises.BEGIN}\n{promises.END}\nafter\n")
    monkeypatch.setattr(promises, "PAGE", page)
    monkeypatch.setattr(promises, "TOTALS", tmp_path / "attack.json")
    for seed in range(2):
        tally = Tally("mutations")
        for trial in (Trial("a", seed, "ok", seconds=seed), Trial("a", 9, "fault", "it broke")):
            tally.add(trial)
        promises.write({"mutations": tally})
    text = page.read_text()
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "| mutations | 4 | 2 | 0 | 2 |" in text
    assert text.count("`./run attack --repeat mutations:9`") == 1
