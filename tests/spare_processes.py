"""Worker processes that several tests share, since starting one takes longer than most tests."""

import atexit
from contextlib import contextmanager

import pytest

from abfm.workers import worker
from abfm.workers.worker import Worker, no_state

_SPARE = []
"""Idle processes of all test modules, as pairs: what they were made for, and the connection."""


@atexit.register
def _end_spare_processes():
    for _, connection in _SPARE:
        connection.process.close()


@contextmanager
def reused_processes():
    """Reuse idle worker processes without a state for later workers.

    A closed worker with running calls or with a state ends its process as usual.
    """
    connect, close = worker._Connection, Worker.close

    def reuse(make_state, message, environment):
        for wanted, connection in _SPARE:
            if (make_state, environment) == wanted and not connection.process.has_ended:
                _SPARE.remove((wanted, connection))
                connection._ended_message = message
                return connection
        return connect(make_state, message, environment)

    def set_aside(self):
        with self._lock:
            connection, self._closed = self._connection, True
            if self._make_state is no_state and connection is not None and not connection._calls:
                _SPARE.append(((self._make_state, self._environment), connection))
                self._connection = None
        close(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, "_Connection", reuse)
        patch.setattr(Worker, "close", set_aside)
        yield
