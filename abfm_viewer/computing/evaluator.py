"""Computes functions where they do not stop the window.

The solvers behind geodesics and eigenfunctions keep the interpreter to themselves: seventeen
seconds at 160,000 vertices. On large meshes they therefore run in a process of their own.
"""

import abfm
from abfm import TriangleMesh
from abfm.types import FloatArray
from abfm.workers.worker import Worker, stateless
from abfm_viewer.computing.default_functions import default_functions

OWN_PROCESS_FROM = 20_000
"""Vertices: below, computing is quick, and starting a process is not."""


class Evaluator:
    """Functions of one mesh; safe to call from several threads, one at a time."""

    def __init__(self, mesh: TriangleMesh, own_process: bool | None = None) -> None:
        self._mesh = mesh
        apart = len(mesh.vertices) >= OWN_PROCESS_FROM if own_process is None else own_process
        ended = "the process that computes functions has ended; try again"
        self._worker = Worker(stateless, ended) if apart else None

    def values(self, spec: str) -> FloatArray:
        """Return the values (V,) of a function.

        Raises
        ------
        AbfmError
            As of `abfm.function`, or if the process that computes was ended from outside.
        """
        if self._worker is None:
            return _values(None, self._mesh, spec)
        return self._worker.call(_values, self._mesh, spec).result()

    def defaults(self) -> tuple[str, str]:
        """Return specs of the functions that a mesh begins with."""
        if self._worker is None:
            return default_functions(self._mesh)
        return self._worker.call(_defaults, self._mesh).result()

    @property
    def pid(self) -> int | None:
        """The number of its process; None without one."""
        return self._worker.pid if self._worker else None

    def close(self) -> None:
        """End the process at once; who waits for its answer is told."""
        if self._worker is not None:
            self._worker.close()


def _values(_: None, mesh: TriangleMesh, spec: str) -> FloatArray:
    return abfm.functions.function(mesh, spec)


def _defaults(_: None, mesh: TriangleMesh) -> tuple[str, str]:
    return default_functions(mesh)
