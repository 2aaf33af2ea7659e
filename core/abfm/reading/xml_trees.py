"""XML as a tree of elements, and the words and numbers in it."""

from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief


def xml_tree(content: bytes) -> Element:
    """Parse a complete document and return its root.

    A DTD inside the document is refused before any of it is expanded: its entities and default
    attributes turn small files into gigabytes. A DOCTYPE that names a DTD elsewhere, as GIFTI files
    do, is accepted and never fetched.

    Raises
    ------
    ValueError
        If it is no XML, is cut short, contains a DTD, or has an unknown encoding.
    """
    parser, builder = expat.ParserCreate(), TreeBuilder()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = _refuse_dtd
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise ValueError(f"it is no XML, or cut short: {error}") from error
    except LookupError as error:  # of Python's own table of encodings
        raise ValueError(f"its XML has an {error}; expected UTF-8") from error
    return builder.close()


def _refuse_dtd(name: str, system: str | None, public: str | None, has_subset: bool) -> None:
    if has_subset:
        raise ValueError(
            "it contains a document type definition (<!DOCTYPE ... [ ... ]>), which is not read: "
            "remove the part in brackets"
        )


def meaning_of(element: Element, name: str, known: dict[str, Any], default: str = "") -> Any:
    """Return what the word in an attribute stands for; a ValueError lists those that are known."""
    word = (element.get(name) or default).strip()
    if word not in known:
        words = ", ".join(each for each in known if not each.isdigit() and "GIFTI" not in each)
        raise ValueError(f"a {element.tag} has the {name} {brief(word)}; expected {words}")
    return known[word]


def count_in(element: Element, name: str, default: str = "") -> int:
    """Return the whole number in an attribute, or raise a ValueError."""
    text = (element.get(name) or default).strip()
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise ValueError(
            f"a {element.tag} has the {name} {brief(text)}; expected a whole number, 0 or more"
        )
    return int(text)


def numbers_in(text: str, kind: np.dtype[Any]) -> NDArray[Any]:
    """Return the numbers of a type in a text, or raise a ValueError if it has anything else."""
    try:
        return np.array(text.split(), dtype=kind)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"an array has something else than numbers of type {kind}") from error
