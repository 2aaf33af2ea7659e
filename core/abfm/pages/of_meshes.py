"""Pages of meshes without a function, and pages on coarser meshes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from abfm.maps import project_onto_surface
from abfm.mesh import TriangleMesh
from abfm.mesh.coarsening import coarsened
from abfm.pages.colormaps import color_range
from abfm.pages.front import best_front
from abfm.pages.page import Layer, Page, Panel
from abfm.wording import counted


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
