"""Ctrl-C and broken pipes, in processes of their own."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from abfm import load_match
from abfm.assets import asset_path
from abfm_viewer.cli import main

COMMAND = [sys.executable, "-c", "import sys; from abfm_viewer.cli import main; sys.exit(main())"]
LONG = [
    *("match", str(asset_path("human_A.off")), "--source", "gaussian:vertex=394", "--target", "gaussian:vertex=14"),
    *("--iterations", "1000000", "--tolerance", "0", "--sigma", "1e-6", "--out"),
]


def start(*words: str) -> subprocess.Popen[str]:
    """A process whose progress comes line by line through stderr, and which may be interrupted."""
    return subprocess.Popen(
        [*COMMAND, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_match_and_keeps_its_best_result(number, tmp_path: Path):
    out = tmp_path / "m.npz"
    process = start(*LONG, str(out))
    assert process.stderr is not None
    while "iteration 10 " not in process.stderr.readline():
        assert process.poll() is None
    process.send_signal(number)
    told, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert "stopping" in errors
    assert "Traceback" not in errors
    assert "cancelled: " in told
    match = load_match(out)
    assert match.stop_reason == "cancelled"
    assert len(match.energy_history) > 10
    assert match.energy_history[-1, 0] < match.energy_history[0, 0]


def test_an_interrupt_before_the_solve_writes_nothing(tmp_path: Path):
    script = (
        "import sys, abfm_viewer.cli.options as o\n"
        "def interrupted(_): raise KeyboardInterrupt\n"
        "o.mesh = interrupted\n"
        "from abfm_viewer.cli import main; sys.exit(main())"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, *LONG, str(tmp_path / "m.npz")], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (130, "abfm: interrupted\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("module", "program"), [("cli", "abfm"), ("app", "abfm-viewer")])
def test_an_interrupt_while_modules_load_is_one_line(module, program):
    script = (
        "import sys\n"
        "class CtrlC:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'numpy': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, CtrlC())\n"
        f"from abfm_viewer.{module} import main; sys.exit(main([]))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, f"{program}: interrupted\n")


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Path:
    """A result file."""
    path = tmp_path_factory.mktemp("result") / "m.npz"
    pair = ["--source", "gaussian:vertex=10,width=0.2", "--target", "gaussian:vertex=40,width=0.2"]
    words = [*pair, "--iterations", "3", "--quiet", "--out", str(path)]
    assert main(["match", str(asset_path("eight.off")), *words]) == 3  # too few to reach the target
    return path


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_movie_and_leaves_the_older_file(number, result: Path, tmp_path: Path):
    movie = tmp_path / "m.mp4"
    movie.write_text("older")
    process = start("render", str(result), "--out", str(movie), "--size", "320x240", "--seconds", "60", "--progress")
    assert process.stdout is not None
    assert '"frame": 1,' in process.stdout.readline()
    process.send_signal(number)
    told, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert "wrote" not in told
    assert errors == "abfm: interrupted\n"
    assert movie.read_text() == "older"
    assert [path.name for path in tmp_path.iterdir()] == ["m.mp4"]


def test_a_reader_that_has_enough_is_no_error():
    process = start("match", "--help")
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    assert process.stderr.read() == ""
    assert process.wait(timeout=60) == 0
