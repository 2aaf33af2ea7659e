"""Which states of the document are in a file, or need not be."""

from pathlib import Path

from abfm import TriangleMesh
from abfm_viewer.document.document import Document

_NAMES = ("channels", "parameters", "mask", "lines", "points")


class SavedStates:
    """Remembers them mesh by mesh, each with the project file it is in, if any: undo may come back to another mesh."""

    def __init__(self) -> None:
        self._kept: dict[TriangleMesh, tuple[Document, Path | None]] = {}

    def keep(self, document: Document, path: Path | None) -> None:
        """Remember a state that need not be saved, and its file."""
        self._kept[document.mesh] = document, path

    def path(self, document: Document) -> Path | None:
        """The project file that a document belongs to; None before there is one."""
        return self._kept[document.mesh][1] if document.mesh in self._kept else None

    def unsaved(self, document: Document) -> bool:
        """Whether something would be lost if the document were gone; the view and the time do not count."""
        if document.mesh not in self._kept:
            return True
        kept = self._kept[document.mesh][0]
        changed = any(getattr(document, name) != getattr(kept, name) for name in _NAMES)
        return changed or document.result is not kept.result
