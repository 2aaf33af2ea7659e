"""What programs print never ends them, in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from abfm.assets import asset_path
from abfm_viewer.cli import main

EIGHT = str(asset_path("eight.off"))
PROGRAM = "import sys; from abfm_viewer.cli import main; sys.exit(main())"


def shell(command: str, **environment: str) -> tuple[int, bytes, bytes]:
    """Run a line of the shell, where ABFM stands for the program; its status and what it
    printed.
    """
    done = subprocess.run(
        ["bash", "-c", command.replace("ABFM", f'{sys.executable} -c "{PROGRAM}"')],
        capture_output=True,
        check=False,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)} | environment,
    )
    return done.returncode, done.stdout, done.stderr


def test_help_is_printed_in_an_encoding_that_lacks_its_letters():
    status, out, errors = shell("ABFM match --help", PYTHONIOENCODING="cp1252")
    assert (status, errors) == (0, b"")
    assert b"--tau" in out
    out.decode("cp1252")


def test_closed_streams_are_no_error_and_get_nothing_of_the_other():
    assert shell(f"ABFM info {EIGHT} >&-") == (0, b"", b"")
    status, out, _ = shell(f"ABFM info {EIGHT} 2>&- <&-")
    assert status == 0
    assert b"vertices" in out


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a disk that is full")
def test_output_that_is_lost_is_told():
    expected = b"abfm: cannot write the output: No space left on device\n"
    assert shell(f"ABFM info {EIGHT} >/dev/full") == (2, b"", expected)
    assert shell("ABFM info none.off 2>/dev/full") == (2, b"", b"")


def test_a_match_whose_messages_nobody_reads_goes_on_and_is_written(tmp_path):
    words = (
        f"match {EIGHT} --source gaussian:vertex=10 --target gaussian:vertex=40 --iterations 30 "
        f"--out {tmp_path}/m.npz"
    )
    status, _, _ = shell(f"set -o pipefail; ABFM {words} 2>&1 | head -c 1 >/dev/null")
    assert status == 3
    assert (tmp_path / "m.npz").exists()


NAMES = ["a\nb.off", "a\rb\x1b[2J.off", "\udcff.off", "a" * 50_000 + ".off", "\u202e.off", "\0.off"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "words",
    [
        "info NAME",
        "render NAME --out m.png",
        "render m.npz --out NAME",
        "map NAME --truth identity",
        "figure NAME --out .",
        "figure 3 --mesh NAME --out .",
        "figure 3 --out NAME/a",
        "demo --out NAME/a",
        "match NAME --source a --target b --out m.npz",
        "match EIGHT --source file:NAME --target NAME --out m.npz",
        "match EIGHT --source coordinate:x --target coordinate:y --tau NAME --out m.npz",
        "NAME",
        "info EIGHT NAME",
        "info EIGHT --NAME",
        "bench --part NAME",
    ],
)
def test_names_of_all_letters_and_lengths_are_one_bounded_line(
    words, name, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    used = [word.replace("NAME", name).replace("EIGHT", EIGHT) for word in words.split()]
    if words.endswith("NAME/a") and "\0" not in name and len(name) < 100:
        (tmp_path / os.fsdecode(os.fsencode(name))).touch()
    assert main(used) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.rstrip("\n").isprintable()
    assert len(captured.err) < 700
