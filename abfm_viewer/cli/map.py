"""`abfm map`: the map that a result's flow makes of the surface, to use, to measure and to carry
things along.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abfm import FunctionError, Match, ParameterError, load_match
from abfm.errors import printable
from abfm.functions.permuted import vertex_map
from abfm.functions.values_file import read_table
from abfm.io import write_atomically
from abfm.maps.accuracy import BOUNDS, MapAccuracy, map_accuracy
from abfm.maps.point_maps import PointMap
from abfm.maps.quality import map_quality
from abfm_viewer.cli.exit_status import UsageError
from abfm_viewer.files import outputs

if TYPE_CHECKING:
    from numpy.typing import NDArray

SUMMARY = "the map that a result's flow makes: as a file, against a known one, for textures"
DESCRIPTION = """\
Write the map of a result's flow: for every vertex the vertex where its value came from. Such a file
works in functions, permuted:map.txt(coordinate:x), and as a --truth. How far the map leaves the
surface, and which share of the faces it folds, is always told, with a warning on stderr where it is
too much to trust the map.

Examples:
  abfm map match.npz --out map.txt
  abfm map match.npz --truth rotation
  abfm map match.npz --carry uv.npy --out carried.npy
  abfm map match.npz --functional-map 50 --out C.npy
"""
_TABLES = (".txt", ".csv", ".npy")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("input", metavar="RESULT.npz", help="what `abfm match` wrote")
    parser.add_argument("--out", type=Path, metavar="FILE", help="a table: .txt, .csv or .npy")
    parser.add_argument(
        "--time",
        type=float,
        metavar="T",
        help="time of the flow (default: tau); below 0 for its inverse",
    )
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--carry",
        metavar="FILE",
        help="write these values, a row per vertex, carried along: texture coordinates, colours",
    )
    what.add_argument(
        "--functional-map",
        type=int,
        metavar="K",
        help="write the flow's matrix in the first K eigenfunctions",
    )
    parser.add_argument(
        "--truth",
        metavar="MAP",
        help="measure geodesic errors against this map: a file of vertex numbers, mirror or "
        "rotation (as found on the "
        "mesh), or identity",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Compute, write and measure."""
    _check_options(arguments)
    match = load_match(arguments.input)
    time = match.parameters.tau if arguments.time is None else arguments.time
    points = match.point_map(time)
    quality = map_quality(points)
    accuracy = _accuracy(points, match, arguments.truth) if arguments.truth else None
    if arguments.out is not None:
        _write(arguments.out, _table(arguments, match, points, time))
    if quality.warning:
        print(f"warning: {quality.warning}", file=sys.stderr)
    if arguments.json:
        told = {
            "off_surface": quality.largest_distance,
            "off_surface_rms": quality.rms_distance,
            "folded": quality.folded,
            "warning": quality.warning,
            "report": quality.report(),
        }
        output = str(arguments.out) if arguments.out else None
        known = {"accuracy": _described(accuracy)} if accuracy else {}
        print(json.dumps({"time": time, "quality": told, **known, "output": output}))
        return 0
    print(quality.report())
    if accuracy:
        print(accuracy.report())
    if arguments.out:
        print(f"wrote {printable(arguments.out)}")
    return 0


def _check_options(arguments: argparse.Namespace) -> None:
    if arguments.out is not None:
        outputs.check(arguments.out, _TABLES)
    elif arguments.carry or arguments.functional_map is not None:
        raise UsageError("--carry and --functional-map need --out, where the table goes")
    elif arguments.truth is None:
        raise UsageError("nothing to do: give --out, --truth or both")


def _accuracy(points: PointMap, match: Match, truth: str) -> MapAccuracy:
    return map_accuracy(points, None if truth == "identity" else vertex_map(match.mesh, truth))


def _described(accuracy: MapAccuracy) -> dict[str, Any]:
    return {
        "vertices": len(accuracy.vertices),
        **{name: getattr(accuracy, name) for name in ("mean", "median", "maximum")},
        "share_under": {f"{bound:g}": float(accuracy.share_under(bound)) for bound in BOUNDS},
        "report": accuracy.report(),
    }


def _table(
    arguments: argparse.Namespace, match: Match, points: PointMap, time: float
) -> NDArray[Any]:
    if arguments.functional_map is not None:
        return match.functional_map(arguments.functional_map, time)
    if arguments.carry:
        return _carried(match, arguments.carry, time)
    return _as_in_file(points)


def _carried(match: Match, path: str, time: float) -> NDArray[Any]:
    """Return a table of one row per vertex, carried along the flow; rows of vertices that no face
    uses stay.
    """
    table = read_table(path)[1]
    try:
        rows = match.mesh.restrict(table)
    except FunctionError as error:
        raise FunctionError(f"file {path!r}: {error}") from None
    if not np.isfinite(rows).all():
        raise FunctionError(
            f"file {path!r}: some values are not finite; only finite ones can be carried"
        )
    values = match.push(rows, time)
    if len(table) == len(values):
        return values
    whole = table.copy()
    whole[match.mesh.vertex_ids] = values
    return whole


def _as_in_file(points: PointMap) -> NDArray[Any]:
    """Return the nearest vertices, counted as the mesh file does; -1 for vertices that no face
    uses.
    """
    mesh = points.domain
    whole = np.full(mesh.file_vertex_count, -1)
    whole[mesh.vertex_ids] = mesh.vertex_ids[points.nearest_vertices()]
    return whole


def _write(path: Path, table: NDArray[Any]) -> None:
    if not np.isfinite(table).all():
        raise ParameterError("the carried values overflow: use a shorter time")
    with write_atomically(path) as temporary:
        if path.suffix == ".npy":
            np.save(temporary, table)
        else:
            form = "%d" if np.issubdtype(table.dtype, np.integer) else "%.17g"
            np.savetxt(temporary, table, fmt=form, delimiter="," if path.suffix == ".csv" else " ")
