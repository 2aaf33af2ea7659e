"""XML as a stream of events: elements and their text."""

from typing import NoReturn, Protocol
from xml.parsers import expat


class Events(Protocol):
    """Receives the events."""

    def start(self, name: str, attributes: dict[str, str]) -> None: ...

    def end(self, name: str) -> None: ...

    def characters(self, text: str) -> None: ...


def take_events(content: bytes, events: Events | None = None) -> None:
    """Parse a complete document; without a receiver of events, only check it.

    A DTD inside the document is refused before any of it is expanded: its entities and default
    attributes turn small files into gigabytes. A DOCTYPE that names a DTD elsewhere, as GIFTI files
    do, is accepted and never fetched.

    Raises
    ------
    ValueError
        If it is no XML, is cut short, contains a DTD, or has an unknown encoding.
    """
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = _check_doctype
    parser.EntityDeclHandler = _refuse_dtd
    if events is not None:
        parser.StartElementHandler = events.start
        parser.EndElementHandler = events.end
        parser.CharacterDataHandler = events.characters
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise ValueError(f"it is no XML, or cut short: {error}") from error
    except LookupError as error:  # of Python's own table of encodings
        raise ValueError(f"its XML has an {error}; expected UTF-8") from error


def _check_doctype(name: str, system: str | None, public: str | None, has_subset: bool) -> None:
    if has_subset:
        _refuse_dtd()


def _refuse_dtd(*_: object) -> NoReturn:
    raise ValueError(
        "it contains a document type definition (<!DOCTYPE ... [ ... ]>), which is not read: "
        "remove the part in brackets"
    )
