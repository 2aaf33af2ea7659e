"""Mesh files are read in the order of the file, and polygons are split into triangles."""

import struct

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from abfm.mesh.readers import contents as readers
from abfm.mesh.readers.contents import split_polygons
from tests.mesh_writers import (
    STL_WRITERS,
    WRITERS,
    exported,
    freesurfer_bytes,
    off_text,
    ply_bytes,
    write,
)
from tests.messages import check_message, raises
from tests.shapes import icosphere, open_cylinder, square, tetrahedron, torus

shapes = st.sampled_from([icosphere(1), torus(6, 5), square(3), open_cylinder(5, 2)])


@pytest.mark.parametrize("name", WRITERS)
@given(shape=shapes, seed=st.integers(0, 2**32 - 1), scale=st.floats(1, 1e3))
@settings(max_examples=15)
def test_vertices_and_faces_have_the_order_of_the_file(folder, name, shape, seed, scale):
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
    (message,) = mesh.messages
    check_message(message, 3 * len(shape.faces), len(shape.vertices))


@pytest.mark.parametrize("name", [name for name in WRITERS if not name.endswith("glb")])
def test_unused_vertices_are_numbered(tmp_path, name):
    shape = tetrahedron()
    vertices = np.insert(shape.vertices, [1, 4], 9.0, axis=0)
    faces = np.array([0, 2, 3, 4])[shape.faces]
    mesh = load_mesh(write(tmp_path, name, WRITERS[name][0](vertices, faces)))
    assert mesh.vertex_ids.tolist() == [0, 2, 3, 4]
    assert mesh.file_vertex_count == 6
    (message,) = mesh.messages
    check_message(message, 2, 1)


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
def test_other_contents_are_ignored(tmp_path, name):
    mesh = load_mesh(write(tmp_path, name, HAND_MADE[name]))
    assert mesh.vertex_ids.tolist() == ([1, 2, 3, 4] if name == "a.obj" else [0, 1, 2, 3])
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    assert mesh.faces.tolist() == [[0, 1, 2], [1, 3, 2]]


@pytest.mark.parametrize("kind", ["obj", "off", "ascii", "binary_little_endian"])
def test_polygons_are_split_in_the_order_of_the_file(tmp_path, kind):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 1]])
    polygons = [[0, 1, 2, 3], [1, 4, 2]]
    if kind == "obj":
        lines = [f"v {x} {y} {z}" for x, y, z in points]
        lines += ["f " + " ".join(str(i + 1) for i in polygon) for polygon in polygons]
    else:
        lines = ["OFF", "5 2 0", *(f"{x} {y} {z}" for x, y, z in points)]
        lines += [" ".join(map(str, [len(polygon), *polygon])) for polygon in polygons]
    content = "\n".join(lines) if len(kind) == 3 else ply_bytes(points, polygons, kind)
    mesh = load_mesh(write(tmp_path, f"a.{kind if len(kind) == 3 else 'ply'}", content))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3], [1, 4, 2]]
    (message,) = mesh.messages
    check_message(message, 1)


def test_gltf_seams_are_closed(tmp_path):
    """Two halves of a sphere with separate faces, one moved by its node, become one surface."""
    sphere = icosphere(1)
    scene = trimesh.Scene()
    for half, shift in ((sphere.faces[:37], 0.0), (sphere.faces[37:], 8.0)):
        corners = sphere.vertices[half].reshape(-1, 3) - [shift, 0, 0]
        # on a grid that is exact in single precision, so that shifted positions do not differ
        corners = np.round(corners.astype(np.float32) * 2**10) / 2**10
        part = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
        placed = trimesh.transformations.translation_matrix([shift, 0, 0])
        scene.add_geometry(part, transform=placed)
    scene.export(tmp_path / "a.glb")
    mesh = load_mesh(tmp_path / "a.glb")
    assert mesh.is_closed
    assert len(mesh.vertices) == mesh.file_vertex_count == 42
    check_message(mesh.messages[0], 240, 42)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), sphere.vertices.max(axis=0), atol=1e-3)


def test_other_hemisphere_is_refused(tmp_path):
    mesh = tetrahedron()
    path = write(tmp_path, "rh.white", freesurfer_bytes(mesh.vertices, mesh.faces))
    assert load_mesh(path, hemisphere="R").structure == "CortexRight"
    with raises(MeshError, "rh.white", "right", "left", "--hemisphere"):
        load_mesh(path, hemisphere="L")


def test_largest_component_is_read_only_on_request(tmp_path):
    small, sphere = tetrahedron(), icosphere(1, radius=3)
    vertices = np.concatenate([small.vertices + 20, sphere.vertices])
    faces = np.concatenate([small.faces, sphere.faces + 4])
    path = write(tmp_path, "a.off", off_text(vertices, faces))
    with raises(MeshError, "a.off", 2, "--largest-component"):
        load_mesh(path)
    mesh = load_mesh(path, largest_component=True)
    assert mesh.vertex_ids.tolist() == list(range(4, 46))
    assert mesh.local_vertex(4) == 0


HEADER = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
"""
TEXT = HEADER + b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"


def ply_text(old, new):
    assert old in TEXT
    return TEXT.replace(old, new)


def binary(end, order="little", name=b"end_header"):
    """Return a binary file whose data begins with the byte of a line feed."""
    header = HEADER.replace(b"ascii", f"binary_{order}_endian".encode()).replace(b"\n", end)
    header = header.replace(b"end_header", name).replace(b"float", b"double")
    sign = "<" if order == "little" else ">"
    first = struct.unpack(f"{sign}d", b"\x0a" * 8)[0]
    rows = [struct.pack(f"{sign}3d", *row) for row in ((first, 0, 0), (1, 0, 0), (0, 1, 0))]
    return header + b"".join(rows) + struct.pack(f"{sign}B3i", 3, 0, 1, 2)


ACCEPTED_PLY = {
    "CRLF": ply_text(b"\n", b"\r\n"),
    "CR": ply_text(b"\n", b"\r"),
    "binary": binary(b"\n"),
    "binary CRLF": binary(b"\r\n"),
    "binary CR": binary(b"\r", "big"),
    "words after the end": ply_text(b"end_header", b"end_header made by hand"),
    "blanks after the end": binary(b"\n", name=b"end_header  "),
    "a comment that names the end": ply_text(b"1.0\n", b"1.0\ncomment end_header follows\n"),
    "a comment of the end": binary(b"\n").replace(b"1.0", b"1.0\ncomment\ncomment end_header"),
    "comments in the body": ply_text(b"0 0 0\n", b"comment a\n0 0 0\n").replace(
        b"0 1 0\n", b"comment 9 9 9\n0 1 0\n"
    )
    + b"comment\n",
    "a blank before": ply_text(b"element face 1", b"  element  face 1"),
    "lists elsewhere": ply_text(b"element face", b"property list uchar float w\nelement face")
    .replace(b"0 0 0\n", b"0 0 0 0\n", 1)
    .replace(b"1 0 0\n0 1 0\n", b"1 0 0 2 7 7\n0 1 0 1 5\n"),
    "one without columns": ply_text(b"element f", b"element nothing 1000000000000\nelement f"),
}


@pytest.mark.parametrize("content", ACCEPTED_PLY.values(), ids=ACCEPTED_PLY)
def test_ply_variants_are_read(tmp_path, content):
    mesh = load_mesh(write(tmp_path, "a.ply", content))
    assert mesh.faces.tolist() == [[0, 1, 2]]
    assert mesh.vertices[1:].tolist() == [[1, 0, 0], [0, 1, 0]]


BIG = ply_bytes(tetrahedron().vertices, tetrahedron().faces.tolist(), "binary_big_endian")
REFUSED_PLY = {
    "float indices": (ply_text(b"uchar int", b"uchar float"), ("float",)),
    "double indices": (BIG.replace(b"uchar int", b"uchar float"), ("float",)),
    "float lengths": (ply_text(b"uchar", b"float"), ("float",)),
    "fractional index": (ply_text(b"3 0 1 2", b"3 0 1 1.5"), ("1.5",)),
    "no list": (ply_text(b"list uchar int", b"int"), ()),
    "x is a list": (ply_text(b"float x", b"list uchar float x"), ()),
    "length -3": (ply_text(b"uchar", b"char").replace(b"\n3", b"\n-3"), (-3,)),
    "too long a list": (ply_text(b"3 0 1 2", b"200 0 1 2"), ()),
    "a list beyond all bytes": (
        BIG.replace(b"element face", b"property list uint64 char q\nelement face").replace(
            b"end_header\n", b"end_header\n" + bytes(24) + b"\xff" * 8
        ),
        (),
    ),
    "too many rows": (ply_text(b"face 1", b"face 1000000000000"), ()),
    "no data": (b"ply\nformat ascii 1.0\nelement vertex %d\nend_header\n" % 10**12, ()),
    "negative rows": (ply_text(b"vertex 3", b"vertex -3"), (-3,)),
    "two corners": (ply_text(b"3 0 1 2", b"2 0 1"), (0, 2)),
    "a large index": (ply_text(b"3 0 1 2", b"3 0 1 99999999999999999999"), ("1e+20", 16)),
    "no end": (ply_text(b"end_header", b"comment end_header"), ("PLY",)),
    "a long word": (ply_text(b"ascii", b"a" * 10**5), ("a" * 40,)),
    "no format": (ply_text(b"format ascii 1.0\n", b""), ("missing",)),
    "an unknown type of a list": (ply_text(b"uchar int", b"uchar integer"), ("integer",)),
}


@pytest.mark.parametrize(("content", "named"), REFUSED_PLY.values(), ids=REFUSED_PLY)
def test_invalid_ply_is_refused(tmp_path, content, named):
    with raises(MeshError, *named) as caught:
        load_mesh(write(tmp_path, "a.ply", content))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


seeds = st.integers(0, 2**32 - 1)


def split(points, *rows):
    sizes = np.array([len(row) for row in rows])
    corners = np.concatenate(rows).astype(np.int64)
    return split_polygons(np.asarray(points, dtype=np.float64), sizes, corners)


def area_vectors(points, faces):
    a, b, c = np.moveaxis(points[faces], 1, 0)
    return np.cross(b - a, c - a) / 2


def star(random, count):
    """Return a jagged polygon (n, 2) around the origin, counterclockwise from any corner."""
    angle = 2 * np.pi / count * (np.arange(count) + random.uniform(0, 0.9, count))
    radius = random.uniform(0.1, 1, count)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return np.roll(points, random.integers(count), axis=0)


def untangled(random, count):
    """Return a simple polygon (n, 2) through random points; crossing sides are exchanged."""
    points = random.uniform(-1, 1, (count, 2))
    changed = True
    while changed:
        changed = False
        for i in range(count - 1):
            for j in range(i + 2, count - (i == 0)):
                a, b, c, d = points[i], points[i + 1], points[j], points[(j + 1) % count]
                now, then = (((a, b), (c, d)), ((a, c), (b, d)))
                lengths = [sum(np.linalg.norm(p - q) for p, q in pairs) for pairs in (now, then)]
                if lengths[1] < lengths[0] - 1e-12:
                    points[i + 1 : j + 1] = points[i + 1 : j + 1][::-1].copy()
                    changed = True
    x, y = points.T
    return points if x @ np.roll(y, -1) > y @ np.roll(x, -1) else points[::-1].copy()


def in_space(random, plane):
    frame, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return plane @ frame[:2] + random.normal(size=3)


@pytest.mark.parametrize("make", [star, untangled])
@given(seed=seeds, count=st.integers(4, 25))
def test_triangles_cover_a_simple_polygon_once(make, seed, count):
    random = np.random.default_rng(seed)
    plane = make(random, count)
    points = in_space(random, plane)
    contents = split(points, np.arange(count))
    areas = area_vectors(points, contents.faces)
    area = np.linalg.norm(areas.sum(axis=0))
    x, y = plane.T
    assert len(contents.faces) == count - 2
    assert (areas @ (areas.sum(axis=0) / area)).min() > -1e-12
    assert area == pytest.approx((x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)
    np.testing.assert_allclose(np.linalg.norm(areas, axis=1).sum(), area, rtol=1e-9)
    assert len(contents.messages) == 1


@given(seed=seeds, count=st.integers(4, 40))
def test_convex_polygons_are_split_into_fans(seed, count):
    random = np.random.default_rng(seed)
    angle = np.cumsum(random.uniform(0.2, 1, count))
    angle *= 2 * np.pi / (angle[-1] + 0.2)
    points = in_space(random, np.stack([np.cos(angle), np.sin(angle)], axis=1))
    fan = [[0, k, k + 1] for k in range(1, count - 1)]
    assert split(points, np.arange(count)).faces.tolist() == fan


@pytest.mark.parametrize("shift", range(4))
def test_concave_quad_is_split_at_its_dent(shift):
    dart = np.array([[0.0, 0, 0], [3, -1, 0], [1, 0, 0], [3, 1, 0]])  # corner 2 is the dent
    row = np.roll(np.arange(4), shift)
    faces = split(dart, row).faces
    assert all({0, 2} <= set(face) for face in faces.tolist())
    assert np.linalg.norm(area_vectors(dart, faces), axis=1).sum() == pytest.approx(1)


def test_straight_corner_makes_no_flat_triangle():
    """Corners 0, 1 and 2 lie on a line, so the triangles are not a fan around corner 0."""
    points = [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]]
    areas = np.linalg.norm(area_vectors(np.array(points), split(points, range(5)).faces), axis=1)
    assert areas.min() > 0.1
    assert areas.sum() == pytest.approx(4)


def test_other_polygons_keep_their_fans():
    points = [[0.0, 0, 0], [3, -1, 0], [1, 0, 0], [3, 1, 0], [4, 0, 0], [4, 4, 0]]
    contents = split(points, [0, 4, 5], [1, 2, 3, 0], [2, 1, 4, 3], [3, 4, 5])
    assert contents.faces[0].tolist() == [0, 4, 5]
    assert {0, 2} <= set(contents.faces[1]) & set(contents.faces[2])
    assert contents.faces[3:].tolist() == [[2, 1, 4], [2, 4, 3], [3, 4, 5]]


def test_self_intersecting_polygon_is_a_fan():
    """A pentagram, which winds twice around its centre, becomes a fan with a warning."""
    angle = 4 * np.pi * np.arange(5) / 5 + 0.1
    points = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    contents = split(points, range(5))
    assert contents.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4]]
    assert contents.messages[1].startswith("warning: ")
    check_message(contents.messages[1], 1, 0)


@pytest.mark.parametrize("bound", ["_CORNERS_MAX", "_WORK_MAX"])
def test_expensive_polygons_are_refused(tmp_path, monkeypatch, bound):
    monkeypatch.setattr(readers, bound, 9)
    monkeypatch.setattr(readers, "_WORK_PER_CORNER", 1)
    points = star(np.random.default_rng(0), 10).tolist()
    lines = ["OFF 10 1 0", *(f"{x!r} {y!r} 0" for x, y in points), "10 0 1 2 3 4 5 6 7 8 9"]
    with raises(MeshError, 10):
        load_mesh(write(tmp_path, "a.off", "\n".join(lines)))
