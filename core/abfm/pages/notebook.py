"""Pages of meshes and results, embedded in a notebook or opened in a browser."""

from __future__ import annotations

import os
import tempfile
import webbrowser
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from abfm.display import BEST_VIEW, ViewSpec
from abfm.errors import AbfmError, ParameterError, brief, one_line, printable
from abfm.maps import project_onto_surface
from abfm.matching import Match
from abfm.mesh import TriangleMesh
from abfm.mesh.coarsening import coarsened
from abfm.outcome import Facts
from abfm.pages import result_pages
from abfm.pages.color_ranges import color_range
from abfm.pages.front import front_of
from abfm.pages.html import environment
from abfm.pages.page import Layer, Page, Panel
from abfm.pages.sequence_pages import Labels, sequence_page
from abfm.population import Population
from abfm.registration import Correspondence, Registration
from abfm.sequences import Sequence
from abfm.wording import counted

VERTICES_MAX = 10_000
"""Maximum number of vertices of a surface in a notebook; finer surfaces are coarsened."""
RESULT_VERTICES_MAX = 100_000
"""Maximum number of vertices of a result in a notebook; larger pages would take long."""
BYTES_MAX = 6_000_000  # maximum number of characters of a page in a notebook
DATA_SHARE = 0.1  # fraction of the values, arrows and lines of a full page that a notebook shows
_HEIGHT = 440  # height in pixels
_COLORS = {"good": "#2da44e", "warning": "#bf8700", "failure": "#cf222e"}


def page_of(
    shown_object: Any, title: str = "", view: ViewSpec = BEST_VIEW, share: float = 1.0
) -> Page:
    """Return the page of a mesh or a result.

    Parameters
    ----------
    shown_object : TriangleMesh or result
    title : str
        Title of the page; by default the name of the type.
    view : ViewSpec
    share : float
        Fraction of the maximum number of values, arrows and lines, up to 1.
    """
    title = title or _kind(shown_object)
    if isinstance(shown_object, Match):
        return result_pages.match_page(shown_object, title, view, share)
    if isinstance(shown_object, Registration):
        return result_pages.registration_page(shown_object, title, view, share)
    if isinstance(shown_object, Correspondence):
        return result_pages.correspondence_page(shown_object, title, view)
    if isinstance(shown_object, Population):
        return result_pages.population_page(shown_object, title, view)
    if isinstance(shown_object, Sequence):
        labels = Labels(unit_of_time=shown_object.unit_of_time, view=view, share=share)
        return sequence_page(shown_object, title, labels)
    if isinstance(shown_object, TriangleMesh):
        return mesh_page(shown_object, title, view)
    raise ParameterError(f"no page can show {brief(shown_object)}; expected a mesh or a result")


def mesh_page(mesh: TriangleMesh, title: str, view: ViewSpec = BEST_VIEW) -> Page:
    """Return the page of a mesh, with notes on repairs and warnings."""
    plain = np.full(len(mesh.vertices), np.nan)
    panel = Panel("", mesh, [Layer("", plain, color_range(plain))], front_of(mesh, view=view))
    boundary = "closed" if mesh.is_closed else counted(len(mesh.boundary_loops), "boundary loop")
    headline = f"{len(mesh.vertices):,} vertices, {len(mesh.faces):,} faces, {boundary}"
    return Page(title, headline, [panel], facts={"genus": str(mesh.genus)}, notes=mesh.messages)


def coarser(page: Page, vertex_count: int) -> Page:
    """Return a page with surfaces of at most about ``vertex_count`` vertices, and a note."""
    panels = [_coarser(panel, vertex_count) for panel in page.panels]
    changed = [old.mesh for old, new in zip(page.panels, panels, strict=True) if old is not new]
    if not changed:
        return page
    vertices_max = max(len(mesh.vertices) for mesh in changed)
    note = f"shown on a coarser mesh with about {vertex_count:,} of {vertices_max:,} vertices"
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


def embedded(shown_object: Any) -> str:
    """Return the notebook view of an object: its verdict, and a page in a frame.

    The frame contains the complete page, so that exported notebooks show it, and its script has no
    access to the notebook. Surfaces with more than `VERTICES_MAX` vertices are coarsened. A
    sentence replaces the page of a result with more than `RESULT_VERTICES_MAX` vertices, and a page
    of more than `BYTES_MAX` characters.
    """
    if (
        not isinstance(shown_object, TriangleMesh)
        and (count := _vertex_count(shown_object)) > RESULT_VERTICES_MAX
    ):
        headline, tone = _verdict(shown_object)
        note = _see_browser(f"{count:,} vertices")
        return _about(f"{_kind(shown_object)}: {headline}", tone, [note])
    try:
        page = coarser(page_of(shown_object, share=DATA_SHARE), VERTICES_MAX)
        frame = page.html(is_embedded=True)
    except AbfmError as error:
        return _about(one_line(error), "failure", [])
    notes = [" \u00b7 ".join(f"{name}: {value}" for name, value in page.facts.items()), *page.notes]
    if len(frame) > BYTES_MAX:
        notes, frame = [*notes, _see_browser("too many values")], ""
    return _about(f"{page.title}: {page.headline}", page.tone, notes, page.title, frame)


def show(shown_object: Any, path: str | os.PathLike[str] | None, view: ViewSpec) -> Path:
    """Write the page of an object and open it in a browser; see `abfm.display.Display.show`."""
    name = _kind(shown_object)
    file = Path(path or Path(tempfile.mkdtemp(prefix="abfm-"), f"{name}.html")).absolute()
    page_of(shown_object, printable(file.stem), view).write(file)
    try:
        is_open = webbrowser.open(file.as_uri())
    except webbrowser.Error:
        is_open = False
    if not is_open:
        print(f"No browser was found. Open this page in a browser: {file}")
    return file


def _kind(shown_object: Any) -> str:
    names = (each.__name__ for each in type(shown_object).__mro__)
    public = next(name for name in names if not name.startswith("_"))
    return public.removeprefix("Triangle").lower()


def _verdict(shown_object: Any) -> tuple[str, str]:
    """Return the headline of a result, and the name of the colour that shows its outcome."""
    facts: Facts | None = getattr(shown_object, "facts", None)
    if facts is None:
        return result_pages.correspondence_headline(shown_object), "ink"
    return facts.headline, facts.tone


def _vertex_count(shown_object: Any) -> int:
    if isinstance(shown_object, Correspondence):
        return max(len(shown_object.a.vertices), len(shown_object.b.vertices))
    mesh = shown_object.template if isinstance(shown_object, Population) else shown_object.mesh
    return len(mesh.vertices)


def _see_browser(reason: str) -> str:
    return f"Not drawn here, because it has {reason}; call show() to open the page in a browser"


def _about(headline: str, tone: str, notes: list[str], title: str = "", frame: str = "") -> str:
    """Return HTML with a headline, notes, and optionally ``frame``, a page in HTML."""
    color, template = _COLORS.get(tone), environment().get_template("notebook.html")
    return template.render(
        color=color, headline=headline, notes=notes, title=title, frame=frame, height=_HEIGHT
    )
