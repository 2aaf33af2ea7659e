"""The distribution, the start script, and what importing may not do."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import stat
import subprocess
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = (ROOT / "core" / "abfm", ROOT / "abfm_viewer")


def python(code: str, **environment: str) -> str:
    """What a fresh interpreter prints."""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=os.environ | environment
    )
    return done.stdout.strip()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel that is built from the source distribution, as others do who pack or install abfm."""
    folder = tmp_path_factory.mktemp("built")
    source = folder / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".*", "__pycache__", "out", "build", "dist"))
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder], cwd=source, check=True)
    [archive] = folder.glob("abfm-*.tar.gz")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder]
    subprocess.run([*command, archive], check=True)
    [wheel] = folder.glob("abfm-*.whl")
    return wheel


def test_the_wheel_holds_both_packages_and_every_asset(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    for asset in (ROOT / "assets").iterdir():
        assert f"abfm/assets/{asset.name}" in names
    assert {"abfm/matching/match.py", "abfm/flow/__init__.pyi", "abfm_viewer/cli/match.py"} <= set(names)
    assert "abfm_viewer/appearance/colormaps.csv" in names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert {name.split("/")[0].split("-")[0] for name in names} == {"abfm", "abfm_viewer"}


def test_what_is_installed_from_the_wheel_works_outside_of_the_repository(wheel, tmp_path):
    """In an empty environment that borrows the libraries, but not abfm, from the one that runs the tests."""
    home = tmp_path / "environment"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    inside = home / "bin" / "python"
    install = ["pip", "--quiet", "--python", inside, "install", "--no-deps", "--no-index", "--no-compile", wheel]
    subprocess.run([sys.executable, "-m", *install], check=True)
    [packages] = home.glob("lib/*/site-packages")
    (packages / "borrowed.pth").write_text("\n".join(path for path in sys.path if path.endswith("-packages")))
    alone = {
        name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "DISPLAY", "WAYLAND_DISPLAY")
    }

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [home / "bin" / words[0], *words[1:]]
        return subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=alone)

    mesh = run("python", "-c", "from abfm.assets import asset_path; print(asset_path('eight.off'))").stdout.strip()
    assert Path(mesh).parent == packages / "abfm" / "assets"
    assert run("abfm", "--version").stdout == f"abfm {version('abfm')}\n"
    assert "315" in run("abfm", "info", mesh).stdout
    assert run("abfm-viewer").stderr.startswith("abfm-viewer: no screen")


def test_every_room_has_its_line_in_the_plan_of_the_house():
    plan = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    listed = {room for row in re.findall(r"^\| (`.*?) \|", plan, re.MULTILINE) for room in re.findall(r"`(\w+)/`", row)}
    assert listed == {init.parent.name for package in PACKAGES for init in package.glob("*/__init__.py")}


def test_no_file_is_longer_than_what_one_idea_needs():
    assert [f for package in PACKAGES for f in package.rglob("*.py") if len(f.read_text().splitlines()) > 300] == []


def test_matching_and_the_command_line_need_no_opengl():
    code = "import sys, abfm, abfm_viewer.cli.commands, abfm_viewer.app; abfm.match; print('polyscope' in sys.modules)"
    assert python(code) == "False"


def test_blas_gets_one_thread_unless_the_user_says_otherwise():
    code = "import os, abfm_viewer; print(os.environ['OPENBLAS_NUM_THREADS'], os.environ['OMP_NUM_THREADS'])"
    unset = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=unset)
    assert done.stdout == "1 1\n"
    assert python(code, OMP_NUM_THREADS="3", OPENBLAS_NUM_THREADS="2") == "2 3"


def test_what_cannot_draw_says_so_in_one_line(tmp_path):
    """Without libEGL polyscope would crash; ctypes is made to miss it."""
    code = (
        "import ctypes, sys, abfm_viewer.cli.commands\n"
        "from abfm_viewer.cli import main\n"
        "def missing(name): raise OSError(f'{name}: cannot open shared object file')\n"
        "ctypes.CDLL = missing\n"
        f"sys.exit(main(['demo', '--quiet', '--out', {str(tmp_path)!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert done.stderr.startswith("note: no picture and no movie: cannot draw")
    assert done.stderr.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["demo.npz"]


def test_the_app_without_a_screen_says_what_to_do():
    without = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    code = "import sys; from abfm_viewer.app import main; sys.exit(main([]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=without)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith("abfm-viewer: no screen")


@pytest.fixture
def house(tmp_path):
    """A folder with a blank in its name that holds `run` and an environment that looks installed."""
    house = tmp_path / "my house"
    programs = house / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("run", "pyproject.toml"):
        shutil.copy(ROOT / name, house)
    program(programs / "python", f'exec {shlex.quote(sys.executable)} "$@"')
    for name in ("abfm", "abfm-viewer"):
        program(programs / name, f'echo {name} "$#" "$@"')
    stamp_installed(house)
    return house


def program(path: Path, command: str) -> None:
    """A shell script that may be run."""
    path.write_text(f"#!/bin/sh\n{command}\n")
    path.chmod(stat.S_IRWXU)


def stamp_installed(house: Path) -> None:
    """Make `run` believe that the project was installed as its pyproject.toml says."""
    for name in ("installed", "installed-test"):
        (house / ".venv" / name).write_text(f"{house}\n{(house / 'pyproject.toml').read_text()}")


@pytest.mark.parametrize(
    ("screen", "words", "expected"),
    [
        ({"DISPLAY": ":0"}, ["my mesh.off"], "abfm-viewer 1 my mesh.off\n"),
        ({"WAYLAND_DISPLAY": "wayland-0"}, [], "abfm-viewer 0\n"),
        ({}, [], "abfm 1 demo\n"),
    ],
)
def test_run_opens_the_app_or_without_a_screen_the_demo(house, tmp_path, screen, words, expected):
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        [house / "run", *words], capture_output=True, text=True, check=False, cwd=tmp_path, env=environment | screen
    )
    assert (done.returncode, done.stdout) == (0, expected)


def test_run_installs_and_tests_the_oldest_versions_on_request(house):
    """The environment's Python tells what it was asked for, and which versions held then."""
    programs = house / ".venv-oldest" / "bin"
    programs.mkdir(parents=True)
    program(programs / "python", 'echo "${PIP_CONSTRAINT:+held: }$*"')
    done = subprocess.run(
        [house / "run", "test", "--oldest", "tests/some.py"], capture_output=True, text=True, check=True
    )
    versions = programs.parent / "oldest.txt"
    asked = [line for line in done.stdout.splitlines() if "-c" not in line.split()]
    install, compiled, editable, tests = asked
    assert install.endswith("install uv")
    assert compiled.startswith("held: -m uv pip compile --quiet --no-header --resolution=lowest-direct --extra=gifti")
    assert f"--output-file={versions} {house / 'pyproject.toml'}" in compiled
    assert editable.startswith("held: -m pip")
    assert editable.endswith(f"--editable {house}[test]")
    assert tests == "held: -m pytest --numprocesses=auto --dist=worksteal tests/some.py"


def test_run_test_reports_every_check_that_failed(house):
    """The copy has neither code nor settings for import-linter: some checks fail, and all of them run."""
    (house / "pyproject.toml").write_text("[tool.mypy]\nfiles = ['missing']\n")
    stamp_installed(house)
    shutil.copy(Path(sys.executable).parent / "lint-imports", house / ".venv" / "bin")
    done = subprocess.run([house / "run", "test"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.endswith("run: failed: mypy, import-linter, pytest\n")
    for name in ("ruff check", "ruff format", "mypy", "import-linter", "pytest"):
        assert f"\n== {name}\n" in done.stdout


@pytest.fixture
def bare_machine(house, tmp_path):
    """An environment in which only a few programs are there, and Python and sudo do as if all went well."""
    programs = tmp_path / "programs"
    programs.mkdir()
    for name in ("bash", "sh", "cat", "dirname", "env", "id", "touch", "chmod"):
        (programs / name).symlink_to(shutil.which(name))
    program(programs / "uname", "echo Linux")
    program(programs / "sudo", 'shift; exec "$@"')
    program(house / ".venv" / "bin" / "python", "exit 0")
    return programs


def run_tests(house: Path, programs: Path) -> subprocess.CompletedProcess[str]:
    """`./run test` with these programs and no others."""
    return subprocess.run(
        [house / "run", "test"], capture_output=True, text=True, check=False, env={"PATH": str(programs)}
    )


def test_run_test_installs_what_a_window_without_a_screen_needs(house, bare_machine, tmp_path):
    installed = f'for name in Xvfb xdotool; do touch "{bare_machine}/$name"; chmod +x "{bare_machine}/$name"; done'
    program(bare_machine / "apt-get", f'echo "$@" >>"{tmp_path}/asked"; {installed}')
    for _ in range(2):
        assert run_tests(house, bare_machine).returncode == 0
    assert (tmp_path / "asked").read_text() == "--yes --quiet install --no-install-recommends xvfb xdotool\n"


@pytest.mark.parametrize(
    ("apt", "advice"), [(None, "install them"), ("exit 1", "type: sudo apt-get install xvfb xdotool")]
)
def test_run_test_says_what_to_install_where_it_cannot(house, bare_machine, apt, advice):
    if apt:
        program(bare_machine / "apt-get", apt)
    done = run_tests(house, bare_machine)
    assert done.returncode == 0  # it goes on: the one test that needs them fails
    assert done.stderr.splitlines()[-1].endswith(advice)


def test_run_test_with_words_is_pytest_alone(house):
    program(house / ".venv" / "bin" / "python", 'printf "%s;" "$@"')
    done = subprocess.run(
        [house / "run", "test", "tests/a file.py", "-k", "one or two"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert done.stdout.endswith("-m;pytest;tests/a file.py;-k;one or two;")
    assert "==" not in done.stdout


def test_run_keeps_compiled_modules(house):
    """A process that finds none compiles hundreds, and tests start many."""
    program(house / ".venv" / "bin" / "python", 'printf "%s" "${PYTHONDONTWRITEBYTECODE-kept}"')
    done = subprocess.run(
        [house / "run", "test", "tests"],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
    )
    assert done.stdout.endswith("kept")


def test_run_is_understood_by_bash():
    subprocess.run(["bash", "-n", ROOT / "run"], check=True)
