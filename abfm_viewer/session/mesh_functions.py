"""The functions of each mesh that a session may return to; only those of meshes at work have a thread and a process."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress

from abfm import AbfmError, TriangleMesh
from abfm.types import FloatArray
from abfm_viewer.computing.evaluation import Functions
from abfm_viewer.files.project_checks import terms_from_files


class MeshFunctions:
    """`Functions` by mesh, all of them `at_once` or not."""

    def __init__(self, at_once: bool = False) -> None:
        self._at_once = at_once
        self._all: dict[TriangleMesh, Functions] = {}

    def of(self, mesh: TriangleMesh) -> Functions:
        """Those of one mesh."""
        if mesh not in self._all:
            self._all[mesh] = Functions(mesh, at_once=self._at_once)
        return self._all[mesh]

    def add(self, mesh: TriangleMesh, known: Mapping[str, FloatArray]) -> None:
        """Begin with a mesh that was opened, of whose functions from files the values (V,) are known."""
        if mesh in self._all:
            self._all[mesh].let_go()
        self._all[mesh] = Functions(mesh, known, self._at_once)

    def keep(self, at_work: Collection[TriangleMesh], in_reach: Collection[TriangleMesh]) -> None:
        """Let go what can be had again: all of a mesh out of reach; of others what was computed but is not shown there.

        What came from files stays as long as its mesh is in reach, as the files may have changed since. Who is still
        evaluating goes on with what there was, and the process ends with that.
        """
        for mesh, functions in list(self._all.items()):
            if mesh in at_work:
                continue
            mesh.cache.clear()  # also of what was still being computed when it was left
            if mesh in in_reach and not functions.has_computed:
                continue
            if mesh in in_reach:
                self._all[mesh] = functions.at_rest(_is_from_file)
            else:
                del self._all[mesh]
            functions.let_go()

    def close(self) -> None:
        """End all threads and processes."""
        for functions in self._all.values():
            functions.retire()


def _is_from_file(term: str) -> bool:
    with suppress(AbfmError):
        return term in terms_from_files(term)
    return False
