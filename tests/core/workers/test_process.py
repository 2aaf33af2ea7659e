"""A process of our own, which answers with messages of any length."""

import gc
import os
import pickle
import sys
import threading

import numpy as np
import pytest

from abfm.workers import process
from abfm.workers.process import OwnProcess, ProcessEndedError

ECHO = """
from abfm.workers.process import Requests
requests = Requests()
for message in requests:
    print("what a library prints")
    requests.answer(message)
"""


@pytest.fixture
def echo(tmp_path, monkeypatch):
    (tmp_path / "echo_of_messages.py").write_text(ECHO)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *filter(None, sys.path)]))
    process = OwnProcess("echo_of_messages")
    yield process
    process.close()


@pytest.mark.parametrize("count", [0, 1, 3_000_000])
def test_messages_longer_than_a_pipe_come_back_as_they_were(echo, count):
    sent = np.arange(count, dtype=np.float64)
    sending = threading.Thread(target=echo.send, args=(("numbers", sent),))
    sending.start()
    kind, received = echo.receive()
    sending.join()
    assert kind == "numbers"
    np.testing.assert_array_equal(received, sent)
    received += 1  # as its own


def test_a_process_that_is_closed_ends_who_waits_for_it(echo):
    echo.send("first")
    assert echo.receive() == "first"
    closing = threading.Timer(0.2, echo.close)
    closing.start()
    with pytest.raises(ProcessEndedError):
        echo.receive()
    closing.join()
    assert echo.has_ended
    with pytest.raises(ProcessEndedError):
        echo.send("anything")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("closed", [True, False])
def test_nothing_of_it_stays_open(closed, monkeypatch):
    told = []
    monkeypatch.setattr(sys, "unraisablehook", told.append)
    process = OwnProcess("abfm.workers")
    if closed:
        process.close()
    del process
    gc.collect()
    assert not told


@pytest.mark.parametrize("at_once", [1, 3, 10_000])
def test_a_message_may_come_in_pieces_and_is_refused_when_its_end_is_missing(at_once):
    content = pickle.dumps(list(range(100)))
    whole = len(content).to_bytes(8) + content

    def reading(given: bytes):
        rest = bytearray(given)

        def read(buffer: memoryview) -> int:
            count = min(len(buffer), len(rest), at_once)
            buffer[:count] = rest[:count]
            del rest[:count]
            return count

        return read

    assert process._receive(reading(whole)) == list(range(100))
    with pytest.raises(EOFError):
        process._receive(reading(whole[:-1]))
