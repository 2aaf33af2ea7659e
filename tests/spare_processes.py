"""Processes that go from one worker to the next: starting one takes longer than most of what tests
ask of it, and is no subject of theirs.
"""

from contextlib import contextmanager

import pytest

from abfm.workers import worker
from abfm.workers.worker import Worker, stateless


@contextmanager
def spared():
    """Have a process without a state that is idle when it is closed serve the next one that is
    wanted; who waits for an answer, or asks for a state, gets what there is without.
    """
    begin, close, spare = worker._Connection, Worker.close, []

    def begun(make, ended, changed):
        for wanted, connection in spare:
            if (make, changed) == wanted and not connection.process.has_ended:
                spare.remove((wanted, connection))
                connection._words = ended
                return connection
        return begin(make, ended, changed)

    def closed(self):
        with self._lock:
            connection, self._closed = self._connection, True
            if self._make is stateless and connection is not None and not connection._calls:
                spare.append(((self._make, self._changed), connection))
                self._connection = None
        close(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, "_Connection", begun)
        patch.setattr(Worker, "close", closed)
        yield
    for _, connection in spare:
        connection.process.close()
