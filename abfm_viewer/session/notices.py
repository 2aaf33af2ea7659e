"""What the app tells: a line that goes away by itself, cards that stay, and a log of all of it."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import takewhile

_SECONDS_OF_NOTICE, _SECONDS_OF_ERROR = 6.0, 12.0
_LONGEST_LOG, _MOST_CARDS = 1000, 50
WaysOut = Mapping[str, Callable[[], None]]
"""What can be done about a problem: labels of buttons, and what they do."""


@dataclass(frozen=True)
class Notice:
    """The latest thing that was told."""

    text: str
    is_error: bool = False


@dataclass(frozen=True, eq=False)
class Card:
    """A problem that stays in view until it is dismissed, or mended with all that are `about` the same thing."""

    text: str
    about: str = ""
    remedies: WaysOut = field(default_factory=dict)


@dataclass(frozen=True)
class Entry:
    """A line of the log; the time is in seconds since the epoch."""

    time: float
    kind: str
    text: str


class Notices:
    """At most one notice, the `latest`, for as long as it takes to read it; an empty one where there is none.

    Errors are `cards`, too, the latest first; of so many that nobody reads them the oldest go. The `log` has everything
    of late, the oldest first.
    """

    def __init__(self) -> None:
        self.latest = Notice("")
        self.cards: tuple[Card, ...] = ()
        self.log: deque[Entry] = deque(maxlen=_LONGEST_LOG)
        self._said_at = 0.0
        self._moves = 0

    def say(self, text: str, is_error: bool, moves: int, about: str = "", remedies: WaysOut | None = None) -> None:
        """Replace the notice; `moves` counts what the user did so far. What is told again and again is told once."""
        text = " ".join(text.split())
        is_known = any(card.text == text for card in self.cards) if is_error else self.latest == Notice(text)
        if text and not is_known:
            self.log.append(Entry(time.time(), "error" if is_error else "notice", text))
        if text and is_error:
            new = Card(text, about, remedies or {})
            known = tuple(new if card.text == text else card for card in self.cards)
            self.cards = (known if is_known else (new, *known))[:_MOST_CARDS]
        self.latest = Notice(text, is_error)
        self._said_at, self._moves = time.perf_counter(), moves

    def offered(self, card: Card) -> WaysOut:
        """The remedies of a card, but not those that a newer one offers, too."""
        newer = takewhile(lambda one: one is not card, self.cards)
        taken = [remedy for one in newer for remedy in one.remedies.items()]
        return {label: do for label, do in card.remedies.items() if (label, do) not in taken}

    def dismiss(self, card: Card) -> None:
        """Take a card away, and the notice that says the same."""
        self.cards = tuple(one for one in self.cards if one is not card)
        if self.latest == Notice(card.text, True):
            self.clear()

    def mend(self, about: str) -> None:
        """Take all cards about something away, as it is in order now."""
        for card in self.cards:
            if card.about == about:
                self.dismiss(card)

    def clear(self) -> None:
        """Take the notice away; cards stay."""
        self.latest = Notice("")

    def forget(self, moves: int) -> None:
        """Take the notice away when it was there for long enough; an error's also when the user did something since."""
        age = time.perf_counter() - self._said_at
        answered = self.latest.is_error and self._moves != moves
        if answered or age > (_SECONDS_OF_ERROR if self.latest.is_error else _SECONDS_OF_NOTICE):
            self.clear()
