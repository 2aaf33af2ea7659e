"""One thing that a key or a menu does."""

import sys
from collections.abc import Callable
from dataclasses import dataclass

COMMAND = "Cmd" if sys.platform == "darwin" else "Ctrl"


@dataclass(eq=False)
class Action:
    """Something that keys such as "Ctrl+Shift+S" (on a Mac Cmd) do; `group` is its heading in the
    list in Help.

    If it `repeats`, holding the key does it again and again. `while_typing` it holds in a text box,
    too, which then takes what was typed; other keys may mean something there.
    """

    group: str
    does: str
    do: Callable[[], None]
    chords: tuple[str, ...]
    repeats: bool = False
    while_typing: bool = False

    @property
    def hints(self) -> list[str]:
        """The chords, as the user's keyboard calls them."""
        return [chord.replace("Ctrl", COMMAND) for chord in self.chords]

    @property
    def hint(self) -> str:
        return self.hints[0]
