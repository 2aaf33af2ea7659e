"""Parsing of XML, and of the words and numbers in its elements."""

from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from abfm.errors import brief


def xml_tree(content: bytes) -> Element:
    """Parse a complete document and return its root.

    A document type definition (DTD) inside the document is refused before it is expanded. Its
    entities and default attributes can turn small files into gigabytes. A DOCTYPE that refers to
    another file, as in GIFTI files, is accepted; the other file is never read.

    Raises ValueError if the content is not XML, is cut off, contains a DTD, or has an unknown
    encoding.
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
        raise ValueError(f"the file is not XML, or is cut off: {error}") from error
    except LookupError as error:  # Python has no such encoding
        raise ValueError(f"the XML has an {error}; expected UTF-8") from error
    return builder.close()


def _refuse_dtd(name: str, system: str | None, public: str | None, has_subset: bool) -> None:
    if has_subset:
        raise ValueError(
            "the file has a document type definition (<!DOCTYPE ... [ ... ]>), which is not "
            "supported. Remove the part in brackets"
        )


def choice_in(element: Element, name: str, choices: dict[str, Any], default: str = "") -> Any:
    """Return the value in ``choices`` of the word in an attribute; ValueError for other words."""
    word = (element.get(name) or default).strip()
    if word not in choices:
        words = ", ".join(each for each in choices if not each.isdigit() and "GIFTI" not in each)
        raise ValueError(f"the {name} of a {element.tag} is {brief(word)}; expected {words}")
    return choices[word]


def count_in(element: Element, name: str, default: str = "") -> int:
    """Return the integer in an attribute of an element; ValueError unless it is 0 or more."""
    text = (element.get(name) or default).strip()
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise ValueError(
            f"the {name} of a {element.tag} is {brief(text)}; expected an integer, 0 or more"
        )
    return int(text)


def numbers_in(text: str, kind: np.dtype[Any]) -> NDArray[Any]:
    """Return the numbers in a text, of the type ``kind``; ValueError if other words are in it."""
    try:
        return np.array(text.split(), dtype=kind)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"an array has words that are not numbers of type {kind}") from error
