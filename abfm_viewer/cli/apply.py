"""`abfm apply`: transfer of data, labels, points and textures by a registration."""

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

import abfm
from abfm import Correspondence, FunctionError, Registration, ResultError, TriangleMesh
from abfm.errors import printable
from abfm.functions import read_values
from abfm.functions.labels import read_label_columns
from abfm.functions.value_files import file_errors
from abfm.io import textured_files, write_labels, write_values
from abfm.maps import SurfacePoints, project_onto_surface
from abfm.reading import NO_LABEL, Columns, Labels
from abfm_viewer import pictures
from abfm_viewer.cli.exit_status import UsageError, print_note
from abfm_viewer.cli.options import adder, load_result, texels
from abfm_viewer.cli.progress import task_progress
from abfm_viewer.files import outputs

SUMMARY = "transfer data, labels, points or textures between the surfaces of a registration"
DESCRIPTION = """\
Transfer data on surface A of a registration to surface B, or with --inverse from B to A.

Examples:
  abfm apply reg.npz --data lh.thickness --out thickness.shape.gii
  abfm apply reg.npz --labels lh.aparc.annot --out aparc.label.gii
  abfm apply reg.npz --points electrodes.csv --out on_b.csv
  abfm apply reg.npz --inverse --labels atlas.label.gii --out in_subject.annot
  abfm apply reg.npz --texture a.obj --out b.obj
  abfm apply reg.npz --inverse --texture b.glb --size 4096 --out a.glb
"""
DETAILS = """\
Data:
  One or more columns of values. By area (default), a vertex of a coarser surface gets the mean of
  the values around it; by point, the value at the corresponding point.
Labels:
  Labels are not averaged: each vertex gets the label with the largest weight.
Points:
  Vertex numbers, counted from 0, one per line; or x, y, z, which are projected onto the surface.
  The output has x, y, z on the other surface.
Textures:
  The images or vertex colours of a mesh file of this surface, whose vertices may be repeated,
  reordered or moved. The output is the other surface with a new image. An .obj is written with an
  .mtl and a .png of the same name.
Vertices without faces get NaN, and as labels "???" in GIFTI and -1 in other files.
"""
MAIN_OPTIONS = (
    "data",
    "labels",
    "points",
    "texture",
    "inverse",
    "by",
    "column",
    "one-based",
    "hemisphere",
    "size",
)


_LABEL_KEY_MAX = 2**31 - 1
# distances of points from a surface, in sqrt(area)
_DISTANCE_NOTED = 1e-6  # larger distances are not rounding errors
_DISTANCE_MAX = 1.0  # larger distances are errors


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add = adder(parser)
    add("registration", "result of `abfm register` or `abfm symmetric`", "REG.npz")
    data = parser.add_argument_group("data to transfer (give one)")
    choose = adder(data.add_mutually_exclusive_group(required=True))
    choose("--data", "values per vertex: a table, array, GIFTI, CIFTI, ...", "FILE")
    choose("--labels", "labels: .label.gii, .annot, .dlabel.nii, or a table of integers", "FILE")
    choose("--points", "table of vertex numbers, counted from 0, or of x, y, z", "FILE")
    choose("--texture", "mesh with a texture or colours: .obj, .glb, .gltf, .ply", "FILE")
    add = adder(parser.add_argument_group("data and labels"))
    about = "interpolation: by area or at points (default: area)"
    add("--by", about, "{area,point}", choices=("area", "point"))
    add("--column", "column of --labels: its name, or its number counted from 0", "NAME")
    add("--hemisphere", "hemisphere of files with both (CIFTI)", choices=("L", "R"))
    add = adder(parser.add_argument_group("points and textures"))
    add("--one-based", "count the vertices of --points from 1 instead of 0")
    add("--image", "image of the texture, instead of the one that the mesh file names", "FILE")
    about = "pixels along a side of the new image (default: 2048, or 4096 for many faces)"
    add("--size", about, "N", type=texels)
    add = adder(parser.add_argument_group("output"))
    add("--inverse", "transfer from B to A")
    what = "output file: .shape.gii, .annot, .csv, .obj, .glb, ..."
    add("--out", what, "FILE", type=Path, required=True)


def run(arguments: argparse.Namespace) -> int:
    out = arguments.out
    outputs.check_folder(out)
    outputs.check_not_read(out, (arguments.data, arguments.labels, arguments.points))
    if arguments.texture:
        _check_textured(arguments)
    elif arguments.image or arguments.size:
        raise UsageError("--image and --size need --texture")
    if arguments.by and not (arguments.data or arguments.labels):
        raise UsageError("--by needs --data or --labels; remove it")
    if arguments.column is not None and not arguments.labels:
        raise UsageError("--column needs --labels; all columns of --data are transferred")
    by: Literal["area", "point"] = arguments.by or "area"
    side = arguments.hemisphere or ""
    loaded = load_result(arguments.registration, Registration, Correspondence)
    correspondence = loaded.inverse() if arguments.inverse else loaded
    if arguments.data:
        data = partial(read_values, arguments.data, hemisphere=side)
        columns = _read_on(correspondence, data)
        transferred = correspondence.b.on_file(correspondence.transfer(columns.table(), by))
        write_values(out, transferred, correspondence.b.structure, columns.names, columns.times)
    elif arguments.labels:
        labels = _labels(correspondence, arguments.labels, arguments.column, side)
        b, keys = correspondence.b, correspondence.transfer_labels(labels.values, by)
        moved = Labels(b.on_file(keys, NO_LABEL), labels.names, labels.colors)
        write_labels(out, moved, b.structure)
    elif arguments.points:
        places = _points(correspondence, arguments.points, int(arguments.one_based))
        write_values(out, places, names=("x", "y", "z"))
    else:
        with task_progress(quiet=not sys.stderr.isatty()):
            given = arguments.texture, correspondence.a, arguments.image
            texture, alpha_mode = pictures.read_texture(*given)
            found = abfm.registration.transfer_texture(correspondence, texture, arguments.size)
            pictures.write_texture(out, found, alpha_mode)
        out = ", ".join(map(str, textured_files(out)))
    print(f"wrote {printable(out)}")
    return 0


def _check_textured(arguments: argparse.Namespace) -> None:
    """Refuse output files that cannot be written, and inputs that belong to another surface."""
    for path in textured_files(arguments.out):
        outputs.check_folder(path)
        outputs.check_not_read(path, (arguments.texture, arguments.image))
        if path.exists() and not arguments.out.exists():
            raise ResultError(
                f"cannot write {path}: it exists, but {arguments.out.name} does not. It may belong "
                "to another surface; choose another name"
            )


def _read_on(correspondence: Correspondence, read: Callable[[TriangleMesh], Columns]) -> Columns:
    """Read columns of values on surface A of a correspondence, and print the reader's notes."""
    try:
        found = read(correspondence.a)
    except FunctionError as error:
        if not _fits(correspondence.b, read):
            raise
        raise FunctionError(
            f"{error}; the values fit the other surface: add or remove --inverse"
        ) from None
    for note in found.notes:
        print_note(note)
    return found


def _fits(mesh: TriangleMesh, read: Callable[[TriangleMesh], Columns]) -> bool:
    try:
        read(mesh)
    except FunctionError:
        return False
    return True


def _labels(correspondence: Correspondence, path: str, column: str | None, side: str) -> Labels:
    columns = _read_on(
        correspondence, partial(read_label_columns, path, column=column, hemisphere=side)
    )
    try:
        with file_errors(path):
            labels = columns.labels(column)
    except FunctionError as error:
        raise FunctionError(str(error).replace("column=", "--column ")) from None
    if np.abs(labels.values).max() > _LABEL_KEY_MAX:
        raise FunctionError(f"{path}: a label key exceeds {_LABEL_KEY_MAX}; use smaller keys")
    return labels


def _points(correspondence: Correspondence, path: str, first: int) -> np.ndarray:
    table = read_values(path).table()
    if table.shape[1] == 3:
        return correspondence.transfer_points(_on_surface(correspondence.a, table, path)).positions
    if table.shape[1] != 1:
        raise FunctionError(
            f"{path} has {table.shape[1]} columns; expected 1 (vertex) or 3 (x, y, z)"
        )
    place = correspondence.a.local_vertices(table[:, 0] - first)
    wrong = np.flatnonzero(place < 0)
    if len(wrong):
        raise FunctionError(
            f"{path}: line {wrong[0] + 1} has {table[wrong[0], 0]:g}, which is not a vertex of any "
            "face"
        )
    return correspondence.transfer_points(place).positions


def _on_surface(mesh: TriangleMesh, places: np.ndarray, path: str) -> SurfacePoints:
    """Project points in space onto a surface, and print the largest distance."""
    found = project_onto_surface(mesh, places)
    gaps = found.distances_from(places)
    row, gap = int(gaps.argmax()) + 1, gaps.max()
    offset = f"{gap:.3g} from the surface, {gap / mesh.length_scale:.2g} sqrt(area)"
    if gap > _DISTANCE_MAX * mesh.length_scale:
        raise FunctionError(
            f"{path}: point {row} is {offset}; expected points near it, in its unit of length"
        )
    if gap > _DISTANCE_NOTED * mesh.length_scale:
        print_note(f"points are projected onto the surface; the farthest, point {row}, is {offset}")
    return found
