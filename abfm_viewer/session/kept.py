"""What of a session is in files, and what would be lost if it ended now."""

from __future__ import annotations

from collections.abc import Collection

from abfm import TriangleMesh
from abfm_viewer.document.document import Document
from abfm_viewer.files.origin import Origin

_KEPT = ("channels", "parameters", "mask", "lines", "points")
"""What besides the result would be lost; the view and the time do not count."""


class Kept:
    """Of each mesh that the history holds: the state that need not be saved, its project file, and what was left.

    Saving one state of a mesh settles its others: who saves has chosen among them.
    """

    def __init__(self, document: Document) -> None:
        self._states: dict[TriangleMesh, tuple[Document | None, Origin | None]] = {document.mesh: (document, None)}
        self._left: dict[TriangleMesh, Document] = {}

    def origin(self, mesh: TriangleMesh) -> Origin | None:
        """The project file that Save writes for a mesh; None before there is one."""
        return self._states[mesh][1] if mesh in self._states else None

    def recover(self, mesh: TriangleMesh, origin: Origin | None) -> None:
        """All of a mesh need be saved, in its project file if it has one."""
        self._states[mesh] = None, origin

    def keep(self, document: Document, origin: Origin | None, settles: Document | None = None) -> None:
        """Nothing of a document need be saved, nor what was `left` of its mesh when that was written."""
        self._states[document.mesh] = document, origin
        if self._left.get(document.mesh) is settles:
            self._left.pop(document.mesh, None)

    def left(self, mesh: TriangleMesh) -> Document | None:
        """The unsaved state in which a mesh was left, or its latest unsaved result was found."""
        return self._left.get(mesh)

    def found(self, document: Document) -> None:
        """A result was found that is in no file."""
        self._left[document.mesh] = document

    def forget_all_but(self, meshes: Collection[TriangleMesh]) -> None:
        """Forget the files of meshes that the history holds no more, unless something of them is unsaved."""
        self._states = {mesh: state for mesh, state in self._states.items() if mesh in meshes or mesh in self._left}

    def leave(self, document: Document) -> None:
        """Another mesh takes a document's place."""
        before = self._left.get(document.mesh)
        taken_back = before is not None and before.result is not None and document.result is None
        if self.differs(document) and not taken_back:
            self._left[document.mesh] = document

    def differs(self, document: Document) -> bool:
        """Whether something of a document is in no file."""
        if (state := self._state(document.mesh)) is None:
            return True
        changed = any(getattr(document, name) != getattr(state, name) for name in _KEPT)
        return changed or document.result is not state.result

    def has_new_result(self, document: Document) -> bool:
        """Whether a document has a result that is in no file."""
        state = self._state(document.mesh)
        return document.result is not None and (state is None or document.result is not state.result)

    def unsaved(self, document: Document) -> tuple[Document, ...]:
        """What would be lost if the session ended with a document: that one first, and those that were left."""
        differs = self.differs(document)
        found = [document] if differs else []
        for mesh, left in self._left.items():
            taken_back = not differs and left.result is not None and left.result is not document.result
            if mesh is not document.mesh or taken_back:
                found.append(left)
        return tuple(found)

    def _state(self, mesh: TriangleMesh) -> Document | None:
        return self._states[mesh][0] if mesh in self._states else None
