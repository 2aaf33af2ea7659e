"""Sections of the guides that explain verdicts, warnings, numbers and parameters, by topic."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

from abfm.errors import ParameterError, brief, did_you_mean

_PAGES = ("troubleshooting.md", "numbers.md")
_SITE = Path("docs", "_build", "html", "howto")  # in the repository
_HEADINGS = re.compile(r"^(##|###) (.*)\n", re.MULTILINE)
_LABEL = re.compile(r"\*\*([^*]+)\*\*")
_MARKUP = re.compile(r"`|(?<!\w)\*(?=\w)|(?<=[\w.])\*(?!\w)")
_REFERENCE = re.compile(r"\n\nMore: .*$", re.DOTALL)  # to other pages of the site
_LINK = re.compile(r"\[([^]]*)\]\([^)]*\)")


def names() -> list[str]:
    """Return the names of all sections, such as "values differ", in the order of the pages."""
    return list(_sections())


def section(name: str) -> str:
    """Return the text of a section as Markdown, without its heading and without links.

    Case does not matter, and hyphens may replace spaces in the name. Raise ParameterError if there
    is no such section.
    """
    return _sections()[title(name)].text


def site_page(name: str) -> str | None:
    """Return the address of a section on the site that ``./run docs`` built, or None without it."""
    page = _root() / _SITE / Path(_sections()[title(name)].page).with_suffix(".html")
    return f"{page.as_uri()}#{slug(name)}" if page.is_file() else None


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
    """Return the names of the sections under each heading of the pages."""
    found: dict[str, list[str]] = {}
    for name, each in _sections().items():
        found.setdefault(each.heading, []).append(name)
    return found


class _Section(NamedTuple):
    page: str  # name of the file
    heading: str  # above the section
    text: str


@cache
def _sections() -> dict[str, _Section]:
    """Return the sections of all pages by name."""
    found = {}
    for page in _PAGES:
        parts = _HEADINGS.split(_path(page).read_text(encoding="utf-8"))[1:]
        heading = ""
        for level, title, text in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
            if level == "##":
                heading = title
            else:
                text = _LINK.sub(r"\1", _REFERENCE.sub("", text.strip()))
                found[title.lower()] = _Section(page, heading, text)
    return found


def _root() -> Path:
    """Return the root of the repository, which an editable installation uses."""
    return Path(__file__).resolve().parents[2]


def _path(page: str) -> Path:
    """Return the path of a page: in the package, or in the repository (editable install)."""
    installed = Path(__file__).resolve().parent / page
    return installed if installed.is_file() else _root() / "docs" / "howto" / page
