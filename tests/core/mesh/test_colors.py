"""Textures and colours of OBJ, glTF and PLY files are assigned to the faces of surfaces."""

import io
import json
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from abfm import MeshError, TriangleMesh, load_mesh
from abfm.mesh.colors import load_colors
from abfm.mesh.readers import references
from abfm.mesh.readers.gltf_colors import colored_gltf
from abfm.reading import open_file
from tests.core.mesh.heavy_meshes import TRIANGLE, glb, gltf_header
from tests.core.surfaces import renumbered
from tests.mesh_writers import off_file, write
from tests.messages import raises
from tests.shapes import icosphere, tetrahedron, torus

MESH = torus(9, 6)
PIXELS = np.random.default_rng(0).integers(0, 256, (4, 5, 3)).astype(np.uint8)


def coordinates(mesh, seed=1):
    """Return texture coordinates of corners, shared at vertices except at a seam."""
    separate = np.random.default_rng(seed).uniform(-0.5, 1.5, (len(mesh.faces), 3, 2))
    shared = np.random.default_rng(seed).uniform(0, 1, (len(mesh.vertices), 2))[mesh.faces]
    has_seam = np.arange(len(mesh.faces)) % 3 == 0
    return np.where(has_seam[:, None, None], separate, shared)


def image():
    data = io.BytesIO()
    Image.fromarray(PIXELS).save(data, "PNG")
    return data.getvalue()


def obj(mesh, places):
    lines = ["mtllib skin.mtl", "usemtl a skin"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in mesh.vertices.tolist()]
    lines += [f"vt {u!r} {v!r}" for u, v in places.reshape(-1, 2).tolist()]
    corners = (mesh.faces + 1).tolist()
    lines += [
        "f " + " ".join(f"{vertex}/{3 * face + k + 1}/1" for k, vertex in enumerate(row))
        for face, row in enumerate(corners)
    ]
    return "\n".join(lines)


def as_obj(folder, mesh, places):
    write(folder, "skin.mtl", b"newmtl a skin\nKd 0 0 0\nmap_Kd my skin.png\n")
    write(folder, "my skin.png", image())
    return write(folder, "a.obj", obj(mesh, places).encode())


def as_trimesh(mesh, places, kind):
    """Return a trimesh mesh, split where texture coordinates differ, like exporters do."""
    rows = np.column_stack([mesh.faces.ravel(), places.reshape(-1, 2)])
    kept, numbers = np.unique(rows, axis=0, return_inverse=True)
    picture = Image.fromarray(PIXELS)
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture)
    if kind == "obj":
        material = trimesh.visual.material.SimpleMaterial(image=picture)
    visual = trimesh.visual.TextureVisuals(uv=kept[:, 1:], material=material)
    points, faces = mesh.vertices[kept[:, 0].astype(int)], numbers.reshape(-1, 3)
    return trimesh.Trimesh(points, faces, visual=visual, process=False)


def as_trimesh_obj(folder, mesh, places):
    made = as_trimesh(mesh, places, "obj")
    text, files = trimesh.exchange.obj.export_obj(made, return_texture=True)
    for name, data in files.items():
        write(folder, name, data)
    return write(folder, "b.obj", text.encode())


def as_trimesh_glb(folder, mesh, places):
    return write(folder, "b.glb", as_trimesh(mesh, places, "glb").export(file_type="glb"))


WRITERS = [as_obj, as_trimesh_obj, as_trimesh_glb]


@pytest.mark.parametrize("writer", WRITERS)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_texture_coordinates_follow_renumbered_vertices(folder, writer, seed):
    """Coordinates are found in files that split and number vertices differently."""
    places = coordinates(MESH)
    path = writer(folder, MESH, places)
    mesh, _, faces = renumbered(MESH, seed)
    found = load_colors(path, mesh)
    first = np.argmax(
        (mesh.vertices[mesh.faces[:, 0]][:, None] == MESH.vertices[MESH.faces[faces]]).all(axis=2),
        axis=1,
    )
    order = (first[:, None] + np.arange(3)) % 3
    assert_allclose(found.coordinates, places[faces[:, None], order], atol=2e-7)
    assert_array_equal(found.colors, 1)
    [material] = found.materials
    assert material.color == (1, 1, 1, 1)
    assert_array_equal(Image.open(io.BytesIO(material.image)).convert("RGB"), PIXELS)


@pytest.mark.parametrize("writer", [as_obj, as_trimesh_glb])
def test_colors_fit_the_surface_of_the_file(tmp_path, writer):
    path = writer(tmp_path, MESH, coordinates(MESH))
    mesh = load_mesh(path)
    assert len(mesh.vertices) == len(MESH.vertices)
    found, expected = load_colors(path, mesh), load_colors(path, MESH)
    assert found.coordinates.shape == (len(mesh.faces), 3, 2)
    assert_allclose(np.sort(found.coordinates, axis=None), np.sort(expected.coordinates, axis=None))


@pytest.mark.parametrize("moved", [1.0, 2.0])
def test_texture_coordinates_fit_a_merged_mesh(tmp_path, moved):
    """A file with a vertex for each corner fits the merged mesh, also by numbers alone."""
    corners = SimpleNamespace(
        vertices=MESH.vertices[MESH.faces.ravel()], faces=np.arange(MESH.faces.size).reshape(-1, 3)
    )
    path = as_obj(tmp_path, corners, coordinates(MESH))
    mesh = TriangleMesh(corners.vertices * [moved, 1, 1], corners.faces, merge=True)
    assert len(mesh.vertices) == len(MESH.vertices)
    assert_array_equal(load_colors(path, mesh).coordinates, coordinates(MESH))


def test_moved_surfaces_are_identified_by_numbers(tmp_path):
    """A moved surface is identified by vertex numbers; vertex 5 of the file has no face."""
    with_unused = SimpleNamespace(
        vertices=np.insert(MESH.vertices, 5, 9.0, axis=0), faces=MESH.faces + (MESH.faces >= 5)
    )
    path = as_obj(tmp_path, with_unused, coordinates(MESH))
    bent = TriangleMesh(with_unused.vertices * [3, 1, 2], with_unused.faces)
    assert_array_equal(load_colors(path, bent).coordinates, coordinates(MESH))


def test_colors_fit_a_repaired_mesh(tmp_path):
    two = np.concatenate([MESH.vertices, 0.2 * MESH.vertices + 5])
    faces = np.concatenate([MESH.faces, MESH.faces + len(MESH.vertices)])
    faces[::2] = faces[::2, [1, 0, 2]]
    places = np.random.default_rng(0).uniform(size=(len(faces), 3, 2))
    path = as_obj(tmp_path, SimpleNamespace(vertices=two, faces=faces), places)
    mesh = load_mesh(path, largest_component=True)
    found = load_colors(path, mesh).coordinates
    assert_array_equal(np.sort(found, axis=1), np.sort(places[: len(MESH.faces)], axis=1))
    x = two[faces[: len(MESH.faces)]][..., 0]  # corners in the order of the texture coordinates
    assert_array_equal(
        np.sort(mesh.vertices[mesh.faces][..., 0] + 10 * found[..., 0], axis=1),
        np.sort(x + 10 * places[: len(MESH.faces), :, 0], axis=1),
    )


SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def square():
    return TriangleMesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])


def test_obj_polygons_and_relative_numbers_are_read(tmp_path):
    write(tmp_path, "i.png", image())
    text = (
        f"# a square\n{SQUARE}vt 0 0\nvt 1 0\nvt 1 1 # third\nvt 0.5\nf 1/1 -3/-3 \\\n 3/3 4/-1\n"
    )
    path = write(tmp_path, "a.obj", text.encode())
    found = load_colors(path, square(), tmp_path / "i.png")
    assert found.coordinates.tolist() == [[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0.5, 0]]]


def test_mtl_materials_are_read(tmp_path):
    write(tmp_path, "i.png", image())
    mtl = "newmtl a\nKd 0.5 0.25 1\nd 0.5\nnewmtl b\nKd 0 0 0\nTr 0.25\nmap_Kd sub\\..\\i.png\n"
    (tmp_path / "sub").mkdir()
    write(tmp_path, "m.mtl", mtl.encode())
    text = f"mtllib m.mtl\n{SQUARE}vt 0 0\nusemtl b\nf 1/1 2/1 3/1\nusemtl a\nf 1 3 4\n"
    found = load_colors(write(tmp_path, "a.obj", text.encode()), square())
    image_of, plain = (found.materials[k] for k in found.owners)
    assert (image_of.image, image_of.color) == (image(), (1, 1, 1, 0.75))
    assert (plain.image, plain.color) == (None, (0.5, 0.25, 1, 0.5))
    assert np.isnan(found.coordinates[1]).all()


def test_vertex_colors_are_read(tmp_path):
    mesh = tetrahedron()
    colors = np.array([[255, 0, 51, 255], [0, 102, 255, 51], [204, 204, 204, 255], [1, 2, 3, 4]])
    expected = (colors / 255)[mesh.faces]
    made = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colors, process=False)
    for encoding in ("ascii", "binary"):
        data = trimesh.exchange.ply.export_ply(made, encoding=encoding)
        found = load_colors(write(tmp_path, "a.ply", data), mesh)
        assert_allclose(found.colors, expected)
    rows = zip(mesh.vertices.tolist(), (colors / 255).tolist(), strict=True)
    lines = [" ".join(map(str, ["v", *place, *color[:3]])) for place, color in rows]
    lines += [" ".join(map(str, ["f", *face])) for face in (mesh.faces + 1).tolist()]
    found = load_colors(write(tmp_path, "a.obj", "\n".join(lines).encode()), mesh)
    assert_allclose(found.colors[..., :3], expected[..., :3])
    path = write(tmp_path, "a.glb", made.export(file_type="glb"))
    linear = np.where(expected < 0.04045, expected / 12.92, ((expected + 0.055) / 1.055) ** 2.4)
    decoded = load_colors(path, mesh).colors
    back = np.where(decoded < 0.04045, decoded / 12.92, ((decoded + 0.055) / 1.055) ** 2.4)
    assert_allclose(back[..., :3], expected[..., :3], atol=1e-6)
    assert_allclose(decoded[..., 3], expected[..., 3])
    assert (linear <= expected).all()


def triangle(tmp_path, material=None, texture=None, attributes=None, **changes):
    """Return the colours of a glTF triangle with a texture, whose parts can be replaced."""
    places = np.array([[0, 0], [1, 0], [0.25, 0.75]], dtype="<f4").tobytes()
    data = TRIANGLE + places + image()
    accessor = {"bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC2"}
    header = gltf_header()
    views = [{"byteLength": 24, "byteOffset": 48}, {"byteLength": len(data) - 72, "byteOffset": 72}]
    named = {"POSITION": 0, "TEXCOORD_0": 2} if attributes is None else attributes
    header |= {
        "accessors": [*header["accessors"], accessor],
        "bufferViews": [*header["bufferViews"], *({"buffer": 0} | view for view in views)],
        "buffers": [{"byteLength": len(data)}],
        "meshes": [{"primitives": [{"attributes": named, "indices": 1, "material": 0}]}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0} | (texture or {})}}
            | (material or {})
        ],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 3}],
    }
    path = write(tmp_path, "a.glb", glb(header | changes, data))
    return load_colors(path, TriangleMesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]))


def test_gltf_texture_coordinates_and_samplers_are_read(tmp_path):
    found = triangle(
        tmp_path,
        {"alphaMode": "MASK"},
        textures=[{"source": 0, "sampler": 1}],
        samplers=[{}, {"wrapS": 33071, "wrapT": 33648}],
    )
    assert found.coordinates.tolist() == [[[0, 1], [1, 1], [0.25, 0.25]]]
    [material] = found.materials
    assert material == (image(), (1, 1, 1, 1), ("clamp", "mirror"), "MASK")


def test_gltf_texture_transforms_and_factors_are_applied(tmp_path):
    write(tmp_path, "i i.png", image())
    transform = {"KHR_texture_transform": {"scale": [2, 0.5], "offset": [0.25, 0]}}
    base = {"baseColorTexture": {"index": 0, "extensions": transform}}
    found = triangle(
        tmp_path,
        {"pbrMetallicRoughness": base | {"baseColorFactor": [1, 0.2140411, 0, 0.5]}},
        images=[{"uri": "i%20i.png"}],
    )
    assert_allclose(found.coordinates, [[[0.25, 1], [2.25, 1], [0.75, 0.625]]])
    assert_allclose(found.materials[0].color, [1, 0.5, 0, 0.5], atol=1e-6)
    assert found.materials[0].image == image()


def test_mirrored_gltf_node_keeps_coordinates(tmp_path):
    header = {"nodes": [{"mesh": 0, "scale": [1, 1, -1]}]}
    assert triangle(tmp_path, **header).coordinates.tolist() == [[[0, 1], [1, 1], [0.25, 0.25]]]


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"texture": {"index": 1}}, ("textures[1]", 1)),
        ({"textures": [{}]}, ("PNG", "JPEG", "WebP")),
        ({"textures": [{"source": 3}]}, ("images[3]",)),
        ({"textures": [{"source": 0, "sampler": 0}], "samplers": [{"wrapS": 7}]}, ()),
        ({"attributes": {"POSITION": 0}}, (1,)),
        ({"attributes": {"POSITION": 0, "TEXCOORD_0": 0}}, (0,)),
        ({"attributes": {"POSITION": 0, "TEXCOORD_0": 9}}, ("accessors[9]",)),
        ({"texture": {"texCoord": 1}}, ()),
        ({"texture": {"index": "0"}}, ()),
        ({"images": [{"bufferView": 9}]}, ("bufferViews[9]",)),
        ({"images": [{"uri": "missing.png"}]}, ("missing.png",)),
        ({"images": [{"uri": "data:image/png;base64,A"}]}, (0, "base64")),
        ({"texture": {"extensions": {"KHR_texture_transform": {"rotation": 1.0}}}}, ()),
        ({"texture": {"extensions": {"KHR_texture_transform": {"scale": [1]}}}}, (2,)),
        ({"texture": {"extensions": {"KHR_texture_transform": {"scale": [1e999, 1]}}}}, ()),
        ({"materials": [{"pbrMetallicRoughness": {"baseColorFactor": [1]}}]}, (4,)),
        ({"materials": [{}]}, ()),
        ({"materials": 3}, ()),
    ],
)
def test_invalid_gltf_colors_are_refused(tmp_path, changes, named):
    with raises(MeshError, *named) as refused:
        triangle(tmp_path, **changes)
    assert str(refused.value).startswith(f"{tmp_path}/a.glb: ")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("mtllib no.mtl\n{s}f 1 2 3\nf 1 3 4", ("no.mtl",)),
        ("{s}f 1/1 2/1 3/1\nf 1 3 4", (1, 0)),
        ("{s}vt 0 0\nf 1/1 2/0 3/1\nf 1 3 4", (1,)),
        ("{s}vt 0 0\nf 1/1 2/-2 3/1\nf 1 3 4", (-2, 1)),
        ("{s}vt 0 x\nf 1/1 2/1 3/1\nf 1 3 4", ("x",)),
        ("{s}f 1 2 3\nf 1 3 5", (4,)),
        ("{s}f 1 2 3\nf 1 3 4", ()),
        ("{s}f 1 2 3", (2, 1)),
        ("v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3", ()),
        ("mtllib o.mtl\n{s}f 1 2 3\nf 1 3 4", ("map_Kd",)),
        ("mtllib d.mtl\n{s}usemtl a\nvt 0 0\nf 1/1 2/1 3/1\nf 1 3 4", (1, 2)),
        ("", ()),
    ],
)
def test_invalid_obj_colors_are_refused(tmp_path, text, named):
    write(tmp_path, "i.png", image())
    write(tmp_path, "o.mtl", b"newmtl a\nmap_Kd -s 2 2 2 i.png\n")
    write(tmp_path, "d.mtl", b"newmtl a\nmap_Kd i.png\n")
    path = write(tmp_path, "a.obj", text.format(s=SQUARE).encode())
    with raises(MeshError, *named) as refused:
        load_colors(path, square())
    assert str(refused.value).startswith(str(path))


def test_other_formats_and_missing_files_are_refused(tmp_path):
    off_file(tmp_path / "a.off", MESH)
    for name, named in (("a.off", (".obj", ".glb", ".gltf", ".ply")), ("a.obj", ())):
        with raises(MeshError, *named):
            load_colors(tmp_path / name, square())
    path = as_obj(tmp_path, MESH, coordinates(MESH))
    with raises(MeshError, "no.png"):
        load_colors(path, MESH, tmp_path / "no.png")
    with raises(MeshError):
        load_colors(path, icosphere(1))


@given(data=st.data(), kind=st.sampled_from(["obj", "glb", "mtl", "ply"]))
@settings(max_examples=80)
def test_damaged_color_files_do_not_crash(folder, data, kind):
    mesh = tetrahedron()
    path = as_obj(folder, mesh, coordinates(mesh))
    damaged = path if kind == "obj" else folder / "skin.mtl"
    if kind in ("glb", "ply"):
        path = as_trimesh_glb(folder, mesh, coordinates(mesh))
        if kind == "ply":
            colors = np.full((4, 3), 7)
            made = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_colors=colors, process=False)
            path = write(folder, "a.ply", trimesh.exchange.ply.export_ply(made, encoding="ascii"))
        damaged = path
    content = bytearray(damaged.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        piece = data.draw(st.binary(max_size=3) | st.sampled_from([b"-1", b"1e999", b"/", b"\n"]))
        content[place : place + data.draw(st.integers(0, 3))] = piece
    damaged.write_bytes(bytes(content))
    try:
        found = load_colors(path, mesh)
    except MeshError:
        return
    assert found.coordinates.shape == (4, 3, 2)
    assert ((found.colors >= 0) & (found.colors <= 1)).all()
    assert found.owners.max() < len(found.materials)


def _obj_of(folder, name, mtl):
    """Write a surface whose material is in another file and refers to an image."""
    write(folder, "skin.mtl", mtl)
    write(folder, "my skin.png", image())
    return write(folder, "a.obj", obj(MESH, coordinates(MESH)).replace("skin.mtl", name))


NAMES = [
    "my skin.png",
    '"my skin.png"',
    "MY SKIN.PNG",
    "C:\\\\textures\\\\my skin.png",
    "/home/somebody/my skin.png",
    "../textures/my skin.png",
    "textures/my skin.png",
]


@pytest.mark.parametrize("name", NAMES)
def test_images_are_found_by_name(tmp_path, name):
    """An image with a path of another computer is found by its name in the same folder."""
    folder = tmp_path / "inner"
    folder.mkdir()
    write(tmp_path, "my skin.png", b"another one")
    path = _obj_of(folder, "../skin.mtl", f"newmtl a skin\nmap_KD {name}\n".encode())
    [material] = load_colors(path, MESH).materials
    assert material.image == image()


@pytest.mark.parametrize("name", ["../secret.png", "{folder}/secret.png", "..\\\\secret.png"])
def test_files_outside_the_folder_are_not_read(tmp_path, name):
    folder = tmp_path / "inner"
    folder.mkdir()
    write(tmp_path, "secret.png", image())
    given = name.format(folder=tmp_path)
    mtl = f"newmtl a skin\nmap_Kd {given}\n".encode()
    for path in (
        _obj_of(folder, "skin.mtl", mtl),
        _obj_of(folder, given, mtl),
        write(folder, "a.gltf", json.dumps(gltf_header(buffers=[{"uri": given}]))),
    ):
        with raises(MeshError, "secret.png"):
            load_colors(path, MESH)


def test_referenced_files_are_read_once(tmp_path, monkeypatch):
    read = []

    def read_bytes(path, most):
        read.append(path.name)
        return path.read_bytes()

    monkeypatch.setattr(references, "read_bytes", read_bytes)
    materials = "".join(f"newmtl m{k}\nmap_Kd my skin.png\n" for k in range(300)).encode()
    path = _obj_of(tmp_path, "skin.mtl", materials + b"newmtl a skin\nmap_Kd my skin.png\n")
    text = path.read_text().replace(
        "mtllib skin.mtl\n", "mtllib skin.mtl\nmtllib ./skin.mtl\n" * 200
    )
    [material] = load_colors(write(tmp_path, "a.obj", text), MESH).materials
    assert material.image == image()
    assert read == ["skin.mtl", "my skin.png"]


def test_size_of_referenced_files_is_limited(tmp_path, monkeypatch):
    path = as_obj(tmp_path, MESH, coordinates(MESH))
    size = len((tmp_path / "skin.mtl").read_bytes() + image())
    monkeypatch.setattr(references, "BYTES_MAX", size)
    load_colors(path, MESH)
    monkeypatch.setattr(references, "BYTES_MAX", size - 1)
    with raises(MeshError, len(image()), len(image()) - 1):
        load_colors(path, MESH)


def test_glb_images_are_shared_and_limited(tmp_path, monkeypatch):
    path = as_trimesh_glb(tmp_path, MESH, coordinates(MESH))
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    header, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    header["materials"] = [json.loads(json.dumps(header["materials"][0])) for _ in range(3)]
    header["textures"] *= 3
    header["images"] *= 3
    header["textures"] = [each | {"source": k} for k, each in enumerate(header["textures"])]
    for k, material in enumerate(header["materials"]):
        material["pbrMetallicRoughness"]["baseColorTexture"]["index"] = k
    [primitive] = header["meshes"][0]["primitives"]
    header["meshes"][0]["primitives"] = [primitive | {"material": k} for k in range(3)]
    view = header["bufferViews"][header["images"][0]["bufferView"]]
    path = write(tmp_path, "b.glb", glb(header, binary))
    monkeypatch.setattr(references, "BYTES_MAX", view["byteLength"])
    found = colored_gltf(open_file(path))
    assert len({id(material.image) for material in found.materials}) == 1
    monkeypatch.setattr(references, "BYTES_MAX", view["byteLength"] - 1)
    with raises(MeshError, "image 0"):
        load_colors(path, MESH)
