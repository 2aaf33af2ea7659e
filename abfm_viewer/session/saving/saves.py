"""What of a session is in files, and what would be lost if it ended now."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from abfm_viewer.document.document import Document, Identity
from abfm_viewer.files.project import Origin
from abfm_viewer.session.editor import Editor


class Saves:
    """The saved state and the project file of each document of the history, and unsaved ones.

    Saving one state of a document settles its others: who saves has chosen among them.
    """

    def __init__(self, editor: Editor) -> None:
        self._editor = editor
        self._saved: dict[Identity, tuple[Document | None, Origin | None]] = {}
        self._left: dict[Identity, Document] = {}
        self._exported: dict[type[Document], Document] = {}
        self.record(editor.document, None)

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
            is_lost = self._differs(left)
            if is_lost and (is_elsewhere or (has_other and not differs)):
                found.append(left)
        return tuple(found)

    def has_new_result(self, document: Document) -> bool:
        """Whether a document's match is in no file; another step of the same path is no new one."""
        saved, _ = self._of(document)
        files = (saved, self._exported.get(type(document)))
        kept = [file.match for file in files if file is not None]
        found = document.match
        return found is not None and not any(one and found.path is one.path for one in kept)

    def record_export(self, document: Document) -> None:
        """Remember that a document's result is in a file of its own, the latest of its kind."""
        if not document.is_outdated:  # else the file is not of the document
            self._exported[type(document)] = document

    def unsaved_text(self, document: Document) -> str:
        """Say what of a document is in no file."""
        return document.unsaved_text(self.changes(document), self.has_new_result(document))

    def changes(self, document: Document) -> tuple[str, ...]:
        """Return which parts of a document are in no file, by their names in it."""
        saved, exported = self._of(document)[0], self._exported.get(type(document))
        if exported is None or exported.result is not document.result:
            exported = None
        elif saved is None and document.exported_fields:  # of another launch: what it has besides
            saved = replace(exported, labels=None, lines=(), points=())

        def is_in(file: Document | None, name: str) -> bool:
            if file is None:
                return False
            mine, other = getattr(document, name), getattr(file, name)
            return mine is other if name == "result" else bool(mine == other)

        return tuple(
            name
            for name in (*document.content_fields, "result")
            if not (
                is_in(saved, name) or (name in document.exported_fields and is_in(exported, name))
            )
        )

    def origin(self, document: Document) -> Origin | None:
        """The project file of a document, as it was when it was last read or written here."""
        return self._of(document)[1]

    def unsaved_state(self, document: Document) -> Document | None:
        """The unsaved state in which a document was left, or found; `mark` is to be told of it."""
        return self._left.get(document.identity)

    def record(
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
        before = self.unsaved_state(document)
        taken_back = before is not None and before.result is not None and document.result is None
        if self._differs(document) and not taken_back:
            self.add_unsaved(document)

    def add_unsaved(self, document: Document) -> None:
        self._left[document.identity] = document

    def forget_all_but(self, identities: Collection[Identity]) -> None:
        """Forget the files of documents that the history holds no more, unless unsaved."""
        for identity in self._saved.keys() - self._left.keys() - set(identities):
            del self._saved[identity]

    def reset(self) -> None:
        origin = self.origin(self._editor.document)
        self._saved, self._left = {}, {}
        self.record(self._editor.document, origin)

    def _differs(self, document: Document) -> bool:
        return self.changes(document) != ()

    def _of(self, document: Document) -> tuple[Document | None, Origin | None]:
        return self._saved.get(document.identity, (None, None))
