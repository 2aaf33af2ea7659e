"""Record of which documents of a session are saved, and in which files."""

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

from abfm_viewer.document.document import Document, Identity
from abfm_viewer.files.project import Origin
from abfm_viewer.session.editor import Editor


class Saves:
    """Records the saved state and project file of each document, and which documents are unsaved.

    A document has many states, one for each step of undo. When one of them is saved, the others no
    longer count as unsaved.
    """

    def __init__(self, editor: Editor) -> None:
        self._editor = editor
        self._saved: dict[Identity, tuple[Document | None, Origin | None]] = {}
        self._unsaved: dict[Identity, Document] = {}  # replaced, or with a new result
        self._exported: dict[type[Document], Document] = {}
        self.record(editor.document, None)

    @property
    def path(self) -> Path | None:
        origin = self.origin(self._editor.document)
        return origin.path if origin else None

    @property
    def title(self) -> str:
        """Name of the project file or, without one, the document; a star marks unsaved changes."""
        name = self.path.name if self.path else self._editor.document.name
        return f"{'* ' if self.unsaved else ''}{name}"

    @property
    def unsaved(self) -> bool:
        return self._differs(self._editor.document)

    @property
    def unsaved_documents(self) -> tuple[Document, ...]:
        """Documents that would be lost if the session ended now."""
        document, differs = self._editor.document, self.unsaved
        found = [document] if differs else []
        for identity, other in self._unsaved.items():
            is_elsewhere = identity is not document.identity
            has_other_result = other.result is not None and other.result is not document.result
            if self._differs(other) and (is_elsewhere or (has_other_result and not differs)):
                found.append(other)
        return tuple(found)

    def has_new_result(self, document: Document) -> bool:
        """Return whether a match is in no file; another step of a saved match is not new."""
        saved, _ = self._of(document)
        files = (saved, self._exported.get(type(document)))
        in_files = [file.match for file in files if file is not None]
        found = document.match
        return found is not None and not any(one and found.path is one.path for one in in_files)

    def record_export(self, document: Document) -> None:
        """Record that a result file contains the result of a document.

        Only the latest document of each kind is recorded.
        """
        if not document.is_outdated:  # otherwise the file belongs to other inputs
            self._exported[type(document)] = document

    def unsaved_text(self, document: Document) -> str:
        return document.unsaved_text(self.changes(document), self.has_new_result(document))

    def changes(self, document: Document) -> tuple[str, ...]:
        """Return the names of the fields of a document whose present values are in no file."""
        saved, exported = self._of(document)[0], self._exported.get(type(document))
        if exported is None or exported.result is not document.result:
            exported = None
        # a recovered document: compare the other fields with empty ones
        elif saved is None and document.exported_fields:
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
        """Return the project file of a document as last read or written; None without a file."""
        return self._of(document)[1]

    def unsaved_state(self, document: Document) -> Document | None:
        """Return the latest state of a document that has to be saved; None if it has none."""
        return self._unsaved.get(document.identity)

    def record(
        self,
        document: Document,
        origin: Origin | None,
        settles: Document | None = None,
        saved: bool = True,
    ) -> None:
        """Record the project file of a document (None without one), and whether it is saved.

        If ``saved`` is false, all fields of the document count as changed. ``settles`` is the
        `unsaved_state` when writing began; it is dropped, unless a newer one has replaced it.
        """
        self._saved[document.identity] = document if saved else None, origin
        if saved and self._unsaved.get(document.identity) is settles:
            self._unsaved.pop(document.identity, None)

    def leave(self, document: Document) -> None:
        before = self.unsaved_state(document)
        result_undone = before is not None and before.result is not None and document.result is None
        if self._differs(document) and not result_undone:
            self.add_unsaved(document)

    def add_unsaved(self, document: Document) -> None:
        self._unsaved[document.identity] = document

    def forget_all_but(self, identities: Collection[Identity]) -> None:
        """Drop the records of documents that are neither in ``identities`` nor unsaved."""
        for identity in self._saved.keys() - self._unsaved.keys() - set(identities):
            del self._saved[identity]

    def reset(self) -> None:
        origin = self.origin(self._editor.document)
        self._saved, self._unsaved = {}, {}
        self.record(self._editor.document, origin)

    def _differs(self, document: Document) -> bool:
        return self.changes(document) != ()

    def _of(self, document: Document) -> tuple[Document | None, Origin | None]:
        return self._saved.get(document.identity, (None, None))
