"""Computes functions where they do not stop the window.

The solvers behind geodesics and eigenfunctions keep the interpreter to themselves: seventeen seconds at 160,000
vertices. On large meshes they therefore run in a process of their own, ``python -m abfm_viewer.evaluator``, which gets
the mesh once, and then answers requests in turn. Both ends are ours: they speak pickle through pipes.
"""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
import threading
from typing import IO, Any

import numpy as np

from abfm import AbfmError, FunctionError, TriangleMesh
from abfm.mesh import FloatArray

OWN_PROCESS_FROM = 20_000
"""Vertices: below, computing is quick, and starting a process is not."""


class Evaluator:
    """Functions of one mesh; safe to call from several threads, one at a time.

    Parameters
    ----------
    mesh : TriangleMesh
    own_process : bool, optional
        By default from `OWN_PROCESS_FROM` vertices on.
    """

    def __init__(self, mesh: TriangleMesh, own_process: bool | None = None) -> None:
        self._mesh = mesh
        self._apart = len(mesh.vertices) >= OWN_PROCESS_FROM if own_process is None else own_process
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self._closed = False

    def values(self, spec: str) -> FloatArray:
        """Values (V,) of a function.

        Raises
        ------
        FunctionError
            As `abfm.function` does, or if the process that computes was ended from outside.
        """
        return np.asarray(self._answer("values", spec))

    def defaults(self) -> tuple[str, str]:
        """Specs of a default source and target."""
        source, target = self._answer("defaults", "")
        return source, target

    def close(self) -> None:
        """End the process."""
        self._closed = True
        if self._process is not None:
            self._process.kill()

    def _answer(self, request: str, spec: str) -> Any:
        if not self._apart:
            return _compute(self._mesh, request, spec)
        with self._lock:
            try:
                process = self._process or self._start()
                assert process.stdin is not None
                assert process.stdout is not None
                _send(process.stdin, (request, spec))
                answer, value = pickle.load(process.stdout)
            except (OSError, EOFError, pickle.UnpicklingError) as error:
                self._process = None
                raise FunctionError("the process that computes functions has ended; try again") from error
        if answer == "error":
            raise FunctionError(value)
        if answer == "memory":
            raise MemoryError(value)
        return value

    def _start(self) -> subprocess.Popen[bytes]:
        if self._closed:
            raise OSError("closed")
        command = [sys.executable, "-m", "abfm_viewer.evaluator"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self._process.stdin is not None
        bare = copy.copy(self._mesh)
        bare.__dict__["cache"] = {}
        _send(self._process.stdin, bare)
        return self._process


def _compute(mesh: TriangleMesh, request: str, spec: str) -> Any:
    if request == "defaults":
        from abfm_viewer.defaults import default_functions

        return default_functions(mesh)
    from abfm.functions import function

    return function(mesh, spec)


def _send(pipe: IO[bytes], message: object) -> None:
    pickle.dump(message, pipe, protocol=5)
    pipe.flush()


def _serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Answer until there are no more requests."""
    mesh = pickle.load(requests)
    while True:
        try:
            request, spec = pickle.load(requests)
        except EOFError:
            return
        try:
            answer: tuple[str, Any] = ("value", _compute(mesh, request, spec))
        except MemoryError as error:
            answer = ("memory", str(error))
        except AbfmError as error:
            answer = ("error", str(error))
        except Exception as error:
            answer = ("error", f"{type(error).__name__}: {error}")
        _send(answers, answer)


if __name__ == "__main__":
    import os
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the app's business; it closes the pipe
    _own = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not mix with the answers
    _serve(sys.stdin.buffer, _own)
