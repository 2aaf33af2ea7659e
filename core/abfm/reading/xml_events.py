"""XML by its events: elements, their text, and entities, which whoever reads may refuse."""

from typing import Protocol
from xml.parsers import expat


class Events(Protocol):
    """What takes the events."""

    def start(self, name: str, attributes: dict[str, str]) -> None: ...

    def end(self, name: str) -> None: ...

    def characters(self, text: str) -> None: ...

    def entity(self, *declared: object) -> None: ...


def take_events(content: bytes, events: Events) -> None:
    """Parse a whole document; a ValueError says that it is none."""
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = events.start
    parser.EndElementHandler = events.end
    parser.CharacterDataHandler = events.characters
    parser.EntityDeclHandler = events.entity
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise ValueError(f"it is no XML, or cut short: {error}") from error
