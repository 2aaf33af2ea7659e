"""What the process that matches keeps between two runs."""

from __future__ import annotations

import gc
import threading
import weakref
from collections.abc import Iterator
from dataclasses import replace
from queue import SimpleQueue
from typing import Any, cast

import pytest

from abfm import MatchingEnergy, Parameters
from abfm.numerics.own_process import Requests
from abfm_viewer.computing import match_process
from tests.core.fields import bump
from tests.shapes import icosphere

SPHERE = icosphere(3)
F, G = (bump(SPHERE, SPHERE.vertices[vertex], 0.4)[:, None] for vertex in (0, 30))
QUICK = Parameters(iterations=8, levels=2)
GIVEN = {"mask": None, "weights": None, "start": None}


class Conversation:
    """Stands in for both ends: requests that are put, answers that come."""

    def __init__(self) -> None:
        self.requests: SimpleQueue[Any] = SimpleQueue()
        self.answers: SimpleQueue[Any] = SimpleQueue()

    def __iter__(self) -> Iterator[Any]:
        while (request := self.requests.get()) is not None:
            yield request

    def answer(self, messages: list[tuple[str, int, Any]]) -> None:
        for message in messages:
            self.answers.put(message)

    def until(self, kind: str) -> Any:
        """The content of the next answer of a kind."""
        while (message := self.answers.get(timeout=60))[0] != kind:
            pass
        return message[2]


@pytest.fixture
def conversation() -> Conversation:
    conversation = Conversation()
    process = match_process._Matching(cast(Requests, conversation))
    threading.Thread(target=process.listen, daemon=True).start()
    conversation.requests.put(("mesh", SPHERE))
    return conversation


@pytest.fixture
def energies(monkeypatch: pytest.MonkeyPatch) -> Iterator[weakref.WeakSet[MatchingEnergy]]:
    """All that are made and not gone, while nothing collects cycles."""
    alive: weakref.WeakSet[MatchingEnergy] = weakref.WeakSet()
    usual = MatchingEnergy.__init__

    def init(self: MatchingEnergy, *arguments: Any, **named: Any) -> None:
        usual(self, *arguments, **named)
        alive.add(self)

    monkeypatch.setattr(MatchingEnergy, "__init__", init)
    gc.collect()
    gc.disable()
    yield alive
    gc.enable()


def settled(conversation: Conversation) -> None:
    """Return when the run before is over and done with: the next one, which fails at once, comes after that."""
    conversation.requests.put(("match", 1000, (F, G, None, "too many"), GIVEN))
    assert isinstance(conversation.until("error"), RuntimeError)


def test_of_a_run_that_ended_the_last_fields_stay_and_no_workspace(
    conversation: Conversation, energies: weakref.WeakSet[MatchingEnergy]
) -> None:
    for number in range(1, 4):
        conversation.requests.put(("match", number, (F, G, replace(QUICK, sigma=0.01 * number)), GIVEN))
        match = dict(zip(match_process.parts(), conversation.until("match"), strict=True))
        conversation.requests.put(("fetch", number, 10**6))
        _, found = conversation.until("fetch")
        assert found[0].shape == match["velocity"].shape
        assert found[1].shape == match["advected"].shape
    conversation.requests.put(("prepare", QUICK))
    settled(conversation)
    assert not energies
