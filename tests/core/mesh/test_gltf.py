"""glTF scenes agree with trimesh, and invalid ones are refused with the reason."""

import json

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from abfm.errors import MeshError
from abfm.mesh import load_mesh
from abfm.mesh.readers import gltf, gltf_document, references
from abfm.mesh.readers.gltf_document import FAN, STRIP
from abfm.reading import open_file
from tests.core.mesh.heavy_meshes import TRIANGLE, glb, gltf_header
from tests.mesh_writers import write
from tests.messages import raises
from tests.shapes import icosphere


def random_nodes(random, count):
    """Return nodes of a forest with mesh 0 and random transformations, and its roots."""
    parents = [-1, *(int(random.integers(-1, k)) for k in range(1, count))]
    nodes = []
    for k in range(count):
        node = {"mesh": 0, "children": [child for child in range(count) if parents[child] == k]}
        if random.random() < 0.4:
            matrix = np.vstack([random.normal(size=(3, 4)), [0, 0, 0, 1]])
            node["matrix"] = matrix.T.ravel().tolist()
        else:
            for name, count_of in (("translation", 3), ("scale", 3), ("rotation", 4)):
                node[name] = random.normal(size=count_of).tolist()
        nodes.append(node)
    return nodes, [k for k in range(count) if parents[k] < 0]


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 6))
@settings(max_examples=25)
def test_scenes_agree_with_trimesh(folder, seed, count):
    nodes, roots = random_nodes(np.random.default_rng(seed), count)
    path = write(folder, "a.glb", glb(gltf_header(nodes=nodes, scenes=[{"nodes": roots}])))
    expected = trimesh.load_mesh(path, process=False)
    found = gltf.read_gltf(open_file(path))
    np.testing.assert_array_equal(found.faces, expected.faces)
    np.testing.assert_allclose(found.vertices, expected.vertices, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("scenes", [{}, {"scenes": []}])
def test_all_nodes_are_read_without_scenes(tmp_path, scenes):
    header = gltf_header()
    header["nodes"] = [{"mesh": 0}, {"children": [0], "translation": [5, 0, 0]}]
    del header["scenes"]
    path = write(tmp_path, "a.glb", glb(header | scenes))
    assert gltf.read_gltf(open_file(path)).vertices.tolist() == [[5, 0, 0], [6, 0, 0], [5, 1, 0]]


@pytest.mark.parametrize(("mode", "order"), [(STRIP, [0, 1, 2, 3]), (FAN, [0, 1, 3, 2])])
def test_strips_and_fans_have_one_orientation(tmp_path, mode, order):
    corners = np.arange(4, dtype="<u4")
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], dtype="<f4")[order]
    places, indices = ({**part, "count": 4} for part in gltf_header()["accessors"])
    header = gltf_header(
        meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": mode}]}],
        accessors=[places, indices],
        bufferViews=[
            {"buffer": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 16},
        ],
    )
    mesh = load_mesh(write(tmp_path, "a.glb", glb(header, points.tobytes() + corners.tobytes())))
    assert len(mesh.faces) == 2
    assert mesh.messages == ()
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert np.cross(b - a, c - a)[:, 2].tolist() == [1, 1]


def test_shared_buffer_is_read_once(tmp_path, monkeypatch):
    write(tmp_path, "a.bin", TRIANGLE)
    buffers = [{"byteLength": 48, "uri": uri} for uri in ("a.bin", "./a.bin", "%61.bin")]
    views = gltf_header()["bufferViews"]
    header = gltf_header(
        buffers=buffers, bufferViews=[view | {"buffer": k + 1} for k, view in enumerate(views)]
    )
    read = []
    patch = monkeypatch.setattr
    patch(references, "read_bytes", lambda path, _: read.append(path) or path.read_bytes())
    assert len(load_mesh(write(tmp_path, "a.gltf", json.dumps(header))).faces) == 1
    assert [path.name for path in read] == ["a.bin"]


SPARSE = {"count": 1, "indices": {"bufferView": 1, "componentType": 5125}, "values": {}}
BEYOND = SPARSE | {"indices": {"bufferView": 0, "componentType": 5125}, "count": 9}
SIGNED = SPARSE | {"indices": {"bufferView": 1, "componentType": 5126}}
POSITIONS, CORNERS = gltf_header()["accessors"]
VIEWS = gltf_header()["bufferViews"]


def node(**changes):
    return {"nodes": [{"mesh": 0, **changes}]}


def accessors(of_positions, of_corners):
    return {"accessors": [POSITIONS | of_positions, CORNERS | of_corners]}


def view(**changes):
    return {"bufferViews": [VIEWS[0] | changes, VIEWS[1]]}


def buffer(uri):
    return {"buffers": [{"byteLength": 48, "uri": uri}]}


DOUBLED = [*({"children": [k + 1, k + 1]} for k in range(30)), {"mesh": 0}]
CIRCLE = {"nodes": [{"mesh": 0, "children": [1]}, {"children": [0]}]}
WITHOUT_VIEW = {"componentType": 5126, "count": 10**8, "type": "VEC3"}
LINES = {"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": 1}]}
REFUSED = {
    "nan": (node(matrix=[float("nan")] * 16), (0,)),
    "infinite": (node(translation=[0, 1e999, 0]), (0,)),
    "short matrix": (node(matrix=[1.0] * 15), (16,)),
    "flattened": (node(scale=[1, 0, 0]), ()),
    "a circle": (CIRCLE, (0,)),
    "2^30 copies": ({"nodes": DOUBLED}, (30,)),
    "no node": ({"nodes": []}, ("nodes[0]", 0)),
    "negative node": ({"scenes": [{"nodes": [-1]}]}, ("nodes[-1]", 1)),
    "words as nodes": ({"nodes": "all"}, ()),
    "no accessor": ({"accessors": [POSITIONS]}, ("accessors[1]", 1)),
    "sparse without values": (accessors({"sparse": SPARSE}, {}), ("bufferViews",)),
    "sparse beyond": (accessors({"sparse": BEYOND}, {}), (0, 3)),
    "sparse floats": (accessors({"sparse": SIGNED}, {}), (0,)),
    "many without data": (
        {"accessors": [WITHOUT_VIEW | {"sparse": SPARSE}, CORNERS]},
        (100000000,),
    ),
    "many": (accessors({"count": 10**9}, {}), (1000000000,)),
    "no data": ({"accessors": [WITHOUT_VIEW, CORNERS]}, (0,)),
    "one place": (view(byteStride=0), ()),
    "outside": (view(byteOffset=40), (48,)),
    "before": (view(byteOffset=-8), (48,)),
    "of another kind": (accessors({"type": "VEC4"}, {}), ()),
    "float corners": (accessors({}, {"componentType": 5126}), ()),
    "two corners": (accessors({}, {"count": 2}), ()),
    "few positions": (accessors({"count": 2}, {}), (0, 2)),
    "glTF 1": ({"asset": {"version": "1.0"}}, ("glTF", "1.0", 2)),
    "buffer elsewhere": (buffer("none.bin"), ("none.bin",)),
    "a device": (buffer("/dev/zero"), ()),
    "a folder": (buffer("."), ()),
    "no base64": (buffer("data:;base64,a"), (0, "base64")),
    "lines": ({"meshes": [LINES]}, ()),
}


@pytest.mark.parametrize(("changes", "named"), REFUSED.values(), ids=REFUSED)
def test_invalid_gltf_is_refused(tmp_path, changes, named):
    with raises(MeshError, *named) as caught:
        load_mesh(write(tmp_path, "a.glb", glb(gltf_header(**changes))))
    assert "\n" not in str(caught.value)


def test_too_many_copies_of_a_mesh_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf_document, "_ENTRIES_MIN", 100)
    sphere, nodes = icosphere(1), [{"mesh": 0, "translation": [3 * k, 0, 0]} for k in range(20)]
    path = tmp_path / "a.glb"
    trimesh.Trimesh(sphere.vertices, sphere.faces, process=False).export(path)
    header_length = int.from_bytes(path.read_bytes()[12:16], "little")
    header = json.loads(path.read_bytes()[20 : 20 + header_length])
    header |= {"nodes": nodes, "scenes": [{"nodes": list(range(20))}]}
    data = path.read_bytes()[28 + header_length :]
    with raises(MeshError, "vertices", "faces"):
        load_mesh(write(tmp_path, "b.glb", glb(header, data)))


def test_deep_scenes_and_json_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(gltf_document, "PARTS_MAX", 50)
    nodes = [*({"children": [k + 1]} for k in range(60)), {"mesh": 0}]
    with raises(MeshError, 51, 50):
        load_mesh(write(tmp_path, "a.glb", glb(gltf_header(nodes=nodes))))
    with raises(MeshError, "JSON"):
        load_mesh(write(tmp_path, "a.gltf", b"[" * 100_000))


def _with_arrays(arrays, **changes):
    """Return a sphere and a scene of it, with further arrays as accessors 2, 3, ..."""
    sphere = icosphere(1)
    arrays = [sphere.vertices.astype("<f4"), sphere.faces.astype("<u4").reshape(-1, 1), *arrays]
    shapes = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
    kinds = {"f4": 5126, "u4": 5125, "u1": 5121, "u2": 5123, "i2": 5122}
    data, views, entries = b"", [], []
    for array in arrays:
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        kind, shape = kinds[array.dtype.str[1:]], shapes[array.shape[1]]
        entries.append({"bufferView": len(views) - 1, "componentType": kind})
        entries[-1] |= {"count": len(array), "type": shape}
        data += array.tobytes() + bytes(-array.nbytes % 4)
    buffers = [{"byteLength": len(data)}]
    header = gltf_header(accessors=entries, bufferViews=views, buffers=buffers, **changes)
    return sphere, glb(header, data)


def _primitive(attributes=None, **changes):
    return {"attributes": {"POSITION": 0, **(attributes or {})}, "indices": 1, **changes}


MORPHED = _primitive(targets=[{"POSITION": 2}, {"NORMAL": 2}, {"POSITION": 3}])


@pytest.mark.parametrize(
    ("of_mesh", "of_node", "weights"),
    [
        ({"weights": [1, 0, 0]}, {}, (1, 0)),
        ({"weights": [1, 0, 0]}, {"weights": [-0.5, 3, 0.25]}, (-0.5, 0.25)),
        ({}, {"weights": [0, 0, 2]}, (0, 2)),
        ({}, {}, (0, 0)),
    ],
)
def test_morph_weights_move_vertices(tmp_path, of_mesh, of_node, weights):
    """Weights of the node replace those of the mesh, and the node scales the result."""
    rng = np.random.default_rng(0)
    shifts = rng.uniform(-0.1, 0.1, (2, 42, 3)).astype("<f4")
    nodes = [{"mesh": 0, "scale": [2, 2, 2], **of_node}]
    meshes = [{"primitives": [MORPHED], **of_mesh}]
    sphere, content = _with_arrays(shifts, nodes=nodes, meshes=meshes)
    mesh = load_mesh(write(tmp_path, "a.glb", content))
    expected = 2 * (sphere.vertices + np.einsum("k,kvx->vx", weights, shifts))
    np.testing.assert_allclose(mesh.vertices, expected, atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, sphere.faces)


def test_quantized_morph_targets_are_lengths(tmp_path):
    """Integers that are not normalized are shifts in the unit of the mesh."""
    shifts = np.random.default_rng(0).integers(-3, 4, (42, 3)).astype("<i2")
    meshes = [{"primitives": [_primitive(targets=[{"POSITION": 2}])], "weights": [0.1]}]
    sphere, content = _with_arrays([shifts], meshes=meshes)
    mesh = load_mesh(write(tmp_path, "a.glb", content))
    np.testing.assert_allclose(mesh.vertices, sphere.vertices + 0.1 * shifts, atol=1e-6)


@pytest.mark.parametrize("kind", ["<f4", "<u1", "<u2"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_skins_place_vertices_by_their_joints(tmp_path, kind, mirrored):
    """Joint 1 moves vertices above the equator, joint 0 those below, both those on it.

    The node does not move them.
    """
    sphere = icosphere(1)
    share = np.clip(np.round(sphere.vertices[:, 2] * 4) / 8 + 0.5, 0, 1)
    weights = np.stack([1 - share, share, 0 * share, 0 * share], axis=1)
    scale = 1 if kind == "<f4" else np.iinfo(kind).max
    stored = np.round(weights * scale).astype(kind) if scale > 1 else weights.astype(kind)
    joints = np.tile(np.array([[0, 1, 0, 0]], dtype="<u1"), (42, 1))
    inverse = np.stack([np.eye(4), np.diag([0.5, 0.5, 0.5, 1])])
    inverse[1, :3, 3] = [0, 0, 1]
    columns = inverse.transpose(0, 2, 1).reshape(2, 16).astype("<f4")
    sign = -1 if mirrored else 1
    nodes = [
        {"mesh": 0, "skin": 0, "translation": [50, 0, 0], "children": [1]},
        {"translation": [-50, 0, 0], "scale": [sign, 1, 1], "children": [2]},
        {"translation": [0, 0, 3], "scale": [2, 2, 2]},
    ]
    _, content = _with_arrays(
        [joints, stored, columns],
        nodes=nodes,
        skins=[{"joints": [1, 2], "inverseBindMatrices": 4}],
        meshes=[{"primitives": [_primitive({"JOINTS_0": 2, "WEIGHTS_0": 3})]}],
    )
    mesh = load_mesh(write(tmp_path, "a.glb", content))
    normalized = stored.astype(float) / stored.sum(axis=1, keepdims=True)
    placed = np.stack([sphere.vertices, sphere.vertices + np.array([0, 0, 2 * 1 + 3])])
    expected = np.einsum("vk,kvx->vx", normalized[:, :2], placed) * [sign, 1, 1]
    np.testing.assert_allclose(mesh.vertices, expected, atol=1e-5)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert np.einsum("fx,fx->", a, np.cross(b, c)) > 0  # faces are outward


SKINNED = {
    "nodes": [{"mesh": 0, "skin": 0, "children": [1]}, {}],
    "skins": [{"joints": [1]}],
    "meshes": [{"primitives": [_primitive({"JOINTS_0": 2, "WEIGHTS_0": 3})]}],
}
UNSHAPED = {
    "weights of other targets": (
        {"meshes": [{"primitives": [MORPHED], "weights": [1, 2]}]},
        ("weights", 3),
    ),
    "shifts of others": (
        {"meshes": [{"primitives": [_primitive(targets=[{"POSITION": 4}])], "weights": [1]}]},
        (4, 42),
    ),
    "no joints": (SKINNED | {"meshes": [{"primitives": [_primitive()]}]}, ("JOINTS_0",)),
    "joints elsewhere": (SKINNED | {"skins": [{"joints": [7]}]}, (0, 7)),
    "joints beyond": (SKINNED | {"skins": [{"joints": []}]}, (0, 0)),
    "few matrices": (
        SKINNED | {"skins": [{"joints": [1, 1, 1], "inverseBindMatrices": 5}]},
        (2, 3),
    ),
    "instances": (
        {"nodes": [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]},
        ("EXT_mesh_gpu_instancing",),
    ),
}


@pytest.mark.parametrize(("changes", "named"), UNSHAPED.values(), ids=UNSHAPED)
def test_invalid_morph_or_skin_is_refused(tmp_path, changes, named):
    weights = np.tile(np.array([[1, 0, 0, 0]], dtype="<f4"), (42, 1))
    arrays = [np.zeros((42, 4), "<u1"), weights, np.zeros((3, 3), "<f4"), np.zeros((2, 16), "<f4")]
    _, content = _with_arrays(arrays, **changes)
    with raises(MeshError, *named):
        load_mesh(write(tmp_path, "a.glb", content))


def test_sparse_targets_move_some_vertices(tmp_path):
    """Sparse morph targets of Blender, alone or replacing parts of other data, move vertices."""
    places, shifts = np.array([[3], [7]], "<u2"), np.array([[0, 0, 1], [0, 2, 0]], "<f4")
    sphere, content = _with_arrays(
        [places, shifts],
        meshes=[{"primitives": [_primitive(targets=[{"POSITION": 4}])], "weights": [0.5]}],
    )
    header, data = _opened(content)
    sparse = {"count": 2, "indices": {"bufferView": 2, "componentType": 5123}}
    sparse["values"] = {"bufferView": 3}
    for base in ({}, {"bufferView": 0}):
        more = {"componentType": 5126, "count": 42, "type": "VEC3", "sparse": sparse, **base}
        changed = header | {"accessors": [*header["accessors"], more]}
        mesh = load_mesh(write(tmp_path, "a.glb", glb(changed, data)))
        shift = np.zeros((42, 3)) if not base else sphere.vertices.astype("<f4").astype(float)
        shift[[3, 7]] = shifts
        np.testing.assert_allclose(mesh.vertices, sphere.vertices + 0.5 * shift, atol=1e-6)


def _opened(content):
    length = int.from_bytes(content[12:16], "little")
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def test_vertices_without_weights_are_refused(tmp_path):
    _, content = _with_arrays([np.zeros((42, 4), "<u1"), np.zeros((42, 4), "<f4")], **SKINNED)
    with raises(MeshError, "vertex", 0):
        load_mesh(write(tmp_path, "a.glb", content))


def test_animations_are_reported(tmp_path):
    _, content = _with_arrays([], animations=[{"channels": [], "samplers": []}])
    assert "animations" in load_mesh(write(tmp_path, "a.glb", content)).messages[0]


def test_primitives_share_their_vertices(tmp_path):
    parts = [_primitive() for _ in range(3000)]
    _, content = _with_arrays([], meshes=[{"primitives": parts}])
    found = gltf.read_gltf(open_file(write(tmp_path, "a.glb", content)))
    assert found.vertices.shape == (42, 3)
    assert len(found.faces) == 3000 * 80
