"""HTML from templates: every page and view is rendered here, with all values escaped."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from abfm.wording import capital, sentence

TEMPLATES = Path(__file__).parent / "template"


@cache
def environment(*folders: Path) -> Environment:
    """Return the environment of the templates in some folders and of those of this package.

    Values are escaped, a name that a template does not get is an error, and ``tojson`` writes JSON
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
    found.filters |= {"capital": capital, "sentence": sentence}
    return found


def stylesheet(*paths: Path) -> str:
    """Return the styles that all pages share, and then those of some files."""
    return "".join(path.read_text(encoding="utf-8") for path in (TEMPLATES / "base.css", *paths))
