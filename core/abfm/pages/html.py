"""HTML from templates; all pages and notebook views are rendered here, with escaped values."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markdown_it import MarkdownIt
from markupsafe import Markup

from abfm import explanations
from abfm.wording import capital, sentence

TEMPLATES = Path(__file__).parent / "template"


@cache
def environment(*folders: Path) -> Environment:
    """Return the Jinja environment with the templates in some folders and in this package.

    Values are escaped, and an undefined name raises an error. The filter ``tojson`` writes JSON
    that no HTML parser reads as a tag.
    """
    found = Environment(
        autoescape=True,
        keep_trailing_newline=True,
        loader=FileSystemLoader([*folders, TEMPLATES]),
        lstrip_blocks=True,
        trim_blocks=True,
        undefined=StrictUndefined,
    )
    found.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    found.filters |= {"capital": capital, "explanation": _explanation, "sentence": sentence}
    return found


def _explanation(topic: str) -> Markup:
    markdown = MarkdownIt("commonmark", {"html": False})
    return Markup(markdown.render(explanations.section(topic)))


def stylesheet(*paths: Path) -> str:
    return "".join(path.read_text(encoding="utf-8") for path in (TEMPLATES / "base.css", *paths))
