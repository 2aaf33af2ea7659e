"""Why new values were not taken, and what was typed for them, which stays in its box to be mended."""


class Refusals:
    """Reasons and texts by the box's key, until its value or another one is accepted."""

    def __init__(self) -> None:
        self.reasons: dict[str, str] = {}
        self._texts: dict[str, str] = {}
        self._typed: dict[str, str] = {}  # in this frame
        self._accepted: tuple[object, ...] = ()

    def begin_frame(self) -> None:
        self._typed.clear()

    def text(self, key: str, value: str) -> str:
        """What a box shows: its value, or what was typed instead and not yet taken."""
        return self._texts.get(key, value)

    def is_typing(self, key: str, text: str) -> None:
        """Remember what a box holds while the keyboard is in it."""
        self._texts[key] = text

    def typed(self, key: str, text: str) -> None:
        """A box was left with a new text: it stays if `refuse` follows in this frame."""
        self._texts.pop(key, None)
        self._typed[key] = text

    def refuse(self, key: str, reason: str) -> None:
        """Say why the new value was not taken."""
        self.accept(key)
        self.reasons[key] = reason
        if key in self._typed:
            self._texts[key] = self._typed[key]

    def accept(self, key: str) -> None:
        """Take back what was said, and let the box show its value again."""
        self.reasons.pop(key, None)
        self._texts.pop(key, None)

    def accept_after(self, *values: object) -> None:
        """Take everything back when one of these is another than at the last call: something was accepted since."""
        if len(values) != len(self._accepted) or any(
            now is not then for now, then in zip(values, self._accepted, strict=True)
        ):
            for key in list(self.reasons):
                self.accept(key)
        self._accepted = values
