"""Which states of the document are in a file, or need not be."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from abfm import TriangleMesh
from abfm_viewer.document.document import Document


@dataclass(frozen=True, eq=False)
class _Kept:
    """A document that is in a file, or that is not worth one, as it was opened."""

    document: Document
    path: Path | None


class SavedStates:
    """Remembers them mesh by mesh: undo may come back to another mesh."""

    def __init__(self) -> None:
        self._kept: dict[TriangleMesh, _Kept] = {}

    def keep(self, document: Document, path: Path | None) -> None:
        """Remember a state that need not be saved, and the project file it is in, if any."""
        self._kept[document.mesh] = _Kept(document, path)

    def path(self, document: Document) -> Path | None:
        """The project file that a document belongs to; None before there is one."""
        kept = self._kept.get(document.mesh)
        return kept.path if kept else None

    def unsaved(self, document: Document) -> bool:
        """Whether something would be lost if the document were gone; the view and the time do not count."""
        kept = self._kept.get(document.mesh)
        if kept is None or document.result is not kept.document.result:
            return True
        names = ("channels", "parameters", "mask", "lines", "points")
        return any(getattr(document, name) != getattr(kept.document, name) for name in names)
