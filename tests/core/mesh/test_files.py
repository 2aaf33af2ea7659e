"""Reading mesh files: what is in them comes out in their own order."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from tests.mesh_writers import STL_WRITERS, WRITERS, exported, off_text, ply_bytes, write
from tests.shapes import icosphere, open_cylinder, square, tetrahedron, torus

QUAD_AND_TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 1]])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("meshes")


shapes = st.sampled_from([icosphere(1), torus(6, 5), square(3), open_cylinder(5, 2)])


@pytest.mark.parametrize("name", WRITERS)
@given(shape=shapes, seed=st.integers(0, 2**32 - 1), scale=st.floats(1, 1e3))
@settings(max_examples=15)
def test_vertices_and_faces_come_back_in_order(folder, name, shape, seed, scale):
    noise = np.random.default_rng(seed).normal(size=shape.vertices.shape)
    vertices = scale * (shape.vertices + 0.01 * noise)
    content, precision = WRITERS[name]
    mesh = load_mesh(write(folder, name, content(vertices, shape.faces)))
    np.testing.assert_array_equal(mesh.faces, shape.faces)
    np.testing.assert_allclose(mesh.vertices, vertices, rtol=0, atol=4 * scale * precision)
    assert mesh.messages == ()


@pytest.mark.parametrize("name", STL_WRITERS)
@given(shape=shapes, scale=st.floats(1e-3, 1e3))
@settings(max_examples=15)
def test_stl_is_merged_in_order_of_first_appearance(folder, name, shape, scale):
    content = exported(shape.vertices * scale, shape.faces, STL_WRITERS[name])
    mesh = load_mesh(write(folder, name, content))
    _, first = np.unique(shape.faces, return_index=True)
    order = shape.faces.ravel()[np.sort(first)]
    expected = scale * shape.vertices[order]
    np.testing.assert_allclose(mesh.vertices, expected, rtol=0, atol=4e-7 * scale)
    np.testing.assert_array_equal(order[mesh.faces], shape.faces)
    assert mesh.file_vertex_count == len(shape.vertices)
    merged = f"{3 * len(shape.faces)} vertices were merged to {len(shape.vertices)} by position, "
    assert mesh.messages == (merged + "and are counted in order of first appearance",)


@pytest.mark.parametrize("name", [name for name in WRITERS if not name.endswith("glb")])
def test_unused_vertices_still_count(tmp_path, name):
    shape = tetrahedron()
    vertices = np.insert(shape.vertices, [1, 4], 9.0, axis=0)
    faces = np.array([0, 2, 3, 4])[shape.faces]
    mesh = load_mesh(write(tmp_path, name, WRITERS[name][0](vertices, faces)))
    assert mesh.vertex_ids.tolist() == [0, 2, 3, 4]
    assert mesh.file_vertex_count == 6
    assert mesh.messages == ("2 vertices that no face uses were dropped (for example vertex 1)",)


HAND_MADE = {
    "a.obj": """# a comment
mtllib missing.mtl
o thing
v 9 9 9
v 0 0 0 0.5 0.5 0.5  # with colours
v 1.0e0 0 0
v 0 1 0
vt 0 0
vt 1 1
vt 0.5 0.5
vn 0 0 1
g first
usemtl red
f 2/1/1 3/2/1 4/3/1
v 1 1 0
usemtl blue
s off
f -3/2 \\
  -1/1 -2/3
""".replace("\n", "\r\n"),
    "a.off": """# made by hand

COFF 4 2 0  # counts beside the keyword

0 0 0 255 0 0 255
1 0 0 0 255 0 255

# between
0 1 0 0 0 255 255
1 1 0 0 0 0 255
3 0 1 2 0.5 0.5 0.5
3  1 3 2
""",
    "a.stl": """solid vertex caf\xe9
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1.0E+0 0 0
 VERTEX 0 1 0
endloop
endfacet
endsolid
solid second
facet normal 0 0 1
outer loop
vertex 1 0 0
vertex 1 1 0
vertex 0 1 -0.0
endloop
endfacet
endsolid second
""".encode("latin-1"),
    "a.ply": """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float s
property float t
element face 2
property list uchar uint vertex_index
property list uchar float texcoord
element edge 1
property int vertex1
property int vertex2
end_header
0 0 0 0 0
1 0 0 0 1
0 1 0 1 1
1 1 0 1 0
3 0 1 2 6 0 0 0 1 1 1
3 1 3 2 0
0 1
""",
}


@pytest.mark.parametrize("name", HAND_MADE)
def test_what_else_a_file_may_have_leaves_vertices_and_faces_alone(tmp_path, name):
    """Comments, colours, blank lines, textures, groups, materials, several solids, other elements:
    the order of the file survives.
    """
    mesh = load_mesh(write(tmp_path, name, HAND_MADE[name]))
    assert mesh.vertex_ids.tolist() == ([1, 2, 3, 4] if name == "a.obj" else [0, 1, 2, 3])
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]


@pytest.mark.parametrize("kind", ["obj", "off", "ascii", "binary_little_endian"])
def test_polygons_are_split_in_the_order_of_the_file(tmp_path, kind):
    points, polygons = QUAD_AND_TRIANGLE, [[0, 1, 2, 3], [1, 4, 2]]
    if kind == "obj":
        lines = [f"v {x} {y} {z}" for x, y, z in points]
        lines += ["f " + " ".join(str(i + 1) for i in polygon) for polygon in polygons]
    else:
        lines = ["OFF", "5 2 0", *(f"{x} {y} {z}" for x, y, z in points)]
        lines += [" ".join(map(str, [len(polygon), *polygon])) for polygon in polygons]
    content = "\n".join(lines) if len(kind) == 3 else ply_bytes(points, polygons, kind)
    mesh = load_mesh(write(tmp_path, f"a.{kind if len(kind) == 3 else 'ply'}", content))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [1, 4, 2]]
    assert mesh.messages == ("polygons with more than three corners were split into triangles: 1",)


def test_gltf_scene_is_joined_where_seams_split_it(tmp_path):
    """Two halves of a sphere, one moved by its node, with every vertex repeated for every face."""
    sphere = icosphere(1)
    scene = trimesh.Scene()
    for half, shift in ((sphere.faces[:37], 0.0), (sphere.faces[37:], 8.0)):
        corners = sphere.vertices[half].reshape(-1, 3) - [shift, 0, 0]
        # on a grid that single precision holds exactly: shifted positions agree up to rounding only
        corners = np.round(corners.astype(np.float32) * 2**10) / 2**10
        part = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
        placed = trimesh.transformations.translation_matrix([shift, 0, 0])
        scene.add_geometry(part, transform=placed)
    scene.export(tmp_path / "a.glb")
    mesh = load_mesh(tmp_path / "a.glb")
    assert mesh.is_closed
    assert len(mesh.vertices) == mesh.file_vertex_count == 42
    assert mesh.messages[0].startswith("240 vertices were merged to 42 by position")
    np.testing.assert_allclose(mesh.vertices.max(axis=0), sphere.vertices.max(axis=0), atol=1e-3)


def test_largest_component_of_a_file(tmp_path):
    small, sphere = tetrahedron(), icosphere(1, radius=3)
    vertices = np.concatenate([small.vertices + 20, sphere.vertices])
    faces = np.concatenate([small.faces, sphere.faces + 4])
    path = write(tmp_path, "a.off", off_text(vertices, faces))
    told = r"a\.off: the surface has 2 components.*--largest-component"
    with pytest.raises(MeshError, match=told):
        load_mesh(path)
    mesh = load_mesh(path, largest_component=True)
    assert mesh.vertex_ids.tolist() == list(range(4, 46))
    assert mesh.local_vertex(4) == 0
