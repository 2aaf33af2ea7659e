"""Branches for Linux, macOS and Windows.

The project is tested on Linux. Tests with the fixture `system` run a branch there by replacing
``sys.platform``, and the functions that the other system lacks. All other tests run unchanged on
each system.
"""

import ast
import ctypes
import errno
import mmap
import ntpath
import os
import runpy
import signal
import stat
import subprocess
import sys
import time
import typing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path, PureWindowsPath
from types import SimpleNamespace

import numpy as np
import platformdirs.macos
import platformdirs.unix
import platformdirs.windows
import pytest
from matplotlib import font_manager
from PIL import ImageFont

import abfm_viewer
from abfm import ResultError
from abfm.assets import asset_path
from abfm.batch import attempt
from abfm.functions import parse
from abfm.io import atomic, check_writable, write_atomically
from abfm.reading import Archive
from abfm.tasks import inputs
from abfm.workers import process
from abfm.workers.control import Control
from abfm.workers.worker import Worker, WorkerEndedError, no_state
from abfm_viewer import signals
from abfm_viewer.cli import exit_status
from abfm_viewer.computing import freed_memory
from abfm_viewer.document import keyboard
from abfm_viewer.document.document import Surface
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.files import autosave
from abfm_viewer.files.names import suggested_name
from abfm_viewer.files.state_folder import STATE_VARIABLE, StateFolder
from abfm_viewer.pictures import canvas, plots
from abfm_viewer.scene import opengl
from abfm_viewer.window import menus, window_title
from tests.shapes import icosphere

ROOT = Path(__file__).parents[1]
PACKAGES = [ROOT / name for name in ("core/abfm", "abfm_viewer", "benchmarks")]
SOURCES = [path for folder in PACKAGES for path in sorted(folder.rglob("*.py"))]
NEW_GROUP = 0x200  # CREATE_NEW_PROCESS_GROUP of Windows
RESERVED = {"con", "prn", "aux", "nul"} | {
    f"{name}{k}" for name in ("com", "lpt") for k in "123456789"
}


@dataclass(frozen=True)
class System:
    """Facts of an operating system; `state` is the folder of state, relative to the user's."""

    platform: str
    state: str
    folders: type
    command: str
    backend: str
    group: dict
    signals: tuple
    can_lock: bool
    reports_broken_pipe: int
    channel: str  # two file names and a weight, as a user writes them in a table


CHANNEL = ("/a b/x.npy", "/y.npy", "2")
WINDOWS_CHANNEL = (r"C:\a b\x.npy", r"D:\y.npy", "2")
SYSTEMS = (
    System(
        platform="linux",
        state=".local/state/abfm",
        folders=platformdirs.unix.Unix,
        command="Ctrl",
        backend="openGL3_egl",
        group={"process_group": 0},
        signals=("SIGINT", "SIGTERM", "SIGHUP"),
        can_lock=True,
        reports_broken_pipe=errno.EPIPE,
        channel=r"/a\ b/x.npy /y.npy 2",
    ),
    System(
        platform="darwin",
        state="Library/Application Support/abfm",
        folders=platformdirs.macos.MacOS,
        command="Cmd",
        backend="auto",
        group={"process_group": 0},
        signals=("SIGINT", "SIGTERM", "SIGHUP"),
        can_lock=True,
        reports_broken_pipe=errno.EPIPE,
        channel=r"/a\ b/x.npy /y.npy 2",
    ),
    System(
        platform="win32",
        state="AppData/Local/abfm",
        folders=platformdirs.windows.Windows,
        command="Ctrl",
        backend="auto",
        group={"creationflags": NEW_GROUP},
        signals=("SIGINT", "SIGTERM", "SIGBREAK"),
        can_lock=False,
        reports_broken_pipe=errno.EINVAL,
        channel=r'"C:\a b\x.npy" D:\y.npy 2',
    ),
)
WINDOWS = SYSTEMS[-1]


def become(system, monkeypatch):
    """Replace the facts of this system by those of another one."""
    monkeypatch.setattr(sys, "platform", system.platform)
    monkeypatch.setattr(subprocess, "CREATE_NEW_PROCESS_GROUP", NEW_GROUP, raising=False)
    for name in ("SIGHUP", "SIGBREAK"):
        monkeypatch.delattr(signal, name, raising=False)
        if name in system.signals:
            monkeypatch.setattr(signal, name, 21, raising=False)


@pytest.fixture(params=SYSTEMS, ids=lambda system: system.platform)
def system(request, monkeypatch):
    become(request.param, monkeypatch)
    return request.param


@pytest.fixture
def windows(monkeypatch):
    become(WINDOWS, monkeypatch)


@dataclass
class Source:
    """Modules, attributes, file names and unsuitable openings of texts in a source file."""

    modules: set
    attributes: set
    names: set
    openings: list


@pytest.fixture(scope="module")
def sources():
    """Return the facts of each source file of the product by its path."""
    found = {}
    for path in SOURCES:
        source = found[path] = Source(set(), set(), set(), [])
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            source.names.update(names_in(node))
            if isinstance(node, ast.Import):
                source.modules.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                source.modules.add(node.module or "")
            elif isinstance(node, ast.Attribute):
                source.attributes.add(node.attr)
            elif isinstance(node, ast.Call) and opening_without_encoding(node):
                source.openings.append(node.lineno)
    return found


# Facts that modules read when they are imported


def test_keys_signals_and_process_groups_fit_the_system(system):
    assert runpy.run_path(keyboard.__file__)["COMMAND"] == system.command
    numbers = runpy.run_path(signals.__file__)["NUMBERS"]
    assert numbers == [getattr(signal, name) for name in system.signals]
    assert process.separate_group() == system.group  # without Ctrl-C


def test_offscreen_backend_exists_on_each_system(system, monkeypatch):
    """Only Linux has EGL, and only there the libraries are looked for."""
    looked_for = []
    monkeypatch.setattr(ctypes, "CDLL", looked_for.append)
    found = runpy.run_path(opengl.__file__)["OFFSCREEN_BACKEND"]
    assert found == system.backend
    assert found in typing.get_args(opengl.Backend)
    assert bool(looked_for) == (system.platform == "linux")


def test_only_linux_needs_a_display_variable(system, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    started = []
    recorder = SimpleNamespace(
        is_initialized=lambda: False,
        init=started.append,
        load_color_map=lambda *_: None,
        load_blendable_material=lambda *_, **__: None,
        **dict.fromkeys(
            ("set_window_size", "set_verbosity", "set_use_prefs_file", "set_program_name"),
            lambda *_: None,
        ),
        set_display_message_popups=lambda *_: None,
    )
    monkeypatch.setattr(opengl, "ps", recorder)
    if system.platform == "linux":
        with pytest.raises(abfm_viewer.errors.DrawingError):
            opengl.start(opengl.WINDOW, 64, 64)
    else:
        opengl.start(opengl.WINDOW, 64, 64)
    assert started == [opengl.WINDOW] * (system.platform != "linux")


def test_state_folder_is_that_of_the_system(system, monkeypatch, tmp_path):
    for name in (STATE_VARIABLE, "XDG_STATE_HOME", "WIN_PD_OVERRIDE_LOCAL_APPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name, folder in (("HOME", ""), ("USERPROFILE", ""), ("LOCALAPPDATA", "AppData/Local")):
        monkeypatch.setenv(name, str(tmp_path / folder))
    monkeypatch.setattr(platformdirs, "PlatformDirs", system.folders)
    by_variables = platformdirs.windows.get_win_folder_from_env_vars
    monkeypatch.setattr(platformdirs.windows, "get_win_folder", by_variables)
    assert StateFolder().path == tmp_path / system.state


def test_only_linux_returns_memory_by_its_c_library(system, monkeypatch):
    called = []
    library = SimpleNamespace(malloc_trim=called.append)
    monkeypatch.setattr(ctypes, "CDLL", lambda name: library)
    freed_memory.return_free_memory()
    assert called == [0] * (system.platform == "linux")


# Subprocesses


@pytest.fixture
def piped_worker(windows, monkeypatch):
    """Return a worker that uses pipes, as on Windows."""
    monkeypatch.setattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)  # Linux accepts no other flags
    found = Worker(no_state, "it has ended")
    yield found
    found.close()


def test_worker_answers_through_pipes(piped_worker):
    """The messages are longer than the buffer of a pipe."""
    sent = np.arange(200_000.0)
    call = piped_worker.call(_doubled, sent)
    np.testing.assert_array_equal(call.result(), 2 * sent)
    assert piped_worker._connection.process._process.stdout is not None


def test_closed_worker_with_pipes_fails_its_call(piped_worker):
    call = piped_worker.call(_slept, 60.0)
    piped_worker.close()
    with pytest.raises(WorkerEndedError):
        call.result()


def _doubled(state, values):
    return 2 * values


def _slept(state, seconds):
    time.sleep(seconds)


def test_child_ends_quietly_if_its_parent_has_ended(monkeypatch):
    """Windows reports a broken pipe as an invalid argument."""
    for number in (errno.EPIPE, errno.EINVAL):
        error = OSError(number, os.strerror(number))
        pipe = SimpleNamespace(write=lambda _, error=error: _raise(error))
        child = process.Requests.__new__(process.Requests)
        child._answers = pipe
        with pytest.raises(BrokenPipeError):
            child.answer(None)


def _raise(error):
    raise error


def test_no_module_forks(sources):
    """Windows cannot fork, and a fork of a process with threads may block on macOS."""
    assert sum("subprocess" in source.modules for source in sources.values()) >= 3
    users = [path.name for path, source in sources.items() if "multiprocessing" in source.modules]
    assert users == ["common.py"]  # of the benchmarks
    assert 'get_context("spawn")' in (ROOT / "benchmarks/common.py").read_text(encoding="utf-8")
    attributes = set().union(*(source.attributes for source in sources.values()))
    assert "getpid" in attributes
    assert not attributes & {"fork", "forkpty", "setsid", "getuid", "killpg"}


# Signals and streams


def test_second_signal_calls_the_handler(monkeypatch):
    """`os.kill` would end the process on Windows without cleanup."""
    monkeypatch.setattr(exit_status, "_DOUBLE_SIGNAL_SECONDS", -1.0)
    monkeypatch.setattr(os, "kill", lambda *_: pytest.fail("os.kill skips handlers on Windows"))
    received = []
    before = signal.signal(signal.SIGINT, lambda number, _: received.append(number))
    try:
        control = Control()
        with exit_status.cancelled_by_signals(control) as interrupt:
            signal.raise_signal(signal.SIGINT)
            assert control.cancelled
            assert not received
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
    assert received == [signal.SIGINT]
    assert interrupt.status == 130


def test_output_without_a_reader_is_no_error(system):
    gone = OSError(system.reports_broken_pipe, "")
    assert exit_status._is_reader_gone(gone)
    assert not exit_status._is_reader_gone(OSError(errno.ENOSPC, ""))


# Replacement of files


@pytest.fixture
def windows_files(windows, monkeypatch):
    """Replace and remove files as Windows does; return the set of files that are open.

    Windows refuses to replace or remove a file that is open or read-only.
    """
    opened, replace, unlink = set(), Path.replace, Path.unlink

    def check(path):
        if path in opened or (path.exists() and not path.stat().st_mode & stat.S_IWUSR):
            raise PermissionError(errno.EACCES, "Access is denied")

    def checked_replace(path, target):
        check(Path(target))
        return replace(path, target)

    def checked_unlink(path, missing_ok=False):
        check(path)
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "replace", checked_replace)
    monkeypatch.setattr(Path, "unlink", checked_unlink)
    return opened


def written(path, text):
    with write_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


@pytest.mark.parametrize("attempts", [1, 3, None])
def test_open_file_is_replaced_when_it_is_closed(attempts, windows_files, monkeypatch, tmp_path):
    """After None attempts the other process still reads the file."""
    path, waits = tmp_path / "m.npz", []

    def wait(seconds):
        waits.append(seconds)
        if len(waits) == attempts:
            windows_files.clear()

    path.write_text("old", encoding="utf-8")
    windows_files.add(path)
    monkeypatch.setattr(time, "sleep", wait)
    if attempts is None:
        with pytest.raises(ResultError):
            written(path, "new")
    else:
        written(path, "new")
    assert path.read_text(encoding="utf-8") == ("new" if attempts else "old")
    assert len(waits) == (attempts or len(atomic._RETRY_SECONDS))
    assert sum(waits) < 2
    assert [each.name for each in tmp_path.iterdir()] == ["m.npz"]


def test_read_only_file_leaves_no_temporary_file(windows_files, monkeypatch, tmp_path):
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    path = tmp_path / "m.npz"
    path.write_text("old", encoding="utf-8")
    path.chmod(stat.S_IREAD)
    with pytest.raises(ResultError):
        written(path, "new")
    assert [each.name for each in tmp_path.iterdir()] == ["m.npz"]
    assert path.read_text(encoding="utf-8") == "old"


def set_age(path, days):
    changed = time.time() - 86400 * days
    os.utime(path, (changed, changed))


def test_files_are_replaced_on_each_system(system, tmp_path):
    path = tmp_path / "m.npz"
    for text in ("old", "new"):
        written(path, text)
        assert path.read_text(encoding="utf-8") == text
    check_writable(path)
    with atomic.temporary_folder(tmp_path) as folder:
        (folder / "a").touch()
    assert [each.name for each in tmp_path.iterdir()] == ["m.npz"]


@pytest.mark.parametrize(("days", "is_kept"), [(6, True), (8, False)])
def test_files_without_locks_are_removed_by_age(days, is_kept, system, monkeypatch, tmp_path):
    """Files of ended processes are removed at once where the system can lock them."""
    path = tmp_path / f"{atomic._PREFIX}0123456789ab.npz"
    path.touch()
    set_age(path, days)
    if os.name == "nt" and system.can_lock:
        pytest.skip("Windows cannot lock files")
    atomic.remove_abandoned(tmp_path)
    assert path.exists() == (is_kept and not system.can_lock)


@pytest.fixture
def smb_share(monkeypatch):
    """Lock files as on an SMB share: only the descriptor with the lock can read and write."""
    if sys.platform == "win32":
        pytest.skip("Windows does not lock files")
    locked, lock, open_path = {}, atomic._locked, Path.open

    def locking(path, flags=0):
        descriptor = lock(path, flags)
        locked[path] = descriptor, os.fstat(descriptor).st_ino
        return descriptor

    def is_locked(path):
        descriptor, number = locked.get(path, (None, None))
        try:
            return descriptor is not None and os.fstat(descriptor).st_ino == number
        except OSError:
            return False

    def opening(path, *given, **named):
        if is_locked(path):
            raise PermissionError(errno.EACCES, "Permission denied")
        return open_path(path, *given, **named)

    monkeypatch.setattr(atomic, "_locked", locking)
    monkeypatch.setattr(Path, "open", opening)


def test_files_are_written_on_an_smb_share(smb_share, tmp_path):
    path = tmp_path / "m.npz"
    written(path, "new")
    assert path.read_text(encoding="utf-8") == "new"
    assert [each.name for each in tmp_path.iterdir()] == ["m.npz"]


def test_files_in_use_on_an_smb_share_are_kept(smb_share, tmp_path):
    """Another process can lock them, as their own process could not keep its lock."""
    with write_atomically(tmp_path / "m.npz") as temporary:
        temporary.write_text("new", encoding="utf-8")
        atomic.remove_abandoned(tmp_path)
    assert (tmp_path / "m.npz").read_text(encoding="utf-8") == "new"
    path = tmp_path / f"{atomic._PREFIX}0123456789ab.npz"
    path.touch()
    set_age(path, days=8)
    atomic.remove_abandoned(tmp_path)
    assert not path.exists()


def test_shares_may_refuse_to_flush_a_folder(monkeypatch, tmp_path):
    def refuse(folder):
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(atomic, "_flush_folder", refuse)
    written(tmp_path / "m.npz", "new")
    assert (tmp_path / "m.npz").read_text(encoding="utf-8") == "new"


def test_windows_reads_arrays_into_memory(system, tmp_path):
    """A mapped file could not be replaced there."""
    path = tmp_path / "a.npz"
    np.savez(path, a=np.arange(12.0))
    with path.open("rb") as file:
        found = Archive(file).mapped("a")
    bases = [found]
    while getattr(bases[-1], "base", None) is not None:
        bases.append(bases[-1].base)
    assert isinstance(bases[-1], mmap.mmap) == (system.platform != "win32")
    np.testing.assert_array_equal(found, np.arange(12.0))


def test_windows_recovers_copies_by_their_heartbeat(windows, monkeypatch, tmp_path):
    """`os.kill` with signal 0 would send Ctrl-C there."""
    monkeypatch.setattr(os, "kill", lambda *_: pytest.fail("os.kill sends Ctrl-C on Windows"))
    recent, old = (tmp_path / f"autosave-{number}.abfm" for number in (1, 2))
    for path in (recent, old):
        path.touch()
    set_age(old, days=0.01)
    assert [found.path for found in autosave.recoverable(StateFolder(tmp_path))] == [old]


# Names of files


def is_valid(name):
    """Return whether Windows accepts the name of a file."""
    return (
        not set(name) & {*'<>:"/\\|?*', *map(chr, range(32))}
        and not name.endswith((" ", "."))
        and PureWindowsPath(name).stem.split(".")[0].lower() not in RESERVED
    )


def test_invalid_names_are_recognized():
    assert all(map(is_valid, ("a.npz", "é x.npz")))
    wrong = ("a:b.npz", "a?.npz", "a*", '"a"', "a\tb", "con.npz", "LPT1", "a.")
    assert not any(map(is_valid, wrong))


def test_suggested_names_are_valid():
    surface = Surface(icosphere(0), "row 1: left/right <?*>.off")
    assert is_valid(suggested_name(MatchDocument((surface,)), "match", ".npz"))


def names_in(node):
    """Yield the parts of file names that an expression joins to a folder or replaces in a path."""
    parts = []
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
        parts = [node.right]
    elif isinstance(node, ast.Call):
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        parts = node.args if name in ("with_name", "with_stem", "with_suffix", "Path") else []
    for part in parts:
        pieces = part.values if isinstance(part, ast.JoinedStr) else [part]
        values = [getattr(piece, "value", None) for piece in pieces]
        if any(isinstance(value, str) for value in values):
            yield "".join(value if isinstance(value, str) else "x" for value in values)


def test_written_files_have_valid_names(sources):
    names = set().union(*(source.names for source in sources.values()))
    assert {"ledger", "subjects.csv", ".npz", "errors.txt", "figure-xx"} <= names
    assert not [name for name in names if not all(map(is_valid, f"x{name}".split("/")))]
    assert is_valid(f"{atomic._PREFIX}0123456789ab.npz")
    assert is_valid(f"{autosave._PREFIX}12-345{autosave._SUFFIX}")


def test_installed_files_have_valid_names():
    """Windows and macOS ignore the case of names, and Windows limits the length of paths."""
    folders = [*PACKAGES, ROOT / "assets"]
    paths = [
        path.relative_to(ROOT)
        for folder in folders
        for path in folder.rglob("*")
        if "__pycache__" not in path.parts
    ]
    assert len(paths) > 400
    assert not [path for path in paths if not all(map(is_valid, path.parts))]
    assert max(len(str(path)) for path in paths) < 120
    lower = sorted(str(path).lower() for path in paths)
    assert not [name for name, following in pairwise(lower) if name == following]


def test_home_is_abbreviated_in_menus(monkeypatch, tmp_path):
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    assert menus._short(tmp_path / "a" / "m.npz") == os.path.join("~", "a", "m.npz")
    other = tmp_path.with_name(f"{tmp_path.name}s") / "m.npz"
    assert menus._short(other).endswith("m.npz")
    assert not menus._short(other).startswith("~")


# Paths of Windows in texts


def test_channels_of_tables_have_file_names(system):
    expected = WINDOWS_CHANNEL if system.platform == "win32" else CHANNEL
    words = inputs.channel_words(system.channel, "SRC DST WEIGHT")
    assert tuple(words) == expected
    again = inputs.shlex.join(words)
    assert inputs.channel_words(again, "SRC DST WEIGHT") == words


@pytest.mark.parametrize(
    "text",
    [r"file:C:\data\x.npy", r"file:C:\a+b\x.npy,column=2", r"permuted:C:\p.txt(gaussian:vertex=1)"],
)
def test_functions_name_files_with_a_drive(text):
    spec = parse(text)
    assert spec.path.startswith("C:\\")
    assert spec.path.endswith((".npy", ".txt"))
    assert parse(str(spec)) == spec


def test_file_with_a_drive_is_a_function(monkeypatch):
    monkeypatch.setattr(os.path, "splitdrive", ntpath.splitdrive)
    path = r"C:\data\missing.npy"
    assert parse(inputs.read_function.__wrapped__(path)).path == path


def test_sent_files_of_two_drives_are_separate(monkeypatch, tmp_path):
    row = SimpleNamespace(relocated=lambda places: places)
    contents = {r"C:\a\x.npy": b"c", r"D:\a\x.npy": b"d"}
    monkeypatch.setattr(attempt, "os", SimpleNamespace(path=ntpath, sep="\\", fspath=os.fspath))
    places = attempt._with_contents(row, contents, tmp_path)
    assert {path: Path(place).read_bytes() for path, place in places.items()} == contents
    assert all(Path(place).is_relative_to(tmp_path) for place in places.values())


# Texts


def opening_without_encoding(node):
    """Return whether a call opens a text without naming its encoding."""
    name = getattr(node.func, "attr", getattr(node.func, "id", ""))
    named = {keyword.arg: keyword.value for keyword in node.keywords}
    if "encoding" in named or None in named:
        return False
    if name in ("read_text", "write_text"):
        return len(node.args) == (name == "write_text")  # others are functions of ours
    if name in ("run", "Popen", "check_output"):
        return bool({"text", "universal_newlines"} & named.keys())
    if name not in ("open", "fdopen", "NamedTemporaryFile", "TemporaryFile"):
        return False
    is_function = isinstance(node.func, ast.Name) or name == "fdopen"
    place = 1 if is_function else 0  # of the mode among the arguments
    mode = getattr(named.get("mode") or next(iter(node.args[place:]), None), "value", None)
    if mode is None:
        return is_function
    return isinstance(mode, str) and set(mode) <= set("rwaxt+") and bool(set(mode) & set("rwax"))


@pytest.mark.parametrize(
    ("code", "without"),
    [("open(path)", True), ("path.open('w')", True), ("path.read_text()", True),
     ("run(words, text=True)", True), ("open(path, 'rb')", False),
     ("archive.open(name, 'w')", False),
     ("path.write_text(text, encoding='utf-8')", False)],
)  # fmt: skip
def test_texts_without_encoding_are_found(code, without):
    assert opening_without_encoding(ast.parse(code).body[0].value) == without


def test_texts_are_opened_with_an_encoding(sources):
    """On Windows, the default encoding depends on the country."""
    openings = {path: source.openings for path, source in sources.items() if source.openings}
    assert openings == {}


# Fonts, pictures and the window


def test_plots_have_a_font_without_fonts_of_the_system(monkeypatch):
    find = font_manager.findSystemFonts

    def bundled(folders=None, fontext="ttf"):
        return find(folders, fontext) if folders else []

    monkeypatch.setattr(font_manager, "findSystemFonts", bundled)
    fonts = font_manager.FontManager()
    monkeypatch.setattr(font_manager, "findfont", fonts.findfont)
    font = plots.plot_font(16)
    missing = bytes(font.getmask("\uffff"))
    assert all(bytes(font.getmask(sign)) != missing for sign in "aσ≤·")


def test_pictures_have_a_scalable_font():
    """Pillow includes a scalable font."""
    heights = [ImageFont.load_default(size).getbbox("Ag")[3] for size in (10, 40)]
    assert heights[1] > 3 * heights[0]


@pytest.mark.parametrize("transparent", [False, True])
@pytest.mark.parametrize("factor", [1, 2])
def test_pictures_have_their_size_on_dense_screens(transparent, factor, monkeypatch):
    """A Mac draws two pixels for each pixel of a window in both directions."""
    width, height = 6, 4
    pixels = np.full((factor * height, factor * width, 4), 255, dtype=np.uint8)
    pixels[: factor * 2, :, :3] = 100
    screen = SimpleNamespace(
        screenshot_to_buffer=lambda transparent_bg: pixels.copy(),
        get_window_size=lambda: (width, height),
        set_background_color=lambda color: None,
    )
    monkeypatch.setattr(canvas, "ps", screen)
    picture = canvas.rendered(transparent)
    assert picture.shape == (height, width, 4 if transparent else 3)
    assert (picture[:2, :, :3] == 100).all()
    assert (picture[2:, :, :3] == 255).all()


def test_windows_titles_only_its_visible_windows(monkeypatch):
    """Windows are numbers 1 to 4: ours, hidden, without a title, and of another process."""
    titled = []

    def visit_all(visit, _):
        assert all(visit(number, None) for number in range(1, 5))

    def write_owner(window, owner):
        owner._obj.value = os.getpid() if window.value < 4 else os.getpid() + 1

    user32 = SimpleNamespace(
        EnumWindows=visit_all,
        GetWindowThreadProcessId=write_owner,
        IsWindowVisible=lambda window: window.value != 2,
        GetWindowTextLengthW=lambda window: 0 if window.value == 3 else 4,
        SetWindowTextW=lambda window, text: titled.append((window.value, text.value)),
    )
    monkeypatch.setattr(ctypes, "CDLL", {"user32": user32}.get)
    window_title._by_windows("m.npz - abfm")
    assert titled == [(1, "m.npz - abfm")]


def test_bundled_meshes_are_found():
    assert asset_path("eight.off").read_bytes().startswith(b"OFF")
