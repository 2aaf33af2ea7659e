"""Meshes of other libraries."""

import sys
from types import SimpleNamespace as Object

import nibabel
import numpy as np
import pytest
import trimesh
from nilearn.surface import InMemoryMesh, PolyMesh, SurfaceImage
from numpy.testing import assert_array_equal

import abfm
from abfm import MeshError, ParameterError, load_mesh
from abfm.mesh import as_mesh, as_meshes
from tests.messages import raises
from tests.shapes import icosphere

SPHERE = icosphere(1)
V, F = SPHERE.vertices, SPHERE.faces
# the quadrilaterals of a cube, outward
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)


def padded(rows):
    """Return connectivity in the format of VTK, with the number of corners before them."""
    return np.concatenate([[len(row), *row] for row in rows]) if len(rows) else np.zeros(0, int)


def poly_data(points, faces=(), strips=()):
    """Return an object with the attributes of PyVista's PolyData."""
    return Object(points=points, faces=padded(faces), strips=padded(strips), lines=np.zeros(0, int))


def meshio_mesh(points, **cells):
    """Return an object with the attributes of meshio's Mesh."""
    blocks = [Object(type=kind, data=np.array(rows)) for kind, rows in cells.items()]
    return Object(points=points, cells=blocks, point_data={})


def gifti(vertices, faces, real="float32", integer="int32"):
    arrays = [
        nibabel.gifti.GiftiDataArray(
            np.asarray(values, dtype=kind),
            f"NIFTI_INTENT_{intent}",
            datatype=f"NIFTI_TYPE_{kind.upper()}",
        )
        for values, intent, kind in ((vertices, "POINTSET", real), (faces, "TRIANGLE", integer))
    ]
    return nibabel.GiftiImage(darrays=arrays)


def poly_mesh(**parts):
    return PolyMesh(**{name: InMemoryMesh(*arrays) for name, arrays in parts.items()})


def ico_strip():
    """Return the faces of the sphere, the first two as one strip."""
    first, other = F[0], next(face for face in F[1:] if len({*face} & {*F[0]}) == 2)
    single = next(v for v in first if v not in other)
    a, b = (first[(list(first).index(single) + k) % 3] for k in (1, 2))
    last = next(v for v in other if v not in first)
    rest = [face for face in F if tuple(face) not in (tuple(first), tuple(other))]
    return [[single, a, b, last]], rest


def grid(kind):
    """Return an object with the attributes of PyVista's UnstructuredGrid."""
    return Object(points=V, cells=padded(F), celltypes=np.full(len(F), kind, np.uint8))


def open3d_mesh():
    """Return an object with the attributes of Open3D's TriangleMesh."""
    return Object(vertices=V, triangles=F)


class Adapter:
    """Object with the attributes of a BrainSpace surface; others raise a KeyError."""

    Points, Polygons = V, padded(F)

    def __getattr__(self, name):
        raise KeyError(name)


OBJECTS = {
    "pair": (V, F),
    "lists": [V.tolist(), F.tolist()],
    "trimesh": trimesh.Trimesh(V, F, process=False),
    "poly data": poly_data(V, F),
    "unstructured grid": grid(5),
    "open3d": open3d_mesh(),
    "open3d tensors": Object(vertex={}, triangle={}, to_legacy=open3d_mesh),
    "pymeshlab": Object(vertex_matrix=lambda: V, face_matrix=lambda: F),
    "vedo": Object(points=V, cells=F.tolist()),
    "lapy": Object(v=V, t=F),
    "brainspace": Adapter(),
    "meshio": meshio_mesh(V, vertex=[[0]], line=[[0, 1]], triangle=F),
    "surface image": SurfaceImage(poly_mesh(left=(V, F)), {"left": np.float32(V[:, 0])}),
    "poly mesh": poly_mesh(right=(V, F)),
    "part of a poly mesh": InMemoryMesh(V, F),
    "mesh": SPHERE,
}


@pytest.mark.parametrize("given", OBJECTS.values(), ids=OBJECTS)
def test_objects_are_converted(given):
    mesh = load_mesh(given)
    assert_array_equal(mesh.vertices, V)
    assert_array_equal(mesh.faces, F)


@pytest.mark.parametrize("types", [("float32", "int32"), ("float64", "int64")])
def test_gifti_images_of_any_type_are_converted(types):
    mesh = load_mesh(gifti(V, F, *types))
    assert_array_equal(mesh.vertices, V.astype(types[0]))
    assert_array_equal(mesh.faces, F)


@pytest.mark.parametrize(
    "given",
    [
        poly_data(CORNERS, QUADS),
        poly_data(CORNERS, [*QUADS[:5], QUADS[5][[0, 1, 2]], QUADS[5][[0, 2, 3]]]),
        meshio_mesh(CORNERS, quad=QUADS),
        meshio_mesh(CORNERS, polygon=QUADS[:2], quad=QUADS[2:]),
    ],
    ids=["quads", "quads and triangles", "meshio", "blocks"],
)
def test_quadrilaterals_are_split(given):
    mesh = load_mesh(given)
    assert len(mesh.faces) == 12
    assert mesh.is_closed
    assert mesh.length_scale == pytest.approx(np.sqrt(6))


def test_strips_become_oriented_triangles():
    strips, rest = ico_strip()
    mesh = load_mesh(poly_data(V, rest, strips))
    assert mesh.is_closed
    assert len(mesh.faces) == len(F)
    assert not mesh.messages
    assert mesh.length_scale == pytest.approx(SPHERE.length_scale)


def test_hemisphere_is_chosen():
    both = poly_mesh(left=(V, F), right=(2 * V, F))
    assert_array_equal(load_mesh(both, hemisphere="R").vertices, 2 * V)
    image = SurfaceImage(both, {"left": V[:, 0], "right": V[:, 0]})
    assert_array_equal(load_mesh(image, hemisphere="L").vertices, V)
    with raises(MeshError, "hemisphere", "L", "R"):
        load_mesh(both)
    assert load_mesh(image, hemisphere="L").structure == "CortexLeft"
    assert load_mesh(poly_mesh(right=(V, F))).structure == "CortexRight"
    named = gifti(V, F)
    named.darrays[0].meta["AnatomicalStructurePrimary"] = "CortexRight"
    assert load_mesh(named).structure == "CortexRight"
    assert load_mesh(gifti(V, F)).structure is None
    with raises(ParameterError, "TriangleMesh"):
        load_mesh(SPHERE, hemisphere="L")
    with raises(MeshError, "R", "left"):
        load_mesh(poly_mesh(left=(V, F)), hemisphere="R")


UNSUITABLE = {
    "number": 3,
    "none": None,
    "class": trimesh.Trimesh,
    "array": V,
    "triple": (V, F, F),
    "scene": trimesh.Scene([trimesh.Trimesh(V, F, process=False)]),
    "point cloud": trimesh.PointCloud(V),
    "tetrahedra": meshio_mesh(V, tetra=[[0, 1, 2, 3]]),
    "points": meshio_mesh(V),
    "curved triangles": grid(22),
    "cut short": Object(points=V, faces=padded(F)[:-1], strips=np.zeros(0, int)),
    "values": nibabel.GiftiImage(darrays=[nibabel.gifti.GiftiDataArray(np.float32(V[:, 0]))]),
    "texts": ("a", "b"),
    "masked vertices": (np.ma.array(V, mask=V > 0.9), F),
    "masked faces": (V, np.ma.array(F, mask=F == 3)),
    "beyond": (V, F + len(V)),
    "table of names": {"vertices": V, "faces": F},
}


@pytest.mark.parametrize("given", UNSUITABLE.values(), ids=UNSUITABLE)
def test_unsuitable_objects_are_refused(given):
    with raises(MeshError):
        load_mesh(given)


def test_error_lists_accepted_types():
    with raises(MeshError, "int", "trimesh", "PyVista", "meshio", "nilearn", "nibabel"):
        abfm.match(3, V[:, 0], V[:, 1])


def test_all_functions_accept_mesh_objects(tmp_path):
    given = trimesh.Trimesh(V, F, process=False)
    parameters = abfm.Parameters.of(iterations=1, refine=0)
    f, g = (abfm.function(given, f"gaussian:vertex={i},width=0.5") for i in (0, 1))
    assert_array_equal(f, abfm.function(SPHERE, "gaussian:vertex=0,width=0.5"))
    expected = abfm.match(SPHERE, f, g, parameters)
    assert_array_equal(abfm.match(given, f, g, parameters).velocity, expected.velocity)
    assert abfm.Problem(given, f, g).mesh.digest == SPHERE.digest
    energy = abfm.MatchingEnergy((V, F), f, g)
    assert energy(np.zeros((1, len(F), 3)))[0] > 0
    assert_array_equal(abfm.advect((V, F), 0 * V[F[:, 0]], f, 1.0), f)
    found = abfm.register(given, given, f, g, parameters=parameters)
    assert found.a is found.b


def test_same_object_becomes_one_mesh():
    pair = (V, F)
    a, b = as_meshes(pair, pair)
    assert a is b
    assert as_mesh(a) is a
    a, b = as_meshes(pair, (V, F))
    assert a is not b


def test_trimesh_has_the_same_order():
    found = SPHERE.to_trimesh()
    assert isinstance(found, trimesh.Trimesh)
    assert_array_equal(found.vertices, V)
    assert_array_equal(found.faces, F)
    found.vertices += 1.0  # the mesh itself does not change
    assert_array_equal(SPHERE.vertices, V)


def test_pyvista_mesh_is_converted(monkeypatch):
    kind = Object(from_regular_faces=lambda points, faces: poly_data(points, faces))
    monkeypatch.setitem(sys.modules, "pyvista", Object(PolyData=kind))
    mesh = load_mesh(SPHERE.to_pyvista())
    assert_array_equal(mesh.vertices, V)
    assert_array_equal(mesh.faces, F)


def test_missing_pyvista_is_reported(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with raises(MeshError, "PyVista", "pip install pyvista"):
        SPHERE.to_pyvista()
