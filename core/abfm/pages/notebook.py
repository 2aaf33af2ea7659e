"""Pages of objects: embedded in a notebook, or opened in a browser."""

from __future__ import annotations

import os
import tempfile
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from abfm.errors import AbfmError, ParameterError, brief, one_line, printable
from abfm.maps import project_onto_surface
from abfm.matching import Match
from abfm.mesh import TriangleMesh
from abfm.mesh.coarsening import coarsened
from abfm.outcome import Facts
from abfm.pages.colormaps import color_range
from abfm.pages.front import best_front
from abfm.pages.html import environment
from abfm.pages.of_results import (
    correspondence_headline,
    correspondence_page,
    match_page,
    population_page,
    registration_page,
)
from abfm.pages.of_sequences import Labels, sequence_page
from abfm.pages.page import Layer, Page, Panel
from abfm.population import Population
from abfm.registration import Correspondence, Registration
from abfm.sequences import Sequence
from abfm.wording import counted

VERTICES_MAX = 10_000
"""Vertices of a surface in a notebook; finer ones are coarsened."""
RESULT_VERTICES_MAX = 100_000
"""Vertices of a surface whose result is shown in a notebook: on more, a page takes long."""
BYTES_MAX = 6_000_000
"""Characters of a page in a notebook."""
SHARE = 0.1
"""How many of the values, arrows and lines of a page there are in a notebook."""
_HEIGHT = 440  # pixels
_COLORS = {"good": "#2da44e", "warning": "#bf8700", "failure": "#cf222e"}


def page_of(what: Any, title: str = "", up: str | None = None, share: float = 1.0) -> Page:
    """Return the page of a mesh or of a result.

    Parameters
    ----------
    title : str
        By default the name of the type.
    share : float
        How many of the values, arrows and lines that a page may have, up to 1.
    """
    if up not in (None, "x", "y", "z"):
        raise ParameterError(f"up is {brief(up)}; expected x, y or z")
    title = title or _kind(what)
    if isinstance(what, Match):
        return match_page(what, title, up, share)
    if isinstance(what, Registration):
        return registration_page(what, title, up, share)
    if isinstance(what, Correspondence):
        return correspondence_page(what, title, up)
    if isinstance(what, Population):
        return population_page(what, title, up)
    if isinstance(what, Sequence):
        labels = Labels(unit_of_time=what.unit_of_time, up=up, share=share)
        return sequence_page(what, title, labels)
    if isinstance(what, TriangleMesh):
        return mesh_page(what, title, up)
    raise ParameterError(f"there is no page of {brief(what)}; expected a mesh or a result")


def mesh_page(mesh: TriangleMesh, title: str, up: str | None = None) -> Page:
    """Return the page of a mesh, with what was repaired or is worth a warning."""
    plain = np.full(len(mesh.vertices), np.nan)
    panel = Panel("", mesh, [Layer("", plain, color_range(plain))], best_front(mesh, up=up))
    boundary = "closed" if mesh.is_closed else counted(len(mesh.boundary_loops), "boundary loop")
    headline = f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces, {boundary}"
    return Page(title, headline, [panel], facts={"genus": str(mesh.genus)}, notes=mesh.messages)


def coarser(page: Page, vertex_count: int) -> Page:
    """Return a page whose surfaces have at most about ``vertex_count`` vertices each."""
    panels = [_coarser(panel, vertex_count) for panel in page.panels]
    changed = [old.mesh for old, new in zip(page.panels, panels, strict=True) if old is not new]
    if not changed:
        return page
    most = max(len(mesh.vertices) for mesh in changed)
    note = f"shown on a coarser mesh, of about {vertex_count:,} vertices instead of {most:,}"
    return replace(page, panels=panels, notes=[*page.notes, note])


def _coarser(panel: Panel, vertex_count: int) -> Panel:
    mesh = panel.mesh
    if len(mesh.vertices) <= vertex_count or (coarse := coarsened(mesh, vertex_count)) is None:
        return panel
    points = project_onto_surface(mesh, coarse.vertices)
    corners = mesh.faces[points.faces]

    def shown(layer: Layer) -> Layer:
        values = (points.barycentric * layer.values[..., corners]).sum(axis=-1)
        return replace(layer, values=values)

    return replace(panel, mesh=coarse, layers=[*map(shown, panel.layers)])


def embedded(what: Any) -> str:
    """Return a view for a notebook: the verdict, and a page in a frame.

    The frame holds the whole page, also where the notebook is exported, and its script cannot reach
    the notebook. Surfaces of more than `VERTICES_MAX` vertices are coarsened; a sentence replaces
    the page of results on more than `RESULT_VERTICES_MAX`, and pages above `BYTES_MAX`.
    """
    if not isinstance(what, TriangleMesh) and (count := _vertex_count(what)) > RESULT_VERTICES_MAX:
        headline, tone = _verdict(what)
        note = _see_browser(f"{count:,} vertices")
        return _about(f"{_kind(what)}: {headline}", tone, [note])
    try:
        page = coarser(page_of(what, share=SHARE), VERTICES_MAX)
        frame = page.html(is_embedded=True)
    except AbfmError as error:
        return _about(one_line(error), "failure", [])
    notes = [" \u00b7 ".join(f"{name}: {value}" for name, value in page.facts.items()), *page.notes]
    if len(frame) > BYTES_MAX:
        notes, frame = [*notes, _see_browser("so many values")], ""
    return _about(f"{page.title}: {page.headline}", page.tone, notes, page.title, frame)


def show(what: Any, path: str | os.PathLike[str] | None, up: str | None) -> Path:
    """Write the page of an object and open it in a browser; see `abfm.display.Display.show`."""
    name = _kind(what)
    file = Path(path or Path(tempfile.mkdtemp(prefix="abfm-"), f"{name}.html")).absolute()
    page_of(what, printable(file.stem), up).write(file)
    try:
        is_open = webbrowser.open(file.as_uri())
    except webbrowser.Error:
        is_open = False
    if not is_open:
        print(f"No browser was found. Open this page in one: {file}")
    return file


def _kind(what: Any) -> str:
    names = (each.__name__ for each in type(what).__mro__)
    public = next(name for name in names if not name.startswith("_"))
    return public.removeprefix("Triangle").lower()


def _verdict(what: Any) -> tuple[str, str]:
    """Return the headline of a result, and how it is shown."""
    facts: Facts | None = getattr(what, "facts", None)
    return (correspondence_headline(what), "ink") if facts is None else (facts.headline, facts.tone)


def _vertex_count(what: Any) -> int:
    if isinstance(what, Correspondence):
        return max(len(what.a.vertices), len(what.b.vertices))
    return len((what.template if isinstance(what, Population) else what.mesh).vertices)


def _see_browser(why: str) -> str:
    return f"It is not drawn here, as it has {why}; its show() opens a page in a browser"


def _about(headline: str, tone: str, notes: list[str], title: str = "", frame: str = "") -> str:
    """Return a headline with notes, and a page in a frame if there is one."""
    return (
        environment()
        .get_template("notebook.html")
        .render(
            color=_COLORS.get(tone),
            headline=headline,
            notes=notes,
            title=title,
            frame=frame,
            height=_HEIGHT,
        )
    )
