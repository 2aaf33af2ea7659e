"""Pages of the reference that are written from the code: API, commands, parameters, functions."""

import contextlib
import io
from inspect import isclass, isfunction, unwrap
from pathlib import Path
from types import ModuleType

import abfm
from abfm.functions import Family, Parameter, families
from abfm.parameters import FIELDS, PAPER, TABLE_1
from abfm_viewer.cli import main
from abfm_viewer.cli.commands import COMMANDS

_PACKAGES = {
    "functions": "Functions on a mesh, from text or files.",
    "calculus": "Discrete operators, vector fields, eigenfunctions and geodesic distances.",
    "flow": "Flows of vector fields and flow lines.",
    "maps": "Point maps, functional maps, distortion and accuracy.",
    "matching": "The matching problem, its result and its verdict.",
    "registration": "Registration of two surfaces.",
    "sequences": "Sequences of frames: fields, tracks and episodes.",
    "population": "Iterative registration of many subjects to a template.",
    "batch": "Tables of problems on local processes or a Dask cluster.",
    "io": "Files for other programs.",
    "pages": "Pages for a browser and views for notebooks.",
    "streaks": "Line integral convolution.",
    "baselines": "Methods to compare with: optimal transport, Horn-Schunck, linear blend.",
    "experiments": "The figures of the paper as scripts.",
}
EXAMPLES = {
    "gaussian": "gaussian:vertex=12,width=0.1",
    "eigenfunction": "eigenfunction:7",
    "hks": "hks:time=0.01",
    "wks": "wks:energy=5",
    "curvature": "curvature:mean",
    "coordinate": "coordinate:z",
    "geodesic": "geodesic:vertex=12",
    "shape-diameter": "shape-diameter",
    "indicator": "indicator:vertex=12,radius=0.2",
    "file": "file:values.npy",
    "expression": "expression:sin(10*x)*z",
    "permuted": "permuted:mirror(gaussian:vertex=12)",
    "scaled": "scaled:2,offset=1(coordinate:z)",
    "smoothed": "smoothed:0.05(curvature:mean)",
    "circular": "circular:period=360(file:angle.npy)",
}


def write(folder: Path) -> None:
    """Write all generated pages into a folder; unchanged files keep their time."""
    pages = {
        "api.rst": _api(),
        "commands.md": _commands(),
        "parameters.md": _parameters(),
        "functions.md": _functions(),
    }
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _api() -> str:
    public = [name for name in dir(abfm) if not name.startswith("_")]
    objects = [name for name in public if not isinstance(getattr(abfm, name), ModuleType)]
    functions = [name for name in objects if name.islower()]
    errors = [name for name in objects if name.endswith("Error")]
    classes = [name for name in objects if name not in {*functions, *errors}]
    parts = [
        _title("Python API", "="),
        "``import abfm`` gives the names of the first three tables. The packages below them have "
        "tools for experts.",
        _table("Functions", [f"abfm.{name}" for name in functions]),
        _table("Classes", [f"abfm.{name}" for name in classes]),
        _table("Errors", [f"abfm.{name}" for name in errors]),
    ]
    for package, summary in _PACKAGES.items():
        names = [
            f"abfm.{package}.{name}"
            for name, value in _public_values(getattr(abfm, package)).items()
            if name not in public and (isfunction(unwrap(value)) or isclass(value))
        ]
        parts.append(_table(f"abfm.{package}", names, summary))
    return "\n\n".join(parts) + "\n"


def _public_values(module: ModuleType) -> dict[str, object]:
    """Return the public objects of a package by name, which imports them."""
    return {name: getattr(module, name) for name in dir(module) if not name.startswith("_")}


def _table(title: str, names: list[str], summary: str = "") -> str:
    rows = "\n   ".join(names)
    head = f"{_title(title, '-')}\n\n{summary}\n\n"
    return f"{head}.. autosummary::\n   :toctree: generated\n\n   {rows}"


def _title(words: str, line: str) -> str:
    return f"{words}\n{line * len(words)}"


def _commands() -> str:
    parts = [
        "# Commands",
        "Every command has a short `--help` and a complete `--help-all`, which is printed here.",
    ]
    for command in ("", *COMMANDS):
        title = f"abfm {command}".strip()
        words = [command, "--help-all"] if command else ["--help"]
        parts.append(f"## {title}\n\n```text\n{_output_of(words)}\n```")
    return "\n\n".join(parts) + "\n"


def _output_of(words: list[str]) -> str:
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.suppress(SystemExit):
        main(words)
    return output.getvalue().rstrip()


def _parameters() -> str:
    rows = [
        f"| `{name}` | {entry.metadata['symbol']} | {_cell(entry.metadata['help'])} | "
        f"`{entry.default}`{' (auto)' if entry.default is None else ''} |"
        for name, entry in FIELDS.items()
    ]
    star = "\\*"
    table = [
        f"| {row.figure} | {row.tau:g} | {row.alpha:g} | {row.beta:g} | "
        f"{row.sigma:g}{star if row.cooled else ''} | {row.N or ''} | {row.n or ''} |"
        for row in TABLE_1.values()
    ]
    paper = "\n".join(f"- `{name}={value!r}`" for name, value in PAPER.items())
    return _PARAMETERS.format(rows="\n".join(rows), table="\n".join(table), paper=paper)


_PARAMETERS = r"""# Parameters

A match minimises the energy of the paper (Eq. 3) over tangent vector fields $v$:

$$E(v) = \frac12 \int_0^\tau \|v_t\|_\alpha^2 \, dt + \frac{{1}}{{2 \sigma^2}} \|f_\tau - g\|^2 .$$

The first term is the regularity of the field, with weight $\alpha$ of its Hodge Laplacian. The
second is the mismatch between the advected source $f_\tau$ and the target $g$, with weight $\beta$
of its gradient. The mesh is scaled to unit area, so that values mean the same on every mesh.

| parameter | symbol | meaning | default |
|---|---|---|---|
{rows}

The first eight are arguments of `abfm.Parameters` and options such as `--landmark-sigma 0.02`. The
others are set by `--set levels=2`, or in Python by `Parameters.of(sigma=0.1, levels=2)`.

## The energy of the paper

Measurements led to defaults that differ from the paper ([Convergence](../convergence.md)). The
energy and the continuation of the paper (`abfm.parameters.PAPER`) are

{paper}

## Table 1 of the paper

N is the number of linearised steps, and n the number of sub-steps of the exponential. A star marks
a $\sigma$ that is the first of three cooling stages.

| figure | $\tau$ | $\alpha$ | $\beta$ | $\sigma$ | N | n |
|---|---|---|---|---|---|---|
{table}
"""


def _functions() -> str:
    parts = [
        "# Functions as text",
        "A function is written as `family:key=value,...`. Several functions are added with `+`. "
        "Vertices are counted from 0 as in the mesh file, also after repairs.",
    ]
    parts += [_family(family) for family in families()]
    return "\n\n".join(parts) + "\n"


def _family(family: type[Family]) -> str:
    rows = [
        f"| `{entry.name}` | {_cell(entry.summary)} | {_cell(entry.kind.name)} | "
        f"{_default(entry)} | {entry.unit} |"
        for entry in family.parameters()
    ]
    head = "| key | meaning | value | default | unit |\n|---|---|---|---|---|\n"
    title = f"## {family.family}\n\n{family.summary()}\n\n    {EXAMPLES[family.family]}\n\n"
    return title + (head + "\n".join(rows) if rows else "")


def _default(entry: Parameter) -> str:
    if entry.required:
        return "required"
    return "" if entry.default is None else f"`{entry.default}`"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
