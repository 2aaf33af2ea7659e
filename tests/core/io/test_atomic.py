"""Files that are replaced as a whole, and temporary ones that do not stay."""

from __future__ import annotations

import os
import resource
import signal
import socket
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from abfm import ResultError
from abfm.io import check_writable, remove_temporary, temporary_folder, write_atomically
from abfm.io.atomic import temporary_file


def written(path: Path, text: str = "new") -> None:
    with write_atomically(path) as temporary:
        temporary.write_text(text)


def refusal(path: Path) -> str:
    """The one line with which both the check and the writer refuse a path, and leave nothing."""
    before = sorted(path.parent.iterdir()) if path.parent.is_dir() else []
    with pytest.raises(ResultError) as refused:
        check_writable(path)
    with pytest.raises(ResultError) as again:
        written(path)
    assert str(again.value) == str(refused.value)
    assert "\n" not in str(refused.value)
    assert (sorted(path.parent.iterdir()) if path.parent.is_dir() else []) == before
    return str(refused.value)


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as opened:
        opened.bind(str(path))


@pytest.mark.parametrize(
    ("make", "words"), [(os.mkdir, "a folder"), (os.mkfifo, "a pipe"), (make_socket, "a socket")]
)
def test_what_is_no_file_is_not_replaced(tmp_path, monkeypatch, make, words):
    monkeypatch.chdir(tmp_path)  # names of sockets are short
    make(Path("m.npz"))
    kind = stat.S_IFMT(os.stat("m.npz").st_mode)
    assert words in refusal(tmp_path / "m.npz")
    assert stat.S_IFMT(os.stat("m.npz").st_mode) == kind


def test_a_device_is_not_replaced_also_behind_a_link(tmp_path):
    (tmp_path / "m.npz").symlink_to("/dev/null")
    assert "it is a device" in refusal(tmp_path / "m.npz")
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)


@pytest.mark.parametrize(
    "name", ["a" * 252 + ".npz", "none/m.npz", "file/m.npz", "m\0.npz", "loop"]
)
def test_places_without_room_for_a_file_are_refused(tmp_path, name):
    (tmp_path / "file").touch()
    (tmp_path / "loop").symlink_to("loop")
    assert refusal(tmp_path / name).startswith("cannot write ")


@pytest.mark.parametrize(
    "name", ["a" * 251 + ".npz", "a." + "b" * 253, "ä" * 125 + ".npz", "." * 9]
)
def test_names_as_long_as_the_system_takes_are_written(tmp_path, name):
    check_writable(tmp_path / name)
    written(tmp_path / name)
    assert os.listdir(tmp_path) == [name]


def test_an_error_of_the_block_is_not_hidden_by_what_tidies_up(tmp_path):
    def fail() -> None:
        with write_atomically(tmp_path / "folder" / "m.npz") as temporary:
            temporary.unlink()
            temporary.parent.rmdir()
            (tmp_path / "folder").touch()
            raise OSError(28, "No space left on device")

    (tmp_path / "folder").mkdir()
    with pytest.raises(ResultError, match="No space left on device"):
        fail()


def test_a_folder_that_goes_while_it_is_written_to_is_one_line(tmp_path):
    (tmp_path / "folder").mkdir()

    def write() -> None:
        with write_atomically(tmp_path / "folder" / "m.npz") as temporary:
            temporary.unlink()
            temporary.parent.rmdir()

    with pytest.raises(ResultError, match=r"cannot write .*m\.npz: No such file"):
        write()


def test_a_full_disk_leaves_the_old_file_whole(tmp_path):
    """The limit of a file's size stands for it."""
    path = tmp_path / "m.npz"
    written(path, "old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limits[1]))
    try:
        with pytest.raises(ResultError, match="File too large"):
            written(path, "new" * 100)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["m.npz"]


KILLED = """
import os, sys
from pathlib import Path
from abfm.io.atomic import temporary_file, temporary_folder
place = Path(sys.argv[1])
with temporary_file(place, ".npz") as file, temporary_folder(place) as folder:
    (folder / "frame").touch()
    print("there", flush=True)
    sys.stdin.read()
"""


def test_what_a_killed_process_left_goes_with_the_next_write_and_not_before_it_is_killed(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    ) as other:
        assert other.stdout is not None
        other.stdout.readline()
        theirs = set(os.listdir(tmp_path))
        assert len(theirs) == 2
        written(tmp_path / "m.npz")
        assert set(os.listdir(tmp_path)) == theirs | {"m.npz"}
        other.kill()
    assert set(os.listdir(tmp_path)) == theirs | {"m.npz"}
    written(tmp_path / "m.npz")
    assert os.listdir(tmp_path) == ["m.npz"]


def test_others_files_are_left_alone(tmp_path):
    # of another machine, or of nobody
    names = [".abfm-00000000-0123456789ab.npz", ".m-0123456789ab.npz", ".abfm"]
    for name in names:
        (tmp_path / name).touch()
    written(tmp_path / "m.npz")
    assert sorted(os.listdir(tmp_path)) == sorted([*names, "m.npz"])


def test_many_writers_of_one_folder_do_not_disturb_one_another(tmp_path):
    problems = []

    def write(number: int) -> None:
        try:
            for _ in range(20):
                written(tmp_path / f"{number}.txt", str(number))
        except ResultError as error:
            problems.append(error)

    threads = [threading.Thread(target=write, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert problems == []
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        f"{n}.txt": str(n) for n in range(8)
    }


def test_a_process_that_ends_at_once_can_remove_what_it_has_in_use(tmp_path):
    with temporary_file(tmp_path), temporary_folder(tmp_path) as folder:
        (folder / "frame").touch()
        assert len(os.listdir(tmp_path)) == 2
        remove_temporary()
        assert os.listdir(tmp_path) == []


def test_temporary_folders_are_the_users_own(tmp_path):
    with temporary_folder(tmp_path) as folder:
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert os.listdir(tmp_path) == []
