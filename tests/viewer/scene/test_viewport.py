"""Meshes are drawn alike whatever their units and wherever they are."""

from __future__ import annotations

import numpy as np
import pytest

import abfm
from abfm import TriangleMesh
from abfm_viewer.automation.driver import Driver
from abfm_viewer.document.document import Channel, Document, Surface
from abfm_viewer.pictures.document_pictures import DocumentRenderer, PictureOptions
from abfm_viewer.pictures.sheets import match_picture
from abfm_viewer.scene.surfaces import Viewport
from tests.shapes import ellipsoid

EGG = ellipsoid(3, 1.0, 0.7, 0.55)
SIZE = (480, 300)
CHANNEL = Channel("gaussian:vertex=5,width=0.15", "gaussian:vertex=60,width=0.15")
PLACES = [(1e-40, 0.0), (1e-8, 0.0), (1e40, 0.0), (1.0, 1e6), (1e-3, -1e4)]


def moved(scale: float, offset: float) -> TriangleMesh:
    return TriangleMesh(scale * EGG.vertices + offset * np.array([1.0, -2.0, 0.5]), EGG.faces)


def document(mesh: TriangleMesh) -> Document:
    f, g = (abfm.function(mesh, CHANNEL.spec(side)) for side in ("source", "target"))
    result = abfm.match(mesh, f, g, abfm.Parameters(iterations=8))
    return Document(
        (Surface(mesh, "egg"),), (CHANNEL,), parameters=result.parameters, result=result, time=1.0
    )


def picture(document: Document) -> np.ndarray:
    with DocumentRenderer(document, {}, SIZE, PictureOptions(color_bar=False)) as renderer:
        return np.asarray(renderer.picture(1.0, 30.0)).astype(int)


@pytest.fixture(scope="module")
def plain():
    return document(EGG)


def test_units_and_back():
    viewport = Viewport(moved(1e-3, 5.0))
    points = np.random.default_rng(0).normal(size=(4, 3))
    np.testing.assert_allclose(viewport.undrawn(viewport.drawn(points)), points, atol=1e-12)
    drawn = viewport.drawn(moved(1e-3, 5.0).vertices)
    np.testing.assert_allclose(drawn.min(axis=0), -drawn.max(axis=0), atol=1e-9)


@pytest.mark.parametrize(("scale", "offset"), PLACES)
def test_pictures_are_the_same(plain, scale, offset):
    there = document(moved(scale, offset))
    assert abs(picture(there) - picture(plain)).mean() < 0.5
    sheets = [
        np.asarray(match_picture(one.result, size=(700, 200))).astype(int) for one in (there, plain)
    ]
    assert abs(sheets[0] - sheets[1]).mean() < 0.5


@pytest.mark.parametrize(("scale", "offset"), PLACES[2:4])
def test_overlays_and_clicks_are_where_the_surface_is(scale, offset, tmp_path):
    """Arrows and a flow line are drawn, a vertex is picked where it is seen, and a moved camera
    is kept.
    """
    with Driver(document_file(moved(scale, offset), tmp_path), size=(640, 480)) as gui:
        gui.session.editor.set_view("look", arrows=True)
        scene, surface = gui.window.scene, gui.session.surface()
        vertices = surface.mesh.vertices
        vertex = int(np.argmax(vertices @ surface.front.direction))
        point = scene.nearest("advected", vertices[vertex]).point
        gui.session.editor.add_point("lines", point)
        shown = gui.window.shown
        gui.wait(lambda _: not shown.busy and not shown.quantities.busy)
        gui.frames(3)
        drawn = {surface for surface, *_ in scene.overlays.structures()}
        assert drawn == {"advected"}
        x, y, _ = scene.projected("source", vertices[vertex])[0]
        hit = scene.pick((x, y))
        assert hit is not None
        assert hit.surface == "source"
        assert np.linalg.norm(vertices[hit.vertex] - vertices[vertex]) <= 0.4 * scale
        assert gui.session.view.look is None
        gui.input.drag((x, y), (x + 30, y + 10))
        look = gui.session.view.look
        assert look is not None
        gui.frames(5)
        assert gui.session.view.look is look


def document_file(mesh: TriangleMesh, folder) -> str:
    from abfm_viewer.files.project import save_project

    path = folder / "egg.abfm"
    save_project(path, document(mesh), {})
    return str(path)
