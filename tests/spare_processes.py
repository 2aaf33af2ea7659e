"""Processes that go from one worker to the next: starting one takes longer than most of what tests
ask of it, and is no subject of theirs.
"""

from contextlib import contextmanager

import pytest

from abfm.workers import worker
from abfm.workers.worker import Worker, no_state


@contextmanager
def spared():
    """Have a process without a state that is idle when it is closed serve the next one that is
    wanted; who waits for an answer, or asks for a state, gets what there is without.
    """
    begin, close, spare = worker._Connection, Worker.close, []

    def begun(make_state, message, environment):
        for wanted, connection in spare:
            if (make_state, environment) == wanted and not connection.process.has_ended:
                spare.remove((wanted, connection))
                connection._ended_message = message
                return connection
        return begin(make_state, message, environment)

    def closed(self):
        with self._lock:
            connection, self._closed = self._connection, True
            if self._make_state is no_state and connection is not None and not connection._calls:
                spare.append(((self._make_state, self._environment), connection))
                self._connection = None
        close(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, "_Connection", begun)
        patch.setattr(Worker, "close", closed)
        yield
    for _, connection in spare:
        connection.process.close()
