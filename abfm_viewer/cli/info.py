"""`abfm info`: what a mesh is and what the solver would object to."""

import argparse
import json
from typing import Any

import numpy as np

import abfm
from abfm import MeshError, TriangleMesh, load_mesh
from abfm.errors import printable
from abfm.maps.symmetry import KINDS, SymmetryError, detect_symmetry
from abfm_viewer.cli import options

SUMMARY = "what a mesh is and what the solver would object to"
DESCRIPTION = """\
Say what a mesh is, what was repaired, and what the solver would object to (then the exit status is
2).

Example:
  abfm info spot.obj
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    options.add_mesh(parser)
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Print the report."""
    try:
        mesh = load_mesh(arguments.mesh, largest_component=arguments.largest_component)
    except MeshError as error:
        if arguments.json:
            print(json.dumps({"mesh": arguments.mesh, "usable": False, "objection": str(error)}))
        raise
    facts = describe(mesh)
    if arguments.json:
        print(json.dumps({"mesh": arguments.mesh, "usable": True, **facts}))
    else:
        print(printable(arguments.mesh))
        print("\n".join(_lines(facts)))
    return 0


def describe(mesh: TriangleMesh) -> dict[str, Any]:
    """Return the counts, topology and sizes of a mesh; lengths are in the file's unit."""
    lengths = abfm.calculus.edge_lengths(mesh)
    return {
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "edges": len(mesh.edges),
        "genus": mesh.genus,
        "boundary_loops": mesh.boundary_loop_count,
        "area": mesh.length_scale**2,
        "length_scale": mesh.length_scale,
        "bounding_box": [mesh.vertices.min(axis=0).tolist(), mesh.vertices.max(axis=0).tolist()],
        "edge_lengths": {
            "shortest": lengths.min(),
            "median": float(np.median(lengths)),
            "longest": lengths.max(),
        },
        "edge_ratio": lengths.max() / lengths.min(),
        "symmetries": _symmetries(mesh),
        "messages": list(mesh.messages),
    }


def _symmetries(mesh: TriangleMesh) -> dict[str, dict[str, Any] | None]:
    """Return what `permuted:mirror(...)` and `permuted:rotation(...)` would compose with, as far as
    the mesh has it.
    """
    found: dict[str, dict[str, Any] | None] = {}
    for kind in KINDS:
        try:
            symmetry = detect_symmetry(mesh, kind)
        except SymmetryError:
            found[kind] = None
        else:
            of_map = {"error": symmetry.error, "is_permutation": symmetry.is_permutation}
            found[kind] = {"axis": symmetry.axis.tolist(), **of_map}
    return found


def _symmetry_words(kind: str, symmetry: dict[str, Any] | None) -> str:
    if symmetry is None:
        return "none found"
    across = "with normal" if kind == "mirror" else "by 180 degrees about"
    axis = " ".join(f"{value:.3g}" for value in np.round(symmetry["axis"], 3) + 0.0)
    carried = "vertices to vertices" if symmetry["is_permutation"] else "vertices between vertices"
    return f"{across} {axis}, {carried}, at most {symmetry['error']:.1g} length scales off"


def _lines(facts: dict[str, Any]) -> list[str]:
    box = [" ".join(f"{value:.4g}" for value in corner) for corner in facts["bounding_box"]]
    lengths = facts["edge_lengths"]
    loops = facts["boundary_loops"]
    rows = {
        "vertices": f"{facts['vertices']:,}",
        "faces": f"{facts['faces']:,}",
        "edges": f"{facts['edges']:,}",
        "genus": facts["genus"],
        "boundary": f"{loops} loop{'s' if loops > 1 else ''}" if loops else "none (closed)",
        "area": f"{facts['area']:.6g}",
        "length scale": f"{facts['length_scale']:.6g}   (square root of the area: the unit of "
        "Gaussian widths)",
        "bounding box": f"{box[0]}  to  {box[1]}",
        "edge lengths": f"{lengths['shortest']:.4g} to {lengths['longest']:.4g}, median "
        f"{lengths['median']:.4g}",
        "edge ratio": f"{facts['edge_ratio']:.4g}   (longest to shortest)",
        **{kind: _symmetry_words(kind, symmetry) for kind, symmetry in facts["symmetries"].items()},
    }
    lines = [f"  {name:<14}{value}" for name, value in rows.items()]
    return (
        lines
        + [f"  note: {message}" for message in facts["messages"]]
        + ["  the solver has no objection"]
    )
