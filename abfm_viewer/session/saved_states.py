"""Which states of the document are in a file, or need not be."""

from __future__ import annotations

from pathlib import Path

from abfm_viewer.document.document import Document

_COUNTED = ("channels", "parameters", "mask", "lines", "points")


class SavedStates:
    """Remembers them mesh by mesh: undo may come back to another mesh."""

    def __init__(self) -> None:
        self._kept: dict[int, tuple[Document, Path | None]] = {}

    def keep(self, document: Document, path: Path | None) -> None:
        """Remember a state that need not be saved, and the project file it is in, if any."""
        self._kept[id(document.mesh)] = (document, path)

    def path(self, document: Document) -> Path | None:
        """The project file that a document belongs to; None before there is one."""
        return self._kept.get(id(document.mesh), (None, None))[1]

    def unsaved(self, document: Document) -> bool:
        """Whether something would be lost if the document were gone; the view and the time do not count."""
        kept, _ = self._kept.get(id(document.mesh), (None, None))
        if kept is None or document.result is not kept.result:
            return True
        return any(getattr(document, name) != getattr(kept, name) for name in _COUNTED)
