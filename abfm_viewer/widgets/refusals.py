"""Why new values were refused, and what was typed for them, which stays to be mended."""

from collections.abc import Iterator
from contextlib import contextmanager

from abfm import AbfmError
from abfm_viewer.widgets.widget_record import WidgetRecord


class Refusals:
    """Reasons and texts by a widget's name in the present section, until a value is accepted."""

    def __init__(self, record: WidgetRecord) -> None:
        self.reasons: dict[str, str] = {}
        self._record = record
        self._texts: dict[str, str] = {}
        self._typed: dict[str, str] = {}  # in this frame
        self._accepted: tuple[object, ...] = ()

    def begin_frame(self) -> None:
        self._typed.clear()

    def reason(self, name: str) -> str:
        """Return why a widget's new value was not taken; empty if it was."""
        return self.reasons.get(self._record.path(name), "")

    def text(self, name: str, value: str) -> str:
        """Return what a box shows: its value, or what was typed instead and not yet taken."""
        return self._texts.get(self._record.path(name), value)

    def is_typing(self, name: str, text: str) -> None:
        """Remember what a box holds while the keyboard is in it."""
        self._texts[self._record.path(name)] = text

    def typed(self, name: str, text: str) -> None:
        """Take note that a box was left with a new text: it stays if this frame refuses it."""
        key = self._record.path(name)
        self._texts.pop(key, None)
        self._typed[key] = text

    def refuse(self, name: str, reason: str) -> None:
        """Say below the widget of this name why its new value was not taken."""
        self.accept(name)
        key = self._record.path(name)
        self.reasons[key] = reason
        if key in self._typed:
            self._texts[key] = self._typed[key]

    def accept(self, name: str) -> None:
        """Take back what was said, and let the box show its value again."""
        self._forget(self._record.path(name))

    @contextmanager
    def refusing(self, name: str, label: str = "") -> Iterator[None]:
        """Refuse the new value of the widget of this name if the block ends with an error.

        An error that begins with the name begins with the label instead.
        """
        self.accept(name)
        try:
            yield
        except AbfmError as error:
            reason = str(error)
            is_named = label and reason.startswith(f"{name} ")
            self.refuse(name, f"{label}{reason[len(name) :]}" if is_named else reason)

    def accept_after(self, *values: object) -> None:
        """Take everything back when one of these has changed: something was accepted since."""
        if list(map(id, values)) != list(map(id, self._accepted)):
            for key in list(self.reasons):
                self._forget(key)
        self._accepted = values

    def _forget(self, key: str) -> None:
        self.reasons.pop(key, None)
        self._texts.pop(key, None)
