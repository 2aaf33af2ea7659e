"""Computes functions where they do not stop the window.

The solvers behind geodesics and eigenfunctions keep the interpreter to themselves: seventeen seconds at 160,000
vertices. On large meshes they therefore run in a process of their own, which gets the mesh once.
"""

import threading
from typing import Any

import numpy as np

import abfm
from abfm import AbfmError, FunctionError, TriangleMesh
from abfm.numerics.own_process import OwnProcess, ProcessEndedError, Requests
from abfm.progress import tell, telling
from abfm.types import FloatArray
from abfm_viewer.document.defaults import default_functions

OWN_PROCESS_FROM = 20_000
"""Vertices: below, computing is quick, and starting a process is not."""


class Evaluator:
    """Functions of one mesh; safe to call from several threads, one at a time."""

    def __init__(self, mesh: TriangleMesh, own_process: bool | None = None) -> None:
        self._mesh = mesh
        self._apart = len(mesh.vertices) >= OWN_PROCESS_FROM if own_process is None else own_process
        self._process: OwnProcess | None = None
        self._lock = threading.Lock()  # of who waits for an answer
        self._starting = threading.Lock()
        self._closed = False

    def values(self, spec: str) -> FloatArray:
        """Values (V,); FunctionError as of `abfm.function`, or if the process that computes was ended from outside."""
        return np.asarray(self._answer(spec))

    def defaults(self) -> tuple[str, str]:
        source, target = self._answer(None)
        return source, target

    def close(self) -> None:
        """End the process at once; who waits for its answer is told."""
        with self._starting:
            self._closed = True
            if self._process is not None:
                self._process.close()

    def _answer(self, spec: str | None) -> Any:
        """What `_compute` says, here or in the other process."""
        if not self._apart:
            return _compute(self._mesh, spec)
        with self._lock:
            try:
                process = self._process or self._start()
                process.send(spec)
                while (received := process.receive())[0] == "step":
                    tell(received[1] and received[1].begun_now())
                answer = received[1]
            except (OSError, ProcessEndedError) as error:
                self._process = None
                raise FunctionError("the process that computes functions has ended; try again") from error
            except BaseException:  # the process ends: its answer would be taken for the next one
                self._process = None
                raise
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _start(self) -> OwnProcess:
        with self._starting:
            if self._closed:
                raise ProcessEndedError
            process = self._process = OwnProcess("abfm_viewer.computing.evaluator")
        process.send(self._mesh)
        return process


def _compute(mesh: TriangleMesh, spec: str | None) -> Any:
    return default_functions(mesh) if spec is None else abfm.functions.function(mesh, spec)


def _serve() -> None:
    requests = Requests()
    queue = iter(requests)
    mesh = next(queue)
    for spec in queue:
        try:
            with telling(lambda step: requests.answer(("step", step))):
                answer = _compute(mesh, spec)
        except MemoryError as error:
            answer = MemoryError(str(error))
        except Exception as error:
            answer = FunctionError(str(error) if isinstance(error, AbfmError) else f"{type(error).__name__}: {error}")
        requests.answer(("answer", answer))


if __name__ == "__main__":
    _serve()
