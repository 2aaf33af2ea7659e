"""What of a session is in files, and what would be lost if it ended now."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import abfm
from abfm_viewer.document.document import Document, Identity
from abfm_viewer.files.project import Origin
from abfm_viewer.session.editor import Editor

_CONTENT = (
    "channels",
    "parameters",
    "mask",
    "initial",
    "landmarks",
    "landmarks_alone",
    "labels",
    "film",
    "settings",
    "lines",
    "points",
)
"""What besides the result would be lost; the view and the time do not count."""
_FOUND = "result", "sequence"
_IN_SEQUENCES = "film", "settings", "sequence"
"""What files of sequences hold."""


class Saves:
    """The saved state and the project file of each document of the history, and unsaved ones.

    Saving one state of a document settles its others: who saves has chosen among them.
    """

    def __init__(self, editor: Editor) -> None:
        self._editor = editor
        self._saved: dict[Identity, tuple[Document | None, Origin | None]] = {}
        self._left: dict[Identity, Document] = {}
        self._exported: abfm.Match | None = None
        self._exported_film: Document | None = None
        self.mark(editor.document, None)

    @property
    def path(self) -> Path | None:
        origin = self.origin(self._editor.document)
        return origin.path if origin else None

    @property
    def title(self) -> str:
        """Say what is open, with a star where something of it is in no file."""
        name = self.path.name if self.path else self._editor.document.name
        return f"{'* ' if self.unsaved else ''}{name}"

    @property
    def unsaved(self) -> bool:
        return self._differs(self._editor.document)

    @property
    def unsaved_documents(self) -> tuple[Document, ...]:
        """Return what would be lost if the session ended now: the present one, those left."""
        document, differs = self._editor.document, self.unsaved
        found = [document] if differs else []
        for identity, left in self._left.items():
            is_elsewhere = identity is not document.identity
            has_other = left.result is not None and left.result is not document.result
            is_film = left.sequence is not None and left.sequence is not document.sequence
            has_other = has_other or is_film
            is_lost = self._differs(left)
            if is_lost and (is_elsewhere or (has_other and not differs)):
                found.append(left)
        return tuple(found)

    def has_new_result(self, document: Document) -> bool:
        saved, _ = self._of(document)
        result, known = document.result, saved.result if saved else None
        # another step of the same path is no new one
        known_paths = [] if known is None else [known.path]
        if self._exported is not None:
            known_paths.append(self._exported.path)
        return result is not None and not any(result.path is path for path in known_paths)

    def exported(self, result: abfm.Match) -> None:
        """Remember that a result is in a file of its own, the latest such."""
        self._exported = result

    def exported_film(self, document: Document) -> None:
        """Remember that a document's frames, fields and settings are in a file, the latest such."""
        if not document.is_film_outdated:  # else the file has the settings of the fields
            self._exported_film = document

    def changes(self, document: Document) -> tuple[str, ...]:
        """Return which parts of a document are in no file, by their names in it."""
        saved, exported = self._of(document)[0], self._exported_film
        if exported is None or exported.sequence is not document.sequence:
            exported = None
        elif saved is None:  # of another launch: what it has besides
            saved = Document(document.surfaces)

        def is_in(file: Document | None, name: str) -> bool:
            if file is None:
                return False
            mine, other = getattr(document, name), getattr(file, name)
            return mine is other if name in _FOUND else bool(mine == other)

        return tuple(
            name
            for name in (*_CONTENT, *_FOUND)
            if not (is_in(saved, name) or (name in _IN_SEQUENCES and is_in(exported, name)))
        )

    def origin(self, document: Document) -> Origin | None:
        """The project file of a document, as it was when it was last read or written here."""
        return self._of(document)[1]

    def left(self, document: Document) -> Document | None:
        """The unsaved state in which a document was left, or found; `mark` is to be told of it."""
        return self._left.get(document.identity)

    def mark(
        self,
        document: Document,
        origin: Origin | None,
        settles: Document | None = None,
        saved: bool = True,
    ) -> None:
        """Remember a document's file, that it is saved, and what was `left` when it was written.

        All of one that is not `saved` need be, in its project file if it has one.
        """
        self._saved[document.identity] = document if saved else None, origin
        if saved and self._left.get(document.identity) is settles:
            self._left.pop(document.identity, None)

    def leave(self, document: Document) -> None:
        """Remember what is unsaved of a document whose place another one takes."""
        before = self.left(document)
        taken_back = before is not None and before.result is not None and document.result is None
        if self._differs(document) and not taken_back:
            self.found(document)

    def found(self, document: Document) -> None:
        self._left[document.identity] = document

    def forget_all_but(self, identities: Collection[Identity]) -> None:
        """Forget the files of documents that the history holds no more, unless unsaved."""
        for identity in self._saved.keys() - self._left.keys() - set(identities):
            del self._saved[identity]

    def reset(self) -> None:
        origin = self.origin(self._editor.document)
        self._saved, self._left = {}, {}
        self.mark(self._editor.document, origin)

    def _differs(self, document: Document) -> bool:
        return self.changes(document) != ()

    def _of(self, document: Document) -> tuple[Document | None, Origin | None]:
        return self._saved.get(document.identity, (None, None))
