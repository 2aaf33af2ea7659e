"""Messages to the user: a notice that disappears, cards that stay in view, and a log."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import takewhile
from typing import NamedTuple

from abfm import AbfmError

_NOTICE_SECONDS = 6.0
_ERROR_SECONDS = 12.0
_LOG_ENTRIES_MAX = 1000
_CARDS_MAX = 50
RUN = "run"  # topic of cards about a match
Remedies = Mapping[str, Callable[[], None]]
"""Actions that may solve a problem, by the labels of their buttons."""


class Notice(NamedTuple):
    text: str
    is_error: bool = False


@dataclass(frozen=True, eq=False)
class Card:
    """Message about a problem, which stays until it is dismissed or its topic is resolved."""

    text: str
    about: str = ""  # topic; when it is resolved, all its cards are removed
    remedies: Remedies = field(default_factory=dict)


class LogEntry(NamedTuple):
    """Message in the log, with its time in seconds since the epoch."""

    time: float
    kind: str
    text: str


class Notices:
    """The messages of a session: the latest notice, the cards about errors, and the log."""

    def __init__(self, action_count: Callable[[], int]) -> None:
        self.latest = Notice("")  # empty if none is shown; it disappears after some seconds
        self.cards: tuple[Card, ...] = ()  # errors that stay in view, the latest first
        self.log: deque[LogEntry] = deque(maxlen=_LOG_ENTRIES_MAX)  # the oldest first
        self._action_count = action_count
        self._shown: tuple[float, int] = 0.0, 0  # time and count of actions at the latest notice

    def show(
        self, text: str, is_error: bool = False, about: str = "", remedies: Remedies | None = None
    ) -> None:
        """Show a message as a notice and add it to the log; an error is also shown as a card.

        A message that is shown already is not logged again. ``about`` is the topic by which
        `resolve` removes the card. ``remedies`` are actions for its buttons, by their labels.
        """
        text = " ".join(text.split())
        cards = self.cards
        shown = {card.text for card in cards} if is_error else {self.latest.text}
        is_known = text in shown and (is_error or not self.latest.is_error)
        if text and not is_known:
            self.log.append(LogEntry(time.time(), "error" if is_error else "notice", text))
        if text and is_error:
            new = Card(text, about, remedies or {})
            cards = tuple(new if card.text == text else card for card in cards)
            self.cards = (cards if is_known else (new, *cards))[:_CARDS_MAX]
        self.latest = Notice(text, is_error)
        self._shown = time.perf_counter(), self._action_count()

    @contextmanager
    def showing_errors(self) -> Iterator[None]:
        """Show an `AbfmError` that the ``with`` block raises as a card, and continue after it."""
        try:
            yield
        except AbfmError as error:
            self.show(str(error), is_error=True)

    def remedies_for(self, card: Card) -> Remedies:
        """Return the remedies to offer on a card: those that no newer card offers already."""
        newer = takewhile(lambda one: one is not card, self.cards)
        taken = [remedy for one in newer for remedy in one.remedies.items()]
        return {label: do for label, do in card.remedies.items() if (label, do) not in taken}

    def dismiss(self, card: Card) -> None:
        """Remove a card, and the notice if it has the same text."""
        self.cards = tuple(one for one in self.cards if one is not card)
        if self.latest == (card.text, True):
            self.clear()

    def resolve(self, about: str) -> None:
        for card in self.cards:
            if card.about == about:
                self.dismiss(card)

    def clear(self) -> None:
        self.latest = Notice("")

    def update(self) -> None:
        """Remove the current notice after some seconds; an error also after the next change."""
        at, count = self._shown
        has_acted = self.latest.is_error and count != self._action_count()
        seconds = _ERROR_SECONDS if self.latest.is_error else _NOTICE_SECONDS
        if has_acted or time.perf_counter() - at > seconds:
            self.clear()
