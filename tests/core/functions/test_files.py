"""Values and vertex maps from files, counted as the mesh file counts."""

import nibabel
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import FunctionError
from abfm.functions import function
from abfm.functions.files import read_column
from abfm.maps.symmetry import detect_symmetry
from abfm.mesh import TriangleMesh
from tests.shapes import ellipsoid, icosphere

MESH = icosphere(1)
COUNT = len(MESH.vertices)
VALUES = np.random.default_rng(5).standard_normal(COUNT)


def with_unused_vertices():
    """MESH whose file had one more vertex in front and one behind number 9, used by no face."""
    vertices = np.insert(MESH.vertices, [0, 10], 0.0, axis=0)
    return TriangleMesh(vertices, np.where(MESH.faces < 10, MESH.faces + 1, MESH.faces + 2))


def write_gifti(path, columns):
    arrays = [
        nibabel.gifti.GiftiDataArray(column.astype(np.float32), intent="NIFTI_INTENT_SHAPE")
        for column in columns
    ]
    nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), path)


def write_text(path, header, delimiter, columns):
    np.savetxt(
        path, np.column_stack(columns), delimiter=delimiter, header=header, comments="", fmt="%.17g"
    )


def test_one_column_from_every_format(tmp_path):
    np.save(tmp_path / "a.npy", VALUES)
    write_text(tmp_path / "a.txt", "", " ", [VALUES])
    write_text(tmp_path / "a.csv", "thickness", ",", [VALUES])
    for name in ("a.npy", "a.txt", "a.csv"):
        assert_array_equal(function(MESH, f"file:{tmp_path / name}"), VALUES)
    for name in ("a.gii", "a.gii.gz"):
        write_gifti(tmp_path / name, [VALUES])
        assert_array_equal(function(MESH, f"file:{tmp_path / name}"), VALUES.astype(np.float32))


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_columns_by_name_and_by_number(tmp_path, delimiter):
    path = tmp_path / "table, (1) + more.csv"
    write_text(path, delimiter.join(["index", '"depth"']), delimiter, [np.arange(COUNT), VALUES])
    for column in ("1", "depth" if delimiter != " " else '"""depth"""'):
        assert_array_equal(function(MESH, f'file:"{path}",column={column}'), VALUES)
    with pytest.raises(FunctionError, match="2 columns; choose column=0 to 1 or one of index"):
        function(MESH, f'file:"{path}"')
    with pytest.raises(FunctionError, match=r"none called 'dept'.*did you mean"):
        function(MESH, f'file:"{path}",column=dept')
    with pytest.raises(FunctionError, match="none called '2'"):
        function(MESH, f'file:"{path}",column=2')


def test_columns_of_arrays_and_gifti(tmp_path):
    np.save(tmp_path / "a.npy", np.column_stack([VALUES, 2 * VALUES]).astype(">f4"))
    write_gifti(tmp_path / "a.gii", [VALUES, 2 * VALUES])
    for name in ("a.npy", "a.gii"):
        assert_array_equal(
            function(MESH, f"file:{tmp_path / name},column=1"), (2 * VALUES).astype(np.float32)
        )


def test_a_line_of_another_length_is_named_without_advice_to_programmers(tmp_path):
    (tmp_path / "a.csv").write_text("1,2\n3,4\n5,6,7\n")
    with pytest.raises(FunctionError, match=r"columns changed from 2 to 3 at row 3$"):
        function(MESH, f"file:{tmp_path / 'a.csv'},column=0")


def test_comments_and_empty_lines_are_skipped(tmp_path):
    lines = ["# made by hand", "", *map(repr, VALUES.tolist()), ""]
    (tmp_path / "a.txt").write_text("\r\n".join(lines))
    assert_array_equal(function(MESH, f"file:{tmp_path / 'a.txt'}"), VALUES)


def test_files_count_as_the_mesh_file_does_after_repairs(tmp_path):
    mesh = with_unused_vertices()
    in_file = np.insert(VALUES, [0, 10], np.nan)
    np.save(tmp_path / "a.npy", in_file)
    assert_array_equal(function(mesh, f"file:{tmp_path / 'a.npy'}"), VALUES)
    in_file[12] = np.inf
    np.save(tmp_path / "a.npy", in_file)
    with pytest.raises(FunctionError, match=f"1 of {COUNT} vertices, for example inf at vertex 12"):
        function(mesh, f"file:{tmp_path / 'a.npy'}")


def test_a_map_composes(tmp_path):
    target = np.random.default_rng(0).integers(0, COUNT, COUNT)
    np.savetxt(tmp_path / "map.txt", target, fmt="%d")
    np.save(tmp_path / "map.npy", target)
    for name in ("map.txt", "map.npy"):
        composed = function(MESH, f"permuted:{tmp_path / name}(coordinate:x + expression:y*(z+1))")
        x, y, z = MESH.vertices.T
        assert_array_equal(composed, (x + y * (z + 1))[target])


def test_a_map_counts_as_the_mesh_file_does_after_repairs(tmp_path):
    mesh = with_unused_vertices()
    target = np.random.default_rng(0).permutation(COUNT)
    in_file = np.full(COUNT + 2, -1)
    in_file[mesh.vertex_ids] = mesh.vertex_ids[target]
    np.savetxt(tmp_path / "map.txt", in_file, fmt="%d")
    assert_array_equal(
        function(mesh, f"permuted:{tmp_path / 'map.txt'}(coordinate:z)"), mesh.vertices[target, 2]
    )
    in_file[3] = 0
    np.savetxt(tmp_path / "map.txt", in_file, fmt="%d")
    with pytest.raises(FunctionError, match=rf"1 of {COUNT} entries .* \(vertex 3 has 0\)"):
        function(mesh, f"permuted:{tmp_path / 'map.txt'}(coordinate:z)")


@pytest.mark.parametrize("bad", [-1, COUNT, 0.5, np.nan, np.inf, 1e300])
def test_wrong_map_entries_are_counted_with_an_example(tmp_path, bad):
    target = np.arange(COUNT, dtype=np.float64)
    target[[4, 6]] = bad
    np.save(tmp_path / "map.npy", target)
    with pytest.raises(
        FunctionError, match=rf"2 of {COUNT} entries are not numbers of vertices .* \(vertex 4 has"
    ):
        function(MESH, f"permuted:{tmp_path / 'map.npy'}(hks)")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.npy", b"PK\x03\x04", "not a table of numbers"),
        ("a.npy", b"\x93NUMPY\x01\x00", "not a table of numbers"),
        (
            "a.npy",
            b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (10**15,), }",
            "not a table",
        ),
        ("a.csv", b"", "it is empty"),
        ("a.csv", b"a,b\n", "it has only the line 'a,b'"),
        (
            "a.csv",
            b"a,b\n1,2\n3,x\n",
            "row 1 of its numbers, counting from 0, has 'x' in column 1, where a number is",
        ),
        ("a.csv", b"1,2\n3\n", "number of columns changed"),
        (
            "a.txt",
            b"1\n\xff\xfe\xff",
            "not a table of numbers: byte 2, counting from 0, is no text in UTF-8",
        ),
        ("a.txt", b"1\n2\n", f"2 values were given for a mesh of {COUNT} vertices"),
        ("a.gii", b"<GIFTI", "not a table of numbers"),
        ("a.gii", b"", "not a table of numbers"),
        ("a.gii.gz", b"\x1f\x8b\x08\x00", "not a table of numbers"),
        ("b.gii.gz", b"plain", "it is no XML, or cut short"),
        ("a.xyz", b"1", "must end in .npy, .csv, .txt, .gii"),
    ],
)
def test_broken_files_are_refused_by_name(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FunctionError) as error:
        function(MESH, f"file:{tmp_path / name}")
    assert message in str(error.value)
    assert name in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "path",
    ["missing.npy", "~no_such_user/a.npy", "x" * 300 + ".npy", "missing/a.txt", "missing.gii"],
)
def test_files_that_cannot_be_read_say_why(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FunctionError, match=r"cannot be read: \w"):
        function(MESH, f"file:{path}")


MIRRORED = ellipsoid(2, 1, 0.7, 0.5)
SWAP = detect_symmetry(MIRRORED, "mirror").vertex_map
SWAP_VALUES = MIRRORED.vertices[SWAP, 0]


def through(path, mesh=MIRRORED):
    return function(mesh, f"permuted:{path}(coordinate:x)")


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**30),
    first=st.sampled_from([0, 1]),
    suffix=st.sampled_from([".txt", ".npy", ".sym.vts"]),
)
def test_permutations_may_count_from_0_or_1(tmp_path_factory, seed, first, suffix):
    order = np.random.default_rng(seed).permutation(COUNT)
    path = tmp_path_factory.mktemp("maps") / f"map{suffix}"
    if suffix == ".npy":
        np.save(path, order + first)
    else:
        np.savetxt(path, order + first, fmt="%d")
    assert_array_equal(through(path, MESH), MESH.vertices[order, 0])


def test_a_map_that_counts_from_1_after_repairs(tmp_path):
    mesh = with_unused_vertices()
    target = np.random.default_rng(0).permutation(COUNT)
    in_file = np.full(COUNT + 2, -1)
    in_file[mesh.vertex_ids] = mesh.vertex_ids[target] + 1
    np.savetxt(tmp_path / "map.txt", in_file, fmt="%d")
    assert_array_equal(through(tmp_path / "map.txt", mesh), mesh.vertices[target, 0])


def test_maps_that_fit_both_ways_count_from_0_as_meshes_do(tmp_path):
    target = np.clip(np.arange(COUNT), 1, COUNT - 1)
    np.savetxt(tmp_path / "map.txt", target, fmt="%d")
    np.save(tmp_path / "map.npy", target)
    for name in ("map.txt", "map.npy"):
        assert_array_equal(through(tmp_path / name, MESH), MESH.vertices[target, 0])


def test_pairs_that_fit_both_ways_are_refused_as_text(tmp_path):
    pairs = np.arange(2, COUNT - COUNT % 2).reshape(-1, 2)
    np.savetxt(tmp_path / "pairs.txt", pairs, fmt="%d")
    np.save(tmp_path / "pairs.npy", pairs)
    with pytest.raises(FunctionError, match=rf"neither 0 nor {COUNT}; save them as .npy"):
        through(tmp_path / "pairs.txt", MESH)
    swapped = np.arange(COUNT)
    swapped[pairs] = pairs[:, ::-1]
    assert_array_equal(through(tmp_path / "pairs.npy", MESH), MESH.vertices[swapped, 0])


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("name", ["pairs.sym.vts", "pairs.txt"])
def test_pairs_are_swapped_and_other_vertices_stay(tmp_path, name, first):
    pairs = [(i, j) for i, j in enumerate(SWAP) if i < j]
    assert len(pairs) < len(SWAP) / 2  # some lie on the plane
    assert 0 in np.ravel(pairs)
    np.savetxt(tmp_path / name, np.array(pairs) + first, fmt="%d")
    if first == 1 and len(SWAP) not in np.array(pairs) + 1:
        np.savetxt(tmp_path / name, np.array([*pairs, (len(SWAP) - 1,) * 2]) + 1, fmt="%d")
    assert_array_equal(through(tmp_path / name), SWAP_VALUES)


def test_symmetries_by_way_of_a_template(tmp_path):
    rng = np.random.default_rng(3)
    points = rng.permutation(len(SWAP))[: len(SWAP) * 3 // 4]
    np.savetxt(tmp_path / "a.vts", points + 1, fmt="%d")
    np.savetxt(tmp_path / "a.sym.vts", SWAP[points] + 1, fmt="%d")
    known = np.isin(np.arange(len(SWAP)), [*points, *SWAP[points]])
    found = through(tmp_path / "a.sym.vts")
    assert_array_equal(found[known], SWAP_VALUES[known])
    edge = np.linalg.norm(np.diff(MIRRORED.vertices[MIRRORED.edges], axis=1), axis=2).max()
    assert np.abs(found - SWAP_VALUES).max() <= 2 * edge
    assert not known.all()
    np.savetxt(tmp_path / "a.vts", points[1:] + 1, fmt="%d")
    with pytest.raises(FunctionError, match=r"has \d+ lines, 'a.vts' has \d+"):
        through(tmp_path / "a.sym.vts")


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ([[0, 1], [0, 2]], r"vertex 0 \(counted from 0\) has two partners"),
        ([[0, 1]], "its pairs name 2 of 162 vertices; give every pair"),
        ([[0, 1], [5, 500]], r"1 of 4 entries are not numbers of vertices .* \(line 2 has 500\)"),
    ],
)
def test_pairs_that_are_no_map_are_refused(tmp_path, pairs, message):
    np.savetxt(tmp_path / "pairs.txt", pairs, fmt="%d")
    with pytest.raises(FunctionError, match=message):
        through(tmp_path / "pairs.txt")


def test_maps_with_more_columns_are_refused(tmp_path):
    np.savetxt(tmp_path / "map.txt", np.zeros((COUNT, 3)), fmt="%d")
    with pytest.raises(FunctionError, match="has 3 columns"):
        through(tmp_path / "map.txt", MESH)


def test_detected_symmetries_compose():
    x, y, z = MIRRORED.vertices.T
    assert_allclose(
        function(MIRRORED, "permuted:mirror(expression:x + 2*y + 3*z)"),
        -x + 2 * y + 3 * z,
        atol=1e-12,
    )
    assert_allclose(
        function(MIRRORED, "permuted:rotation(expression:x + 2*y + 3*z)"),
        -x - 2 * y + 3 * z,
        atol=1e-12,
    )
    twice = function(MIRRORED, "permuted:mirror(permuted: mirror (gaussian:vertex=5))")
    assert_array_equal(twice, function(MIRRORED, "gaussian:vertex=5"))


def test_symmetries_that_are_not_there_are_refused():
    x = MESH.vertices
    uneven = TriangleMesh(x * (1 + 0.3 * np.sin(3 * x[:, [1]] + x[:, [2, 0, 1]])), MESH.faces)
    with pytest.raises(
        FunctionError, match=r"permuted:mirror: the surface has no mirror plane: .*sqrt\(area\)"
    ):
        function(uneven, "permuted:mirror(coordinate:x)")
    with pytest.raises(
        FunctionError, match=r"'miror' is neither mirror nor rotation nor .*did you mean 'mirror'"
    ):
        function(MESH, "permuted:miror(coordinate:x)")


def test_a_title_of_more_words_than_columns_names_none(tmp_path):
    path = tmp_path / "v.csv"
    path.write_text("a,b,c\n1,2\n3,4\n")
    assert_allclose(read_column(str(path), "1"), [2, 4])
    with pytest.raises(FunctionError, match="2 columns, none called"):
        read_column(str(path), "c")
    path.write_text("mean curvature\n1\n3\n")
    assert_allclose(read_column(str(path)), [1, 3])
