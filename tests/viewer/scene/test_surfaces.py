"""Drawing of meshes in any unit and place, with sharp creases, and cameras."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import abfm
from abfm import TriangleMesh, load_mesh
from abfm.assets import asset_path
from abfm.pages.front import Front
from abfm_viewer.automation.driver import Driver
from abfm_viewer.document.document import Channel, Surface
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.files.project import save_project
from abfm_viewer.pictures.document_pictures import DocumentRenderer, PictureOptions
from abfm_viewer.pictures.sheets import match_picture
from abfm_viewer.scene.surfaces import Viewport, back_faces, drawn_mesh, edge_width, fitted
from tests.shapes import disc, ellipsoid, icosphere, open_cylinder

EGG = ellipsoid(3, 1.0, 0.7, 0.55)
CHANNEL = Channel("gaussian:vertex=5,width=0.15", "gaussian:vertex=60,width=0.15")
PLACES = [(1e-40, 0.0), (1e-8, 0.0), (1e40, 0.0), (1.0, 1e6), (1e-3, -1e4)]


def moved(scale, offset):
    return TriangleMesh(scale * EGG.vertices + offset * np.array([1.0, -2.0, 0.5]), EGG.faces)


def document(mesh):
    f, g = (abfm.function(mesh, CHANNEL.spec(side)) for side in ("source", "target"))
    result = abfm.match(mesh, f, g, abfm.Parameters.of(iterations=8, refine=0))
    return MatchDocument(
        (Surface(mesh, "egg"),), (CHANNEL,), parameters=result.parameters, result=result, time=1.0
    )


def pictures(document):
    options = PictureOptions(color_bar=False)
    with DocumentRenderer(document, {}, (480, 300), options) as renderer:
        drawn = renderer.picture(1.0, 30.0), match_picture(document.result, size=(700, 200))
        return [np.asarray(picture).astype(int) for picture in drawn]


@pytest.fixture(scope="module")
def plain():
    return pictures(document(EGG))


def test_viewport_is_invertible():
    viewport = Viewport(moved(1e-3, 5.0))
    points = np.random.default_rng(0).normal(size=(4, 3))
    np.testing.assert_allclose(viewport.undrawn(viewport.drawn(points)), points, atol=1e-12)
    drawn = viewport.drawn(moved(1e-3, 5.0).vertices)
    np.testing.assert_allclose(drawn.min(axis=0), -drawn.max(axis=0), atol=1e-9)


@pytest.mark.parametrize(("scale", "offset"), PLACES)
def test_pictures_do_not_depend_on_scale_and_offset(plain, scale, offset):
    for there, here in zip(pictures(document(moved(scale, offset))), plain, strict=True):
        assert abs(there - here).mean() < 0.5


@pytest.mark.parametrize(("scale", "offset"), PLACES[2:4])
def test_overlays_and_clicks_are_on_the_surface(scale, offset, tmp_path):
    save_project(tmp_path / "egg.abfm", document(moved(scale, offset)), {})
    with Driver(str(tmp_path / "egg.abfm"), size=(640, 480)) as gui:
        gui.session.editor.set_view("look", arrows=True)
        scene, surface = gui.window.scene, gui.session.surface()
        vertices = surface.mesh.vertices
        vertex = int(np.argmax(vertices @ surface.front.direction))
        point = scene.nearest("advected", vertices[vertex]).point
        gui.session.editor.change("place a point", lines=(point,))
        structures = scene.overlays.structures
        gui.wait(lambda _: {name for _, name, _ in structures()} == {"arrows", "flow lines"})
        gui.frames(3)
        assert {surface for surface, *_ in scene.overlays.structures()} == {"advected"}
        x, y, _ = scene.projected("source", vertices[vertex])[0]
        hit = scene.pick((x, y))
        assert hit is not None
        assert hit.surface == "source"
        assert np.linalg.norm(vertices[hit.vertex] - vertices[vertex]) <= 0.4 * scale
        assert gui.session.view.viewpoint is None
        gui.input.drag((x, y), (x + 30, y + 10))
        look = gui.session.view.viewpoint
        assert look is not None
        gui.frames(5)
        assert gui.session.view.viewpoint is look


@given(faces=st.integers(4, 10**7), scale=st.floats(1, 10_000), more=st.floats(1, 100))
def test_wireframe_is_thinner_for_smaller_faces(faces, scale, more):
    assert 0 < edge_width(faces, scale) <= edge_width(faces, more * scale) <= 1
    assert edge_width(round(more * faces), scale) <= edge_width(faces, scale)


def test_edges_of_one_length_have_one_width():
    assert edge_width(4 * 500, 200.0) == pytest.approx(edge_width(500, 100.0))
    assert edge_width(500, 5000.0) == 1


def test_inverted_surface_is_drawn_in_front():
    sphere = icosphere(2)
    assert back_faces(sphere) == "cull"
    assert back_faces(TriangleMesh(sphere.vertices, sphere.faces[:, ::-1])) == "identical"
    assert back_faces(disc(3)) == "identical"


@pytest.mark.parametrize("mesh", [icosphere(3), open_cylinder(40, 6)])
def test_smooth_mesh_is_not_split(mesh):
    drawn = drawn_mesh(mesh)
    np.testing.assert_array_equal(drawn.origin, np.arange(len(mesh.vertices)))
    np.testing.assert_array_equal(drawn.faces, mesh.faces)
    assert drawn_mesh(mesh) is drawn


def test_cube_has_six_sides():
    shape = trimesh.creation.box().subdivide().subdivide()
    mesh = TriangleMesh(shape.vertices, shape.faces)
    drawn = drawn_mesh(mesh)
    np.testing.assert_array_equal(drawn.origin[drawn.faces], mesh.faces)
    # 3 at corners, 2 on edges, 1 inside sides
    sides = (np.abs(np.abs(mesh.vertices) - 0.5) < 1e-9).sum(axis=1)
    np.testing.assert_array_equal(np.bincount(drawn.origin), sides)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    normals = np.cross(b - a, c - a)
    for vertex in range(len(drawn.origin)):
        around = normals[(drawn.faces == vertex).any(axis=1)]
        assert np.linalg.matrix_rank(around, tol=1e-6) == 1
    np.testing.assert_array_equal(drawn.values(mesh.vertices), mesh.vertices[drawn.origin])
    np.testing.assert_array_equal(drawn_mesh(icosphere(1)).values(np.arange(42)), np.arange(42))


def test_bends_of_a_coarse_body_are_not_creases():
    body = load_mesh(asset_path("human_A.off"))
    assert len(drawn_mesh(body).origin) == len(body.vertices)
    part = load_mesh(asset_path("fandisk.off"))
    assert len(part.vertices) < len(drawn_mesh(part).origin) < 1.2 * len(part.vertices)


def sheet(n, height):
    """Return a square from -1 to 1 of n x n cells, with a height over x and y."""
    x, y = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1), indexing="ij")
    a = np.add.outer(np.arange(n) * (n + 1), np.arange(n)).ravel()
    b, c, d = a + n + 1, a + n + 2, a + 1
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return TriangleMesh(np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3), faces)


def test_end_of_a_crease_is_not_split():
    # a valley begins in the middle of the sheet
    mesh = sheet(20, lambda x, y: np.maximum(x, 0) ** 2 * np.abs(y) * 2)
    twice = np.flatnonzero(np.bincount(drawn_mesh(mesh).origin) > 1)
    assert len(twice) > 3
    np.testing.assert_allclose(mesh.vertices[twice, 1], 0, atol=1e-12)
    assert mesh.vertices[twice, 0].min() > 0


@pytest.mark.parametrize("degrees", [15, 30, 60])
def test_half_sharp_edges_of_planes_are_creases(degrees):
    mesh = sheet(8, lambda x, y: np.tan(np.radians(degrees)) * np.maximum(x, 0))
    split = np.flatnonzero(np.bincount(drawn_mesh(mesh).origin) > 1)
    expected = np.flatnonzero(mesh.vertices[:, 0] == 0) if degrees > 20 else []
    np.testing.assert_array_equal(split, expected)


@pytest.mark.parametrize("aspect", [None, 0.4, 3.0])
def test_camera_fits_the_surface(aspect):
    vertices = ellipsoid(3, 2, 1, 0.3).vertices + np.array([5, -3, 1])
    front = Front((0.6, 0.0, 0.8), (0.0, 1.0, 0.0))
    camera = fitted(vertices, front, aspect, angle=18.0, margin=0.0)
    backward = np.subtract(camera.position, camera.target)
    np.testing.assert_allclose(backward / np.linalg.norm(backward), front.direction)
    # in a picture of half height 1
    x, y, z = camera.front.axes @ (vertices - camera.position).T
    x, y = np.abs([x, y]) / -z / np.tan(np.radians(camera.angle / 2))
    assert max(x.max() / camera.aspect, y.max()) == pytest.approx(1)
    if aspect is None:
        assert min(x.max() / camera.aspect, y.max()) > 0.8
