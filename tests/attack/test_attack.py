"""A small part of the attack, and checks that it reports faults."""

import random
import sys
from dataclasses import replace

import pytest

from abfm_viewer.document.document import Surface
from abfm_viewer.document.kinds import MatchDocument
from tests.attack import readers
from tests.attack.hostile import hostile
from tests.attack.hunt import Tally, hunt, table
from tests.attack.monkey import differences
from tests.attack.mutations import mutant
from tests.attack.processes import Kills, Signals
from tests.attack.specimens import Specimen, specimens
from tests.attack.trial import FaultError, Trial
from tests.attack.victim import Victim, put
from tests.processes import ROOT, run
from tests.shapes import icosphere

linux = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="bounds and watches processes as Linux does"
)
# code with bad behaviour, and words of the report
ACTS = {
    "raise KeyError('x')": "KeyError: 'x' (outside of abfm)",
    "from abfm import AbfmError; e = AbfmError(); e.args = ('two\\nlines',); raise e": "2 lines",
    "from abfm import AbfmError; raise AbfmError('None' 'Type object')": "the words of Python",
    "import os; os.abort()": "the process died: SIGABRT",
    "import os; os.write(2, b'oh')": "output: 'oh'",
    "import warnings; warnings.warn('beware')": "UserWarning: beware",
    "len(b'x' * 200 * 10**6)": " MB of memory",
    "while True: pass": "more than 1 s of CPU time",
}


def read_as(reader, path):
    readers.READERS[reader] = lambda path: exec(path.read_text())
    readers.read_as(reader, path)


def test_every_specimen_is_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a, (b).csv").write_text("depth,x\n" + "1,2\n" * 43)
    for name, specimen in specimens().items():
        folder = tmp_path / name.replace("/", "_")
        put(specimen, folder)
        readers.read_as(specimen.reader, folder / name)


@linux
@pytest.mark.parametrize(("make", "trials"), [(mutant, 400), (hostile, 6)])
def test_files_are_opened_or_refused_in_one_line(make, trials, tmp_path):
    tally = Tally(make.__name__)
    with Victim(tmp_path) as victim:
        hunt(tally, lambda chance: victim.open(*make(chance)), 2, trials)
    assert tally.faults == {}
    assert 0 < tally.refused < tally.trials >= 0.8 * trials


@linux
def test_faults_are_reported_and_stored(tmp_path):
    with Victim(tmp_path, seconds=1, megabytes=100, open_file=read_as) as victim:
        for act, expected in ACTS.items():
            with pytest.raises(FaultError) as caught:
                victim.open(Specimen("a.txt", "act", act.encode()), "act")
            assert expected in str(caught.value)
            assert (tmp_path / "a.txt" / "a.txt").read_text() == act
        assert victim.open(Specimen("a.txt", "act", b"1"), "fine").is_refused is False


def test_hunt_repeats_and_shrinks():
    def attempt(chance):
        found.append([chance.randint(0, 100) for _ in range(3)])
        if sum(found[-1]) > 150:
            raise FaultError(f"too large: {found[-1]}")
        return Trial(is_refused=True, seconds=2.0)

    runs = []
    for shrinks in (False, False, True):
        found, tally = [], Tally("numbers")
        hunt(tally, attempt, 7, 100, shrinks=shrinks)
        runs.append((found, tally))
    assert runs[0] == runs[1]
    assert set(runs[0][1].faults) == {"numbers:7"}
    assert sum(runs[2][0][-1]) == 151
    assert "numbers:7" in table([runs[2][1]])


@linux
def test_parts_make_a_table():
    words = ["--minutes", "0.02", "--seed", "7", "--workers", "1", "--only", "kills"]
    done = run(sys.executable, "-m", "tests.attack", *words, cwd=ROOT)
    assert (done.returncode, done.stdout.split()[0]) == (0, "part"), done
    assert int(done.stdout.splitlines()[1].split()[1]) > 0


@linux
def test_monkey_finds_no_fault():
    """A separate process is used, as polyscope allows only one backend in a process."""
    code = (
        "import random\n"
        "from tests.attack.monkey import Monkey\n"
        "with Monkey() as monkey: [monkey.attempt(random.Random(seed)) for seed in (1, 2)]"
    )
    done = run(sys.executable, "-c", code, cwd=ROOT)
    assert done.returncode == 0, done.stderr


def test_differences_of_documents_are_named():
    start = MatchDocument((Surface(icosphere(0), "sphere"),))
    assert differences(start, replace(start, time=0.5)) == []
    assert differences(start, replace(start, mask="coordinate:x", lines=())) == ["mask"]


@linux
@pytest.mark.parametrize("name", ["match", "map"])
def test_signal_ends_command_in_one_line(name, tmp_path):
    Signals(tmp_path).attempt(random.Random(3), name)


@linux
def test_kill_leaves_old_or_new_file(tmp_path):
    kills, chance = Kills(tmp_path), random.Random(1)
    for name in kills.savings:
        kills.attempt(chance, name)
