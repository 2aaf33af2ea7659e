"""Kinds of files (mesh, frames, document, table), recognised by name and, if needed, contents."""

import re
from contextlib import suppress
from enum import StrEnum
from pathlib import Path

import abfm
from abfm import ResultError
from abfm.mesh.files import MESH_ENDINGS
from abfm.reading import FREESURFER_SURFACES, read_gifti
from abfm_viewer.files.result_tables import place_of

MESHES = (*MESH_ENDINGS, *FREESURFER_SURFACES)
PROJECT = ".abfm"
RESULT = ".npz"
"""Endings of file names: of meshes (`MESHES`), projects (`PROJECT`) and results."""
FRAME_ENDINGS = (
    *(".npy", ".mat", ".csv", ".tsv", ".txt", ".1d", ".mgh", ".mgz", ".stc", ".pvd", ".series"),
    *(".func.gii", ".func.gii.gz", ".dtseries.nii", ".dscalar.nii"),
)
"""Endings of files that always contain frames."""
# VTK files with a number are frames, those without a number are meshes
_NUMBERED_NAME = re.compile(r"[0-9]\.vt[kup]$")
_POINTS = "NIFTI_INTENT_POINTSET"


def is_named_as_frames(path: Path) -> bool:
    name = path.name.lower()
    return name.endswith(FRAME_ENDINGS) or _NUMBERED_NAME.search(name) is not None


class Contents(StrEnum):
    MESH = "mesh"
    FRAMES = "frames"
    DOCUMENT = "document"
    TABLE = "table"
    UNKNOWN = "unknown"


def contents_of(path: Path) -> Contents:
    """Return the kind of a file or folder; a damaged file is judged by its name alone."""
    name = path.name.lower()
    if place_of(path) is not None:
        return Contents.TABLE
    if is_named_as_frames(path):
        return Contents.FRAMES
    if name.endswith(PROJECT):
        return Contents.DOCUMENT
    if name.endswith(RESULT):
        return _contents_of_arrays(path)
    if name.endswith((".gii", ".gii.gz")) and _has_no_surface(path):
        return Contents.FRAMES
    return Contents.MESH if name.endswith(MESHES) else Contents.UNKNOWN


def _contents_of_arrays(path: Path) -> Contents:
    with suppress(ResultError):
        task = abfm.loading.task_of_file(path)
        if task is None:
            return Contents.FRAMES
        return Contents.TABLE if task.result is abfm.Population else Contents.DOCUMENT
    return Contents.DOCUMENT  # reading it will report the damage


def _has_no_surface(path: Path) -> bool:
    """Return whether a GIFTI file can be read and has no surface, and so contains frames."""
    try:
        return all(each.intent != _POINTS for each in read_gifti(path).arrays)
    except (OSError, ValueError):  # reported when the file is read as a mesh
        return False
