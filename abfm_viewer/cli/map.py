"""`abfm map`: the map of the flow of a match, or of a registration."""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from abfm import Correspondence, FunctionError, Match, ParameterError
from abfm.errors import printable
from abfm.functions import read_values, vertex_map
from abfm.io import write_values
from abfm.maps.point_maps import PointMap
from abfm.maps.quality import ERROR_BOUNDS, MapAccuracy, map_accuracy, quality_table
from abfm.registration import report
from abfm.registration.initial import Landmarks, map_from_file
from abfm.registration.task import vertex_numbers
from abfm.types import IntArray
from abfm_viewer.cli.exit_status import UsageError, print_note
from abfm_viewer.cli.options import adder, load_result
from abfm_viewer.files import outputs

SUMMARY = "write the vertex map of a match or a registration, and measure its errors"
DESCRIPTION = """\
Write the map of the flow of a match, and report how it changes areas and shapes and how many faces
it folds. For a registration, write the map between both surfaces.

Examples:
  abfm map match.npz --out map.txt
  abfm map match.npz --truth rotation
  abfm map match.npz --push uv.npy --out pushed.npy
  abfm map match.npz --functional-map 50 --out C.npy
  abfm map reg.npz --truth true_vertices.txt
"""
DETAILS = """\
The map of a match is that of the flow lines that verify it. The file has, for each vertex, the
vertex from which its value comes, or with --inverse the vertex to which its value moves. The option
--truth and functions such as permuted:map.txt(coordinate:x) read such a file. The report has the
change of areas (J) and shapes (R) of faces, the number of folded faces, and the round-trip error of
vertices.
A warning appears if too many faces are folded to trust the map.

The map of a registration has, for each vertex of B, the nearest vertex of A. The report has the
share of A that the map covers.
"""
_TABLES = (".txt", ".csv", ".npy")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    add("input", "result of `abfm match` or `abfm register`", "RESULT.npz")
    add("--out", "output table: .txt, .csv or .npy", "FILE", type=Path)
    add("--time", "time of the flow (default: tau); negative for its inverse", "T", type=float)
    add("--inverse", "use the inverse map")
    choose = adder(parser.add_mutually_exclusive_group())
    what = "push values along the flow, one row per vertex: texture coordinates, colours, ..."
    choose("--push", what, "FILE")
    what = "write the matrix of the flow in the first K eigenfunctions"
    choose("--functional-map", what, "K", type=int)
    what = (
        "measure geodesic errors against a map: a file of vertex numbers, identity, or a symmetry "
        "of the mesh (mirror, rotation)"
    )
    add("--truth", what, "MAP")
    add("--json", "print the report as one JSON object")


def run(arguments: argparse.Namespace) -> int:
    out, truth = arguments.out, arguments.truth
    if out is not None:
        outputs.check(out, _TABLES)
        outputs.check_not_read(out, (arguments.push, truth))
    elif arguments.push or arguments.functional_map is not None:
        raise UsageError("--push and --functional-map need --out, the table to write")
    match = load_result(arguments.input, Match, Correspondence)
    if isinstance(match, Correspondence):
        return _of_two_surfaces(arguments, match)
    time = match.parameters.tau if arguments.time is None else arguments.time
    points, quality = match.point_map(time, arguments.inverse), match.flow.map_quality(time)
    accuracy = None
    if truth:
        accuracy = map_accuracy(
            points, None if truth == "identity" else vertex_map(match.mesh, truth)
        )
    if out is not None:
        write_values(out, _table(arguments, match, points, time))
    if quality.warning:
        print_note(quality.warning, "warning")
    facts = {
        **report.distortion_details(quality.distortion),
        "round_trip": quality.round_trip._asdict(),
        "warning": quality.warning,
        "report": quality.report(),
    }
    lines = quality_table(quality.distortion, quality.round_trip, accuracy)
    return _report(arguments, {"time": time, "quality": facts}, lines, accuracy)


def _report(
    arguments: argparse.Namespace,
    facts: dict[str, Any],
    lines: list[str],
    accuracy: MapAccuracy | None,
) -> int:
    out = arguments.out
    if accuracy is not None:
        bounds = {f"{bound:g}": float(accuracy.share_under(bound)) for bound in ERROR_BOUNDS}
        facts["accuracy"] = {
            "vertices": len(accuracy.vertices),
            **{name: getattr(accuracy, name) for name in ("mean", "median", "maximum")},
            "share_under": bounds,
            "report": accuracy.report(),
        }
    if out is not None:
        lines.append(f"wrote {printable(out)}")
    facts["output"] = None if out is None else str(out)
    print(json.dumps(facts) if arguments.json else "\n".join(lines))
    return 0


def _of_two_surfaces(arguments: argparse.Namespace, found: Correspondence) -> int:
    requested = arguments.time, arguments.push, arguments.functional_map
    if any(each is not None for each in requested):
        raise UsageError(
            "--time, --push and --functional-map need a result on one surface; for a registration "
            "use abfm apply"
        )
    accuracy = None
    correspondence = found.inverse() if arguments.inverse else found
    if arguments.truth:
        same = arguments.truth == "identity"
        accuracy = correspondence.accuracy(
            None if same else _true_vertices(correspondence, arguments.truth)
        )
    if arguments.out is not None:
        write_values(arguments.out, vertex_numbers(correspondence.points))
    facts = {"map": report.map_details(correspondence)}
    return _report(arguments, facts, report.map_lines(correspondence, accuracy), accuracy)


def _true_vertices(correspondence: Correspondence, path: str) -> IntArray:
    found = map_from_file(correspondence.a, correspondence.b, path)
    if isinstance(found, Landmarks):
        raise ParameterError(
            f"{path} has pairs of points; expected a vertex of A for each vertex of B"
        )
    return found.nearest_vertices()


def _table(
    arguments: argparse.Namespace, match: Match, points: PointMap, time: float
) -> NDArray[Any]:
    if arguments.functional_map is not None:
        sign = -1 if arguments.inverse else 1
        return match.functional_map(arguments.functional_map, sign * time)
    if arguments.push:
        return _moved_table(points, arguments.push)
    return vertex_numbers(points)


def _moved_table(points: PointMap, path: str) -> NDArray[Any]:
    """Return a file's rows, transferred along the flow; NaN for vertices without faces."""
    rows = read_values(path, points.domain).table()
    if not np.isfinite(rows).all():
        raise FunctionError(
            f"file {path!r}: some values are not finite; --push needs finite values"
        )
    values = points.pull_back(rows)
    if not np.isfinite(values).all():
        raise ParameterError("the transferred values overflow; use a shorter time")
    return points.domain.on_file(values)
