"""Previews of files in file dialogs, and pictures of autosaved copies."""

from contextlib import suppress
from functools import partial
from pathlib import Path

from PIL import Image
from rich.filesize import decimal

import abfm
from abfm import AbfmError, TriangleMesh
from abfm.errors import one_line
from abfm.types import FloatArray
from abfm.wording import capital
from abfm_viewer.computing.background import Latest
from abfm_viewer.dialogs.file_dialog import Preview
from abfm_viewer.document.document import SIDES, Document
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.files import contents
from abfm_viewer.files.project import load_project
from abfm_viewer.pictures.thumbnails import View, thumbnail
from abfm_viewer.scene.textures import Textures

_SIZE = 224, 190
_SIZE_OF_PART = 224, 116  # if a file has several pictures
_FILE_BYTES_MAX = 100_000_000
_VIEWS_MAX = 3
_NAME = "preview of a file"


FilePreview = tuple[Image.Image | None, tuple[str, ...]]
"""The picture of a file, if any, and lines of text that describe the file."""


class Previews:
    """The preview of one file at a time, which is computed in the background."""

    def __init__(self, textures: Textures) -> None:
        self._textures = textures
        self._job: Latest[FilePreview] = Latest()

    def find(self, path: Path) -> Preview | None:
        """Return the preview of a file; None for a folder or a file of another kind."""
        is_known = path.name.lower().endswith((*contents.MESHES, contents.PROJECT, contents.RESULT))
        if not is_known or contents.is_named_as_frames(path):
            return None
        found = self._job.request(path, partial(read_preview, path))
        picture, lines = found or (None, (self._job.error or "reading ...",))
        if picture is None:
            return Preview(None, (0, 0), lines)
        return Preview(self._textures.find(_NAME, picture), picture.size, lines)

    @property
    def busy(self) -> bool:
        return self._job.busy

    def close(self) -> None:
        self._job.close()


def read_preview(path: Path) -> FilePreview:
    """Return the preview of a mesh, result or project; without a picture, the reason."""
    try:
        if path.stat().st_size > _FILE_BYTES_MAX:
            return None, (f"no preview of files above {decimal(_FILE_BYTES_MAX)}",)
        views, lines = _views_of(path)
    except (AbfmError, OSError, MemoryError) as error:
        return None, (one_line(str(error), 200),)
    return thumbnail(views, _SIZE if len(views) == 1 else _SIZE_OF_PART), lines


def _views_of(path: Path) -> tuple[list[View], tuple[str, ...]]:
    if path.name.lower().endswith(contents.PROJECT):
        document, _ = load_project(path)
        return views_of_document(document), (document.name, *_sizes(document.surface().mesh))
    if contents.contents_of(path) is not contents.Contents.DOCUMENT:
        mesh = abfm.load_mesh(path)
        return [(mesh, None)], _sizes(mesh)
    task = abfm.loading.task_of_file(path)
    assert task is not None
    mesh, functions = task.file.preview(path)
    views: list[View] = [(mesh, values) for values in functions[:_VIEWS_MAX]]
    return views, (capital(", ".join(task.preview_labels)), *_sizes(mesh))


def views_of_document(document: Document) -> list[View]:
    """Return the source and target of a match, the first frame, or the plain surfaces."""
    if isinstance(document, SequenceDocument):
        return [(document.surface().mesh, document.sequence.frames.values[0, :, 0])]
    if (match := document.match) is not None:
        return [(match.mesh, values[:, 0]) for values in (match.source, match.target)]
    views: list[View] = []
    for side in SIDES:
        mesh = document.surface(side).mesh
        views.append((mesh, _values(mesh, document.active.spec(side) if document.active else "")))
    return views if views[0][1] is not None else views[1:]


def _values(mesh: TriangleMesh, spec: str) -> FloatArray | None:
    with suppress(AbfmError):
        return abfm.function(mesh, spec) if spec else None
    return None


def _sizes(mesh: TriangleMesh) -> tuple[str, str]:
    return f"{len(mesh.vertices):,} vertices", f"{len(mesh.faces):,} faces"
