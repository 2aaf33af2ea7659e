"""Sections of the page Troubleshooting: one for each outcome, cause and warning of a result."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from abfm.errors import ParameterError, brief, did_you_mean

_FILE = "troubleshooting.md"
_HEADINGS = re.compile(r"^(##|###) (.*)\n", re.MULTILINE)
_LABEL = re.compile(r"\*\*([^*]+)\*\*")
_MARKUP = re.compile(r"`|(?<!\w)\*(?=\w)|(?<=[\w.])\*(?!\w)")
_LINK = re.compile(r"\[([^]]*)\]\([^)]*\)")


def names() -> list[str]:
    """Return the names of all sections, such as "values differ", in the order of the page."""
    return list(_sections())


def section(name: str) -> str:
    """Return the text of a section as Markdown, without its heading and without links.

    Case does not matter, and hyphens may replace spaces in the name of an outcome, a cause or a
    warning. Raise ParameterError if there is no such section.
    """
    return _sections()[title(name)][1]


def title(name: str) -> str:
    """Return the title of a section in lower case; ParameterError if there is none."""
    known = {slug(each): each for each in names()}
    if slug(name) not in known:
        raise ParameterError(
            f"there is no explanation of {brief(name)}{did_you_mean(slug(name), known)}; "
            "`abfm explain` lists all names"
        )
    return known[slug(name)]


def slug(name: str) -> str:
    """Return the name of a section as one word, such as ``values-differ``."""
    return re.sub(r"[\s_]+", "-", name.strip().lower())


def paragraphs(name: str) -> list[str]:
    """Return the paragraphs and list items of a section as plain text, one line each.

    Labels of the window are in quotes.
    """
    blocks = re.split(r"\n\n+|\n(?=- )", _LABEL.sub(r'"\1"', section(name)))
    return [" ".join(_MARKUP.sub("", block).split()) for block in blocks]


def summary(name: str) -> str:
    """Return the first sentence of a section as plain text."""
    return re.split(r"(?<=\.) ", paragraphs(name)[0])[0]


def groups() -> dict[str, list[str]]:
    """Return the names of the sections under each heading of the page."""
    found: dict[str, list[str]] = {}
    for name, (group, _) in _sections().items():
        found.setdefault(group, []).append(name)
    return found


@cache
def _sections() -> dict[str, tuple[str, str]]:
    """Return, by name, the heading above each section and the text of the section."""
    parts = _HEADINGS.split(_path().read_text(encoding="utf-8"))[1:]
    group, found = "", {}
    for level, title, text in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
        if level == "##":
            group = title
        else:
            found[title.lower()] = group, _LINK.sub(r"\1", text).strip()
    return found


def _path() -> Path:
    """Return the path of the page: in the package, or in the repository (editable install)."""
    here = Path(__file__).resolve().parent
    installed = here / _FILE
    return installed if installed.is_file() else here.parents[1] / "docs" / "howto" / _FILE
