"""What the app tells: a line that goes away by itself, cards that stay, and a log of all of it."""

import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import takewhile
from typing import NamedTuple

from abfm import AbfmError

_SECONDS_OF_NOTICE = 6.0
_SECONDS_OF_ERROR = 12.0
_LONGEST_LOG = 1000
_MOST_CARDS = 50
RUN = "run"
"""What cards about a match are about."""
Remedies = Mapping[str, Callable[[], None]]
"""What can be done about a problem: labels of buttons, and what they do."""


class Notice(NamedTuple):
    text: str
    is_error: bool = False


@dataclass(frozen=True, eq=False)
class Card:
    """A problem that stays in view; all that are `about` the same thing are mended together."""

    text: str
    about: str = ""
    remedies: Remedies = field(default_factory=dict)


class LogEntry(NamedTuple):
    """A line of the log; the time is in seconds since the epoch."""

    time: float
    kind: str
    text: str


class Notices:
    """At most one notice, the `latest`, for as long as it takes to read it; else an empty one.

    Errors are `cards`, too, the latest first; of so many that nobody reads them the oldest go. The
    `log` has everything of late, the oldest first. `moves` counts what the user did so far.
    """

    def __init__(self, moves: Callable[[], int]) -> None:
        self.latest = Notice("")
        self.cards: tuple[Card, ...] = ()
        self.log: deque[LogEntry] = deque(maxlen=_LONGEST_LOG)
        self._moves = moves
        self._said: tuple[float, int] = 0.0, 0  # when, and how many moves there were

    def show(
        self, text: str, is_error: bool = False, about: str = "", remedies: Remedies | None = None
    ) -> None:
        """Tell something, once; an error also as a card with its remedies."""
        text = " ".join(text.split())
        cards = self.cards
        told = {card.text for card in cards} if is_error else {self.latest.text}
        is_known = text in told and (is_error or not self.latest.is_error)
        if text and not is_known:
            self.log.append(LogEntry(time.time(), "error" if is_error else "notice", text))
        if text and is_error:
            new = Card(text, about, remedies or {})
            cards = tuple(new if card.text == text else card for card in cards)
            self.cards = (cards if is_known else (new, *cards))[:_MOST_CARDS]
        self.latest = Notice(text, is_error)
        self._said = time.perf_counter(), self._moves()

    @contextmanager
    def showing_errors(self) -> Iterator[None]:
        """Show an error of the library as a card, and go on after the block."""
        try:
            yield
        except AbfmError as error:
            self.show(str(error), is_error=True)

    def remedies_for(self, card: Card) -> Remedies:
        newer = takewhile(lambda one: one is not card, self.cards)
        taken = [remedy for one in newer for remedy in one.remedies.items()]
        return {label: do for label, do in card.remedies.items() if (label, do) not in taken}

    def dismiss(self, card: Card) -> None:
        """Take a card away, and the notice that says the same."""
        self.cards = tuple(one for one in self.cards if one is not card)
        if self.latest == (card.text, True):
            self.clear()

    def resolve(self, about: str) -> None:
        """Take all cards about something away: it is in order now."""
        for card in self.cards:
            if card.about == about:
                self.dismiss(card)

    def clear(self) -> None:
        self.latest = Notice("")

    def update(self) -> None:
        """Take the notice away when it was there for long, an error's when the user did more."""
        at, moves = self._said
        answered = self.latest.is_error and moves != self._moves()
        longest = _SECONDS_OF_ERROR if self.latest.is_error else _SECONDS_OF_NOTICE
        if answered or time.perf_counter() - at > longest:
            self.clear()
