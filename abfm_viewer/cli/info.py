"""`abfm info`: size, topology and defects of a mesh, or the report of a result or a project."""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import abfm
from abfm import Correspondence, MeshError, TriangleMesh, load_mesh
from abfm.errors import printable
from abfm.loading import task_of
from abfm.maps.symmetry import KINDS, SymmetryError, SymmetryKind, detect_symmetry
from abfm.registration.report import map_details, map_lines
from abfm.tasks.inputs import MESH_FORMATS
from abfm.wording import counted
from abfm_viewer.cli import options
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.cli.explain import help_lines
from abfm_viewer.cli.progress import task_progress
from abfm_viewer.document.kinds import KINDS as DOCUMENT_KINDS
from abfm_viewer.files.contents import PROJECT
from abfm_viewer.files.project import load_project

SUMMARY = "check a mesh, or report what a result or a project contains"
DESCRIPTION = """\
Check a mesh: print its size, topology, repairs and defects. The exit status is 2 if it has defects
that the solver cannot handle.

For a result, print its report: verdict, distortion of the map, speed of a sequence, or outliers of
a population. For a project of the window, print its surfaces and functions as well.

Examples:
  abfm info spot.obj
  abfm info match.npz
  abfm info match.abfm
"""
DETAILS = """\
The report of a match lists the steps of its continuation, with a star at the selected step. That
of a sequence has its speed and uncertainty, that of a population its outliers and variance.
"""


def add_arguments(parser: options.Parser) -> None:
    add = options.adder(parser)
    about = f"{MESH_FORMATS}; a result (.npz); or a project (.abfm)"
    add("mesh", about, "MESH|RESULT.npz|PROJECT.abfm")
    options.add_mesh_options(parser)
    add("--json", "print the report as one JSON object")
    add("--quiet", "do not show progress")


def run(arguments: argparse.Namespace) -> int:
    try:
        with task_progress(arguments.quiet):
            report = _report(arguments)
    except MeshError as error:
        if arguments.json:
            print(json.dumps({"mesh": arguments.mesh, "usable": False, "objection": str(error)}))
        raise
    print(report)
    return 0


def _report(arguments: argparse.Namespace) -> str:
    name, is_table = arguments.mesh, Path(arguments.mesh, "population.npz").is_file()
    if Path(name).is_dir() and not is_table:
        shown = printable(name)
        raise UsageError(
            f"{shown} is a folder; abfm batch --status {shown} reports the state of a batch"
        )
    if is_table or name.endswith(".npz"):
        facts, (first, *others) = _of_result(name)
        own = {"result": name}
        lines = [f"{printable(name)}: {first}", *others]
    elif name.endswith(PROJECT):
        own = {"project": name}
        facts, lines = _of_project(name)
    else:
        facts = describe(load_mesh(name, **options.mesh_options(arguments).changed))
        own, lines = {"mesh": name, "usable": True}, [printable(name), *_lines(facts)]
    return json.dumps(own | facts) if arguments.json else "\n".join(lines)


def _of_result(name: str) -> tuple[dict[str, Any], list[str]]:
    found = abfm.load(name)
    if isinstance(found, Correspondence) and not hasattr(found, "facts"):
        sizes = [f"{len(mesh.faces):,}" for mesh in (found.a, found.b)]
        first = (
            f"map between surface A ({sizes[0]} faces) and surface B ({sizes[1]}), without a match"
        )
        return {"map": map_details(found)}, [first, *map_lines(found)]
    report = task_of(found).report
    return report.details(found), [*report.lines(found), *help_lines(found.facts)]


def _of_project(name: str) -> tuple[dict[str, Any], list[str]]:
    document, _ = load_project(name)
    found = document.complete_result
    kind = next(name for name, each in DOCUMENT_KINDS.items() if each is type(document))
    faces = {each.name: len(each.mesh.faces) for each in document.surfaces}
    functions = [{"source": each.source, "target": each.target} for each in document.channels]
    rows = {
        "document": kind,
        "surfaces": ", ".join(f"{name} ({count:,} faces)" for name, count in faces.items()),
        **{f"function {n}": " to ".join(each.values()) for n, each in enumerate(functions, 1)},
        **({"landmarks": counted(n, "pair")} if (n := len(document.landmarks)) else {}),
        "result": "none" if found is None else found.facts.headline,
    }
    lines = [printable(name), *(f"  {title:<14}{text}" for title, text in rows.items())]
    facts = {"document": kind, "surfaces": faces, "functions": functions, "result": None}
    if found is None:
        return facts, lines
    report = task_of(found).report
    facts["result"] = report.details(found)
    return facts, [*lines, *report.lines(found)[1:], *help_lines(found.facts)]


def describe(mesh: TriangleMesh) -> dict[str, Any]:
    """Return counts, topology and sizes of a mesh; lengths are in the unit of the file."""
    lengths = abfm.calculus.edge_lengths(mesh)
    shortest, median, longest = lengths.min(), float(np.median(lengths)), lengths.max()
    return {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "edges": len(mesh.edges),
        "genus": mesh.genus,
        "boundary_loops": len(mesh.boundary_loops),
        "area": mesh.length_scale**2,
        "length_scale": mesh.length_scale,
        "bounding_box": [mesh.vertices.min(axis=0).tolist(), mesh.vertices.max(axis=0).tolist()],
        "edge_lengths": {"shortest": shortest, "median": median, "longest": longest},
        "edge_ratio": longest / shortest,
        "symmetries": {kind: _symmetry(mesh, kind) for kind in KINDS},
        "messages": list(mesh.messages),
    }


def _symmetry(mesh: TriangleMesh, kind: SymmetryKind) -> dict[str, Any] | None:
    """Return axis and error of a symmetry of the mesh; None if it has no symmetry of this kind.

    Functions of the form ``permuted:`` use the same symmetry.
    """
    try:
        found = detect_symmetry(mesh, kind)
    except SymmetryError:
        return None
    numbers = {"error": found.error, "is_permutation": found.is_permutation}
    return {"axis": found.axis.tolist(), **numbers}


def _symmetry_words(kind: str, symmetry: dict[str, Any] | None) -> str:
    if symmetry is None:
        return "not found"
    across = "with normal" if kind == "mirror" else "by 180 degrees about"
    axis = " ".join(f"{value:.3g}" for value in np.round(symmetry["axis"], 3) + 0.0)
    images = "vertices" if symmetry["is_permutation"] else "points between vertices"
    return (
        f"{across} {axis}, maps vertices to {images}, error {symmetry['error']:.1g} length scales"
    )


def _lines(facts: dict[str, Any]) -> list[str]:
    box = [" ".join(f"{value:.4g}" for value in corner) for corner in facts["bounding_box"]]
    shortest, median, longest = facts["edge_lengths"].values()
    loops, scale = facts["boundary_loops"], facts["length_scale"]
    rows = {
        **{name: f"{facts[name]:,}" for name in ("vertices", "faces", "edges")},
        "genus": facts["genus"],
        "boundary": counted(loops, "loop") if loops else "none (closed)",
        "area": f"{facts['area']:.6g}",
        "length scale": f"{scale:.6g}   (square root of the area; unit of Gaussian widths)",
        "bounding box": "  to  ".join(box),
        "edge lengths": f"{shortest:.4g} to {longest:.4g}, median {median:.4g}",
        "edge ratio": f"{facts['edge_ratio']:.4g}   (longest to shortest)",
        **{kind: _symmetry_words(kind, symmetry) for kind, symmetry in facts["symmetries"].items()},
    }
    lines = [f"  {name:<14}{value}" for name, value in rows.items()]
    notes = [f"  note: {message}" for message in facts["messages"]]
    return [*lines, *notes, "  no defects: this mesh can be used"]
