import ast
import json
import os
import re
import shlex
import shutil
import stat
import sys
import zipfile
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.processes import ROOT, python, run

# modules of the extra "app"
OF_THE_APP = ("av", "matplotlib", "PIL", "platformdirs", "polyscope", "polyscope_bindings")
PACKAGES = (ROOT / "core" / "abfm", ROOT / "abfm_viewer")


def environment_without(*names):
    return {name: value for name, value in os.environ.items() if name not in names}


NO_SCREEN = environment_without("DISPLAY", "WAYLAND_DISPLAY")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Return the wheel that is built from the source distribution."""
    folder = tmp_path_factory.mktemp("built")
    ignored = shutil.ignore_patterns(".*", "__pycache__", "out", "build", "dist")
    source = shutil.copytree(ROOT, folder / "source", ignore=ignored)
    build = ("-m", "hatchling", "build", "-t", "sdist", "-d", folder)
    run(sys.executable, *build, cwd=source, check=True)
    pip = ("-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder)
    run(sys.executable, *pip, *folder.glob("abfm-*.tar.gz"), check=True)
    [wheel] = folder.glob("abfm-*.whl")
    return wheel


def test_wheel_has_both_packages_and_all_assets(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {f"abfm/assets/{asset.name}" for asset in (ROOT / "assets").iterdir()} <= names
    assert {"abfm/matching/match.py", "abfm/flow/__init__.pyi", "abfm_viewer/cli/solve.py"} <= names
    assert {"abfm/pages/colormaps.csv", "abfm/py.typed", "abfm_viewer/py.typed"} <= names
    for folder in ("core/abfm/pages/template", "abfm_viewer/reports/templates"):
        place = folder.removeprefix("core/")
        assert {f"{place}/{path.name}" for path in (ROOT / folder).iterdir()} <= names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert {name.split("/")[0].split("-")[0] for name in names} == {"abfm", "abfm_viewer"}


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """Return a function that runs programs of an environment with the wheel.

    The environment borrows the libraries of the present one.
    """
    folder = tmp_path_factory.mktemp("installed")
    home = folder / "environment"
    run(sys.executable, "-m", "venv", "--without-pip", home, check=True)
    pip = ("-m", "pip", "--quiet", "--python", home / "bin" / "python", "install")
    run(sys.executable, *pip, "--no-deps", "--no-index", "--no-compile", wheel, check=True)
    [packages] = home.glob("lib/*/site-packages")
    borrowed = "\n".join(path for path in sys.path if path.endswith("-packages"))
    (packages / "borrowed.pth").write_text(borrowed)
    (packages / "without_app.py").write_text(WITHOUT_APP)
    (packages / "without_app.pth").write_text("import without_app")
    # copies compiled code, which is valid for source files of the same time and size
    for package in PACKAGES:
        for path in package.rglob("*.*"):
            there = packages / path.relative_to(package.parent)
            if path.suffix in {".nbi", ".nbc", ".pyc"}:
                there.parent.mkdir(exist_ok=True)
                shutil.copy(path, there)
            elif path.suffix == ".py":
                shutil.copystat(path, there)
    alone = environment_without("PYTHONPATH", "DISPLAY", "WAYLAND_DISPLAY")

    def run_installed(program, *words, **more):
        return run(home / "bin" / program, *words, cwd=folder, env=alone | more)

    return run_installed


# on a mesh where it is fast
SMALL_DEMO = """
import sys, abfm_viewer.cli.demo as demo
from abfm_viewer.cli import main
mesh = demo.asset_path("eight.off")
demo.asset_path = lambda name: mesh
demo.SOURCE, demo.TARGET = (f"gaussian:vertex={v},width=0.3" for v in (0, 100))
"""
NO_LIBRARY = """
import ctypes
def missing(name): raise OSError(f"{name}: cannot open shared object file")
ctypes.CDLL = missing
"""
COMMANDS = """
import json, sys
from abfm_viewer.cli import main
print([main(words) for words in json.loads(sys.argv[1])])
"""
RUN_DEMO = 'sys.exit(main(["demo", "--quiet", "--out", sys.argv[1]]))'
WITHOUT_APP = f"""
import os, sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {OF_THE_APP}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

if "WITHOUT_APP" in os.environ:
    sys.meta_path.insert(0, Missing())
"""


def test_installed_wheel_works_outside_the_repository(installed):
    code = "from abfm.assets import asset_path; print(asset_path('eight.off'))"
    mesh = installed("python", "-c", code).stdout.strip()
    assert Path(mesh).parent.parts[-3:] == ("site-packages", "abfm", "assets")
    assert "FACTOR" in installed("abfm", "explain", "values-differ").stdout
    assert installed("abfm", "--version").stdout == f"abfm {version('abfm')}\n"
    assert "315" in installed("abfm", "info", mesh).stdout
    assert installed("abfm-viewer").stderr.startswith("abfm-viewer: there is no screen")


def test_without_the_app_only_drawing_is_missing(installed, tmp_path):
    install = "pip install 'abfm[app]'"
    without_app = {"WITHOUT_APP": "yes"}
    demo = installed("python", "-c", SMALL_DEMO + RUN_DEMO, tmp_path, **without_app)
    assert demo.returncode == 0
    assert all(line.startswith("note: ") for line in demo.stderr.splitlines())
    assert "no picture and no movie" in demo.stderr.splitlines()[-1]
    assert demo.stderr.strip().endswith(install)
    assert [path.name for path in tmp_path.iterdir()] == ["demo.npz"]
    mesh, result = ROOT / "assets" / "eight.off", tmp_path / "demo.npz"
    commands = [
        ["map", result, "--out", tmp_path / "map.csv"],
        ["figure", "6", "--mesh", mesh, "--quiet", "--out", tmp_path],
        *(["render", result, "--out", tmp_path / name] for name in ("a.html", "a.png", "a.mp4")),
    ]
    text = json.dumps(commands, default=str)
    done = installed("python", "-c", COMMANDS, text, **without_app)
    assert json.loads(done.stdout.splitlines()[-1]) == [0, 2, 0, 2, 2]
    window = installed("abfm-viewer", **without_app)
    assert window.returncode == 2
    lines = done.stderr.splitlines() + window.stderr.splitlines()
    assert len(lines) == 4
    assert [line for line in lines if not line.endswith(install)] == []


def test_every_package_is_in_the_tables_of_architecture():
    plan = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    rows = "".join(re.findall(r"^\| (`.*?) \|", plan, re.MULTILINE))
    folders = {init.parent.name for package in PACKAGES for init in package.glob("*/__init__.py")}
    assert set(re.findall(r"`(\w+)/`", rows)) == folders


def test_packages_have_few_modules():
    """A listing has at most 18 entries."""
    folders = [init.parent for package in PACKAGES for init in package.glob("*/**/__init__.py")]
    counts = {folder.name: len({*os.listdir(folder)} - {"__pycache__"}) for folder in folders}
    assert {name: count for name, count in counts.items() if count > 18} == {}


def bound_names(statement):
    """Return the names that a statement binds, except decorated ones and overloads."""
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        return [] if statement.decorator_list else [statement.name]
    if not isinstance(statement, ast.Assign | ast.AnnAssign) or statement.value is None:
        return []
    names = [node for node in ast.walk(statement) if isinstance(node, ast.Name)]
    used = {name.id for name in names if isinstance(name.ctx, ast.Load)}
    return [name.id for name in names if isinstance(name.ctx, ast.Store) and name.id not in used]


def test_no_module_binds_a_name_twice():
    """A second constant of the same name would replace the first one."""
    for path in (path for package in PACKAGES for path in package.rglob("*.py")):
        names = [name for each in ast.parse(path.read_text()).body for name in bound_names(each)]
        assert sorted(names) == sorted(set(names)), path


def test_command_line_needs_no_opengl():
    code = (
        "import sys, abfm, abfm_viewer.app; from abfm_viewer.cli import main; abfm.match; "
        "main([]); print('polyscope' in sys.modules)"
    )
    assert python(code).stdout.endswith("\nFalse\n")


def test_blas_has_one_thread_by_default():
    names = "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"
    code = f"import os, abfm_viewer; print(*map(os.environ.get, {names}))"
    unset = environment_without(*names)
    assert python(code, env=unset).stdout == "1 1\n"
    assert python(code, env=unset | dict(zip(names, "23", strict=True))).stdout == "2 3\n"


def test_missing_opengl_is_one_line(tmp_path):
    """Without libEGL, simulated by ctypes, the demo prints one note instead of crashing."""
    done = python(SMALL_DEMO + NO_LIBRARY + RUN_DEMO, tmp_path)
    assert (done.returncode, done.stderr.count("\n")) == (0, 1)
    assert done.stderr.startswith("note: no picture and no movie: cannot draw")
    assert [path.name for path in tmp_path.iterdir()] == ["demo.npz"]


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        (os.environ | {"NUMBA_NUM_THREADS": "0"}, "abfm-viewer: numba"),
        (NO_SCREEN, "abfm-viewer: there is no screen"),
    ],
)
def test_app_that_cannot_start_prints_one_line(environment, words):
    code = "import sys; from abfm_viewer.app import main; sys.exit(main([]))"
    done = python(code, env=environment)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith(words)


@pytest.fixture
def project(tmp_path):
    """Return a copy of `run` with a blank and an accent in its path, which looks installed."""
    project = tmp_path / "my höuse"
    programs = project / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in ("run", "pyproject.toml"):
        shutil.copy(ROOT / name, project)
    program(programs / "python", f'exec {shlex.quote(sys.executable)} "$@"')
    for name in ("abfm", "abfm-viewer"):
        program(programs / name, f'echo {name} "$#" "$@"')
    stamp_installed(project)
    return project


def program(path, command):
    path.write_text(f"#!/bin/sh\n{command}\n")
    path.chmod(stat.S_IRWXU)


def stamp_installed(project):
    """Write the files by which `run` recognizes an installed project."""
    for name in ("installed-app", "installed-test"):
        (project / ".venv" / name).write_text(
            f"{project}\n{(project / 'pyproject.toml').read_text()}"
        )


@pytest.mark.parametrize(
    ("screen", "words", "expected"),
    [
        ({"DISPLAY": ":0"}, ["my mesh.off"], "abfm-viewer 1 my mesh.off\n"),
        ({"WAYLAND_DISPLAY": "wayland-0"}, [], "abfm-viewer 0\n"),
        ({}, [], "abfm 1 demo\n"),
    ],
)
def test_run_opens_the_app_or_the_demo(project, tmp_path, screen, words, expected):
    done = run(project / "run", *words, cwd=tmp_path, env=NO_SCREEN | screen)
    assert (done.returncode, done.stdout) == (0, expected)


def test_run_can_test_the_oldest_versions(project):
    """A program in place of Python prints its arguments, and whether versions are constrained."""
    programs = project / ".venv-oldest" / "bin"
    programs.mkdir(parents=True)
    program(programs / "python", 'echo "${UV_CONSTRAINT:+constrained: }$*"')
    done = run(project / "run", "test", "--oldest", "tests/some.py")
    requested = [line for line in done.stdout.splitlines() if "-c" not in line.split()]
    install, compiled, _, editable, tests = requested
    assert install.endswith("uv")
    assert compiled.startswith(
        "-m uv pip compile --quiet --no-header --resolution=lowest-direct --extra=app"
    )
    versions, settings = programs.parent / "oldest.txt", project / "pyproject.toml"
    assert f"--output-file={versions} {settings}" in compiled
    assert editable.startswith("constrained: -m uv pip install")
    assert editable.endswith(f"--editable {project}[test]")
    assert tests == "constrained: -m pytest --numprocesses=auto --dist=worksteal tests/some.py"


def test_run_installs_with_pip_if_uv_fails(project):
    (project / ".venv" / "installed-test").unlink()
    program(project / ".venv" / "bin" / "python", 'echo "$*"; [ "$2" != uv ]')
    done = run(project / "run", "test", "tests/some.py")
    *_, editable, tests = [line for line in done.stdout.splitlines() if "-c" not in line.split()]
    assert editable.startswith("-m pip")
    assert editable.endswith(f"--editable {project}[test]")
    assert tests == "-m pytest tests/some.py"


def test_run_test_reports_all_failed_checks(project):
    """All checks run although the first ones fail on a copy without code."""
    (project / "tests").mkdir()
    for name in ("__init__", "warm_up"):  # there is nothing to compile
        (project / "tests" / f"{name}.py").touch()
    (project / "pyproject.toml").write_text("[tool.mypy]\nfiles = ['missing']\n")
    stamp_installed(project)
    shutil.copy(Path(sys.executable).parent / "lint-imports", project / ".venv" / "bin")
    done = run(project / "run", "test")
    assert done.returncode == 2
    assert done.stderr.endswith("run: failed: mypy, import-linter, pytest\n")
    for name in ("ruff check", "ruff format", "mypy", "import-linter", "pytest"):
        assert f"\n== {name}\n" in done.stdout


@pytest.fixture
def minimal_machine(project, tmp_path):
    """Return a folder with few programs; Python and sudo succeed without effect."""
    programs = tmp_path / "programs"
    programs.mkdir()
    for name in ("bash", "sh", "cat", "dirname", "env", "id", "touch", "chmod"):
        (programs / name).symlink_to(shutil.which(name))
    program(programs / "uname", "echo Linux")
    program(programs / "sudo", 'shift; exec "$@"')
    program(project / ".venv" / "bin" / "python", "exit 0")
    return programs


def test_run_test_installs_programs_of_tests(project, minimal_machine, tmp_path):
    names = ("Xvfb", "xdotool", "chromium", "chromedriver")
    every = " ".join(f'"{minimal_machine / name}"' for name in names)
    install = f"touch {every} && chmod +x {every}"
    program(minimal_machine / "apt-get", f'echo "$@" >>"{tmp_path}/requested"; {install}')
    for _ in range(2):
        assert run(project / "run", "test", env={"PATH": str(minimal_machine)}).returncode == 0
    requested = (tmp_path / "requested").read_text()
    packages = "xvfb xdotool chromium chromium-driver"
    assert requested == f"--yes --quiet install --no-install-recommends {packages}\n"


@pytest.mark.parametrize(
    ("apt", "advice"),
    [
        (None, "install them"),
        ("exit 1", "run: sudo apt-get install xvfb xdotool chromium chromium-driver"),
    ],
)
def test_run_test_names_programs_to_install(project, minimal_machine, apt, advice):
    if apt:
        program(minimal_machine / "apt-get", apt)
    done = run(project / "run", "test", env={"PATH": str(minimal_machine)})
    assert done.returncode == 0  # it continues, and the tests that need them fail
    assert done.stderr.splitlines()[-1].endswith(advice)


def test_run_test_with_arguments_is_only_pytest(project):
    """Compiled modules are stored, because tests start many processes."""
    command = 'printf "%s;" "$@" "${PYTHONDONTWRITEBYTECODE-kept}"'
    program(project / ".venv" / "bin" / "python", command)
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    done = run(project / "run", "test", "tests/a file.py", "-k", "one or two", env=environment)
    assert done.returncode == 0
    assert done.stdout.endswith("-m;pytest;tests/a file.py;-k;one or two;kept;")
    assert "==" not in done.stdout


def test_run_is_valid_bash():
    run("bash", "-n", ROOT / "run", check=True)


def test_ci_runs_in_a_copy_with_a_difficult_path(tmp_path):
    """The copy has no environments; its exit status is passed on, and nothing remains."""
    checkout, temporary = tmp_path / "checkout", tmp_path / "temporary"
    for folder in (checkout / ".ci", checkout / ".venv", temporary):
        folder.mkdir(parents=True)
    shutil.copy(ROOT / ".ci" / "run", checkout / ".ci")
    (checkout / ".gitignore").touch()
    program(checkout / "run", 'echo "$@"; cd "$(dirname "$0")"; ls -A; pwd; exit 5')
    done = run(checkout / ".ci" / "run", env=os.environ | {"TMPDIR": str(temporary)})
    words, *names, place = done.stdout.splitlines()
    assert (done.returncode, words) == (5, "test")
    assert sorted(names) == [".ci", ".gitignore", "run"]
    assert place.startswith(str(temporary))
    assert " " in place
    assert not place.isascii()
    assert list(temporary.iterdir()) == []
