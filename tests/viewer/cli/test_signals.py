"""Signals, broken pipes and output, mostly in subprocesses."""

import json
import os
import resource
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import pytest

from abfm import load
from abfm.assets import asset_path
from abfm_viewer.cli import main
from abfm_viewer.document.document import Surface
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.files.project import save_project
from tests.mesh_writers import off_file
from tests.messages import check_message
from tests.processes import argv, python, refused_soon
from tests.shapes import icosphere

PROGRAM = "import sys; from abfm_viewer.cli import main; sys.exit(main())"
EIGHT = str(asset_path("eight.off"))
CPU_SECONDS_MAX = 300
PAIR = ["--source=gaussian:vertex=10,width=0.2", "--target=gaussian:vertex=40,width=0.2"]
LONG = argv(
    "match",
    asset_path("human_A.off"),
    "--source=gaussian:vertex=394",
    "--target=gaussian:vertex=14",
    "--set=iterations=1000000",
    "--set=tolerance=0",
    "--sigma=1e-6",
    "--out",
)


def _limited():
    """Allow interrupts, and limit the processor time of a process."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS_MAX, CPU_SECONDS_MAX))


@pytest.mark.skipif(sys.platform != "linux", reason="needs limits of the address space")
def test_little_memory_is_reported_before_loading():
    """Too little memory is reported in one line before OpenBLAS is imported and retries forever."""

    def limit():
        resource.setrlimit(resource.RLIMIT_AS, 2 * (350_000 << 10,))

    done = python(PROGRAM, "match", EIGHT, *PAIR, preexec_fn=limit, timeout=60)
    assert done.returncode == 2
    check_message(done.stderr, 450)
    assert len(done.stderr.splitlines()) == 1


def start(*words):
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=_limited,
    )


def output_after(process, number):
    process.send_signal(number)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    return output, errors


def test_signal_keeps_the_best_field(tmp_path):
    process = start(*LONG, str(tmp_path / "m.npz"))
    while "match: mesh of" not in process.stderr.readline():
        assert process.poll() is None
    output, errors = output_after(process, signal.SIGTERM)
    assert "stopping" in errors
    assert "Traceback" not in errors
    assert output.startswith("cancelled")
    match = load(tmp_path / "m.npz")
    assert match.stop_reason == "cancelled"
    assert match.residual <= match.initial_residual


def test_signal_keeps_finished_problems_of_bench(tmp_path):
    """A signal keeps finished problems; exceptions in callbacks of libraries would be printed."""
    ball = off_file(tmp_path / "ball.off", icosphere(1))
    process = start("bench", "--success", "--only-given", "--meshes", ball, "--jobs=1", "--json")
    while not process.stderr.readline().startswith("1/6"):
        assert process.poll() is None
    output, errors = output_after(process, signal.SIGTERM)
    message = "stopping with the finished problems; press Ctrl-C again to exit immediately"
    lines = errors.splitlines()
    assert lines.count(message) == 1
    lines.remove(message)  # rows may finish before or after the signal
    report = json.loads(output)
    assert report["interrupted"]
    assert 1 <= len(report["rows"]) < 6
    assert [line.split("/6 ")[0] for line in lines] == [
        str(number) for number in range(2, len(report["rows"]) + 1)
    ]


def test_early_interrupt_writes_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("abfm.matching.task.mesh_of", Mock(side_effect=KeyboardInterrupt))
    assert main([*LONG, str(tmp_path / "m.npz")]) == 130
    assert capsys.readouterr().err == "abfm: interrupted\n"
    assert list(tmp_path.iterdir()) == []


def test_signal_keeps_an_older_movie(tmp_path):
    movie = tmp_path / "m.mp4"
    movie.write_text("older")
    document = MatchDocument((Surface(icosphere(1), "ball"),))
    save_project(tmp_path / "m.abfm", document, {})
    options = ["--from", "0", "--to", "0", "--size", "320x240", "--seconds", "60", "--progress"]
    process = start("render", tmp_path / "m.abfm", "--out", movie, *options)
    assert '"frame": 1,' in process.stdout.readline()
    output, errors = output_after(process, signal.SIGINT)
    assert "wrote" not in output
    check_message(errors)
    assert movie.read_text() == "older"
    assert {path.name for path in tmp_path.iterdir()} == {"m.abfm", "m.mp4"}


SIGNAL_IN_IMPORT = """
import os, signal, sys

class Finder:
    def find_spec(self, name, *_):
        if name == 'numpy': {act}()

def interrupt():
    raise KeyboardInterrupt

def kill():
    try: os.kill(os.getpid(), {number}); sum(range(10**6))
    except BaseException: os._exit(1)

signal.signal({number}, signal.SIG_DFL)  # the parent may ignore it
sys.meta_path.insert(0, Finder())
sys.argv = ['abfm', 'info']
from abfm_viewer.{module} import main; sys.exit(main({words}))
"""


@pytest.mark.parametrize(
    ("act", "words", "module", "number"),
    [
        ("interrupt", "[]", "app", signal.SIGINT),
        ("kill", "", "cli", signal.SIGHUP),
        ("kill", "", "app", signal.SIGTERM),
    ],
)
def test_signal_during_an_import_prints_one_line(act, words, module, number):
    """During an import a signal prints one line; compiled code would swallow an exception."""
    done = python(SIGNAL_IN_IMPORT.format(act=act, words=words, module=module, number=int(number)))
    program = {"cli": "abfm", "app": "abfm-viewer"}[module]
    assert (done.returncode, done.stderr) == (128 + number, f"{program}: interrupted\n")


SECOND_SIGNAL = """
import os, signal, sys, tempfile
from pathlib import Path
from unittest.mock import Mock
from abfm.io import temporary_folder, write_atomically
from abfm_viewer.cli.exit_status import program_status
from abfm_viewer.signals import exit_on_signals, cleanup_on_signal

def run():
    saving = write_atomically("m.npz"), temporary_folder(Path.cwd())
    with saving[0], saving[1] as folder, cleanup_on_signal(clean_up):
        (folder / "frame").touch()
        os.kill(os.getpid(), signal.SIGTERM)

def clean_up():
    os.kill(os.getpid(), signal.SIGINT)  # a second signal
    sum(range(10**6))

exit_on_signals("abfm")
print("before", end="")
sys.exit(program_status("abfm", run))
"""


def test_second_signal_still_removes_files(tmp_path):
    (tmp_path / "m.npz").write_text("old")
    done = python(
        SECOND_SIGNAL, cwd=tmp_path, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    )
    assert (done.returncode, done.stdout, done.stderr) == (143, "before", "abfm: interrupted\n")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"m.npz": "old"}


def test_ignored_signal_stays_ignored():
    done = python(
        "import os, signal; from abfm_viewer.signals import exit_on_signals, signal_handler\n"
        "signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "exit_on_signals('abfm')\n"
        "with signal_handler(print): os.kill(os.getpid(), signal.SIGHUP)\n"
        "os.kill(os.getpid(), signal.SIGHUP)\n"
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="reads /proc")
def test_helper_process_ends_with_its_parent():
    script = (
        "import os; from abfm.workers.process import ChildProcess\n"
        "process = ChildProcess('abfm.workers')\n"
        "print(process.pid, os.getpgid(process.pid) != os.getpgid(0), flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    helper, has_own_group = python(
        script, capture_output=False, stdout=subprocess.PIPE
    ).stdout.split()
    assert has_own_group == "True"  # a terminal sends Ctrl-C to the group of the parent
    for _ in range(600):
        try:
            if ") Z " in Path(f"/proc/{helper}/stat").read_text():
                return
        except OSError:
            return
        time.sleep(0.1)
    pytest.fail("the helper still runs")


def shell(line, *words, **environment):
    """Run a line of the shell, in which ABFM is the program and "$@" are the words."""
    program = shlex.join([sys.executable, "-c", PROGRAM])
    done = subprocess.run(
        ["bash", "-c", line.replace("ABFM", program), "bash", *words],
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | environment,
    )
    return done.returncode, done.stdout, done.stderr


def test_help_is_printed_in_any_encoding_or_to_no_reader():
    assert shell("set -o pipefail; ABFM match --help | true") == (0, b"", b"")
    status, out, errors = shell("ABFM match --help", PYTHONIOENCODING="cp1252")
    assert (status, errors) == (0, b"")
    assert b"--tau" in out
    out.decode("cp1252")


def test_closed_streams_are_allowed():
    assert shell('ABFM info "$@" >&-', EIGHT) == (0, b"", b"")
    status, out, _ = shell("ABFM 2>&- <&-")
    assert status == 0
    assert b"match" in out


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a full disk")
def test_lost_output_is_reported():
    expected = b"abfm: cannot write the output: No space left on device\n"
    assert shell("ABFM >/dev/full") == (2, b"", expected)
    assert shell("ABFM info none.off 2>/dev/full") == (2, b"", b"")


def test_match_is_written_without_a_reader(tmp_path):
    out = tmp_path / "m.npz"
    words = ["match", EIGHT, *PAIR, "--set=iterations=30", "--refine=0", "--out", out]
    status, _, _ = shell('set -o pipefail; ABFM "$@" 2>&1 | head -c 1 >/dev/null', *words)
    assert status == 3
    assert (tmp_path / "m.npz").exists()


NAMES = ["a\nb.off", "a\rb\x1b[2J.off", "\udcff.off", "a" * 50_000 + ".off", "\u202e.off", "\0.off"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "line",
    [
        "info NAME",
        "render m.npz --out NAME",
        "map NAME --truth identity",
        "figure NAME --out .",
        "figure 3 --mesh NAME --out .",
        "demo --out NAME/a",
        "match EIGHT --source=file:NAME --target=NAME --out=m.npz",
        "match EIGHT --source=coordinate:x --target=coordinate:y --tau=NAME --out=m.npz",
        "NAME",
        "info EIGHT --NAME",
        "bench --success --only-given --meshes NAME --json NAME",
    ],
)
def test_strange_names_print_one_short_line(line, name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    used = [word.replace("NAME", name).replace("EIGHT", EIGHT) for word in line.split()]
    if line.endswith("NAME/a") and "\0" not in name and len(name) < 100:
        (tmp_path / os.fsdecode(os.fsencode(name))).touch()
    with refused_soon():
        assert main(used) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.rstrip("\n").isprintable()
    assert len(captured.err) < 700
