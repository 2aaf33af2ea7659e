"""Pages about results, one file each: templates with facts and pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abfm.errors import one_line
from abfm.matching.report import value_text
from abfm.outcome import Facts
from abfm.pages.colormaps import gradient
from abfm.pages.html import environment, stylesheet
from abfm.parameters import FIELDS, NOTE, TABLE_1
from abfm.wording import number_text, percents, share

if TYPE_CHECKING:
    from jinja2 import Environment
    from PIL import Image

    from abfm_viewer.pictures.population_pictures import PopulationPictures
    from abfm_viewer.pictures.registration_pictures import RegistrationPictures

COVERAGE_MIN = 0.98  # share of surface A; a report warns of maps that cover less
RETURN_EDGES_MAX = 0.1
"""A report warns if 5% of the vertices have a larger round-trip error, in edge lengths."""
TEXT_LENGTH_MAX = 400  # characters of a name, an option or a reason on the page of a batch
_PICTURE_COLORS = 256  # a third of the bytes, without a visible difference
_TABLE_1_COLUMNS = {
    "tau": "τ",
    "alpha": "α",
    "beta": "β",
    "sigma": "last σ",
    "segments": "N",
    "substeps": "n",
    "cooling_stages": "stages",
}
_TEMPLATES = Path(__file__).parent / "templates"
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def report_page(facts: Mapping[str, Any], pictures: RegistrationPictures) -> str:
    changed = facts.get("changed_parameters", {})
    return render(
        "report.html",
        facts=facts,
        pictures=pictures,
        changed=[(FIELDS[name], value) for name, value in changed.items()],
        coverage_min=COVERAGE_MIN,
        return_edges_max=RETURN_EDGES_MAX,
    )


def population_page(
    facts: Mapping[str, Any], verdict: Facts, pictures: PopulationPictures | None
) -> str:
    return render("population.html", facts=facts, verdict=verdict, pictures=pictures)


def figures_page(entries: Sequence[Any]) -> str:
    rows = TABLE_1.values()
    unused = ["substeps" if row.values["method"] == "linearised" else "segments" for row in rows]
    table, columns = list(zip(rows, unused, strict=True)), _TABLE_1_COLUMNS
    return render("figures.html", entries=entries, table=table, columns=columns, note=NOTE)


def render(template: str, **values: Any) -> str:
    """Return the page of a template in `abfm_viewer/reports/templates`."""
    page = _environment().get_template(template)
    style = stylesheet(_TEMPLATES / "style.css")
    return page.render(policy=_POLICY, style=style, version=version("abfm"), **values)


@cache
def _environment() -> Environment:
    found = environment(_TEMPLATES)
    found.filters |= {
        "abbreviated": abbreviated,
        "gradient": gradient,
        "number": number_text,
        "percents": percents,
        "plain": value_text,
        "png": _png,
        "share": share,
    }
    return found


def abbreviated(text: str) -> str:
    """Return a text in one line of at most `TEXT_LENGTH_MAX` letters."""
    return one_line(text, TEXT_LENGTH_MAX)


def _png(picture: Image.Image | bytes, colors: int | None = _PICTURE_COLORS) -> str:
    """Return a picture as a data URL, with a palette of a number of colours."""
    if not isinstance(picture, bytes):
        stream = io.BytesIO()
        (picture.quantize(colors) if colors else picture).save(stream, "PNG", optimize=True)
        picture = stream.getvalue()
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}"
