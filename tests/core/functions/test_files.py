import os

import nibabel
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from abfm.errors import FunctionError, did_you_mean
from abfm.functions import function, read_column, read_vertex_map
from abfm.io import write_values
from abfm.maps.symmetry import detect_symmetry
from abfm.mesh import TriangleMesh
from tests.core.reading.hostile import npy_of
from tests.messages import check_message, raises
from tests.processes import python
from tests.shapes import ellipsoid, icosphere, with_loose_vertex

MESH, TINY = icosphere(1), icosphere(0)
COUNT, SIZE = len(MESH.vertices), len(TINY.vertices)
VALUES = np.random.default_rng(5).standard_normal(COUNT)
MIRRORED = ellipsoid(2, 1, 0.7, 0.5)
SWAP = detect_symmetry(MIRRORED, "mirror").vertex_map
SWAP_VALUES = MIRRORED.vertices[SWAP, 0]


def through(path, mesh=MIRRORED):
    return function(mesh, f"permuted:{path}(coordinate:x)")


def save(path, array):
    np.save(path, array) if path.suffix == ".npy" else np.savetxt(path, array, fmt="%d")


def with_unused_vertices():
    """Return MESH as from a file with two unused vertices, before vertex 0 and after 9."""
    vertices = np.insert(MESH.vertices, [0, 10], 0.0, axis=0)
    return TriangleMesh(vertices, np.where(MESH.faces < 10, MESH.faces + 1, MESH.faces + 2))


def write_gifti(path, columns):
    arrays = [
        nibabel.gifti.GiftiDataArray(column.astype(np.float32), intent="NIFTI_INTENT_SHAPE")
        for column in columns
    ]
    nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), path)


def write_text(path, header, delimiter, columns):
    table = np.column_stack(columns)
    np.savetxt(path, table, delimiter=delimiter, header=header, comments="", fmt="%.17g")


def test_one_column_is_read_from_every_format(tmp_path):
    np.save(tmp_path / "a.npy", VALUES)
    write_text(tmp_path / "a.txt", "", " ", [VALUES])
    write_text(tmp_path / "a.csv", "thickness", ",", [VALUES])
    lines = ["# made by hand", "", *map(repr, VALUES.tolist()), ""]
    (tmp_path / "b.txt").write_text("\r\n".join(lines))
    for name in ("a.npy", "a.txt", "a.csv", "b.txt"):
        assert_array_equal(function(MESH, f"file:{tmp_path / name}"), VALUES)
    for name in ("a.gii", "a.gii.gz"):
        write_gifti(tmp_path / name, [VALUES])
        assert_array_equal(function(MESH, f"file:{tmp_path / name}"), VALUES.astype(np.float32))


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
def test_columns_are_chosen_by_name_or_number(tmp_path, delimiter):
    path = tmp_path / "a, (1) +.csv"
    write_text(path, delimiter.join(["area", '"depth"']), delimiter, [np.arange(COUNT), VALUES])
    for column in ("1", "depth"):
        assert_array_equal(function(MESH, f'file:"{path}",column={column}'), VALUES)
    cases = ("", (2, "column=0", 1)), (",column=dept", ("dept",)), (",column=2", (2,))
    for options, named in cases:
        with raises(FunctionError, *named):
            function(MESH, f'file:"{path}"{options}')


def test_columns_of_arrays_and_gifti_are_chosen(tmp_path):
    np.save(tmp_path / "a.npy", np.column_stack([VALUES, 2 * VALUES]).astype(">f4"))
    write_gifti(tmp_path / "a.gii", [VALUES, 2 * VALUES])
    for name in ("a.npy", "a.gii"):
        found = function(MESH, f"file:{tmp_path / name},column=1")
        assert_array_equal(found, (2 * VALUES).astype(np.float32))


def test_title_of_other_length_is_not_names(tmp_path):
    path = tmp_path / "v.csv"
    path.write_text("a,b,c\n1,2\n3,4\n")
    assert_allclose(read_column(path, "1"), [2, 4])
    with raises(FunctionError, 2):
        read_column(str(path), "c")
    path.write_text("mean curvature\n1\n3\n")
    assert_allclose(read_column(str(path)), [1, 3])


def test_files_have_the_numbers_of_the_mesh_file(tmp_path):
    mesh = with_unused_vertices()
    in_file = np.insert(VALUES, [0, 10], np.nan)
    np.save(tmp_path / "a.npy", in_file)
    assert_array_equal(function(mesh, f"file:{tmp_path / 'a.npy'}"), VALUES)
    in_file[12] = np.inf
    np.save(tmp_path / "a.npy", in_file)
    with raises(FunctionError, 1, COUNT, 12):
        function(mesh, f"file:{tmp_path / 'a.npy'}")


def test_missing_values_are_allowed_on_request(tmp_path):
    values = VALUES.copy()
    values[3] = np.nan
    text = f"file:{tmp_path / 'a.npy'}"
    np.save(tmp_path / "a.npy", values)
    assert_array_equal(function(MESH, text, allow_missing=True), values)
    with_more = function(MESH, f"(coordinate:x + {text})", allow_missing=True)
    assert_array_equal(np.flatnonzero(np.isnan(with_more)), [3])
    with raises(FunctionError):
        function(MESH, text)
    for wrong in (np.full(COUNT, np.nan), np.where(np.arange(COUNT) == 4, np.inf, values)):
        np.save(tmp_path / "a.npy", wrong)
        with raises(FunctionError):
            function(MESH, text, allow_missing=True)
    with raises(FunctionError):
        function(MESH, "expression:sqrt(x)", allow_missing=True)


@pytest.mark.parametrize("name", ["map.txt", "map.npy"])
def test_map_composes_and_counts_from_0_by_default(tmp_path, name):
    target = np.random.default_rng(0).integers(0, COUNT, COUNT)
    save(tmp_path / name, target)
    composed = function(MESH, f"permuted:{tmp_path / name}(coordinate:x + expression:y*(z+1))")
    x, y, z = MESH.vertices.T
    assert_array_equal(composed, (x + y * (z + 1))[target])
    save(tmp_path / name, np.clip(np.arange(COUNT), 1, COUNT - 1))
    assert_array_equal(through(tmp_path / name, MESH), x[np.clip(np.arange(COUNT), 1, COUNT - 1)])


def test_unnamed_index_is_not_a_map_column(tmp_path):
    target = np.random.default_rng(0).permutation(COUNT)
    rows = "".join(f"{k},{target[k]}\n" for k in range(COUNT))
    (tmp_path / "map.csv").write_text(f",0\n{rows}")
    assert_array_equal(read_vertex_map(MESH, str(tmp_path / "map.csv")), target)


@pytest.mark.parametrize("first", [0, 1])
def test_map_has_the_numbers_of_the_mesh_file(tmp_path, first):
    mesh, path = with_unused_vertices(), tmp_path / "map.txt"
    target = np.random.default_rng(0).permutation(COUNT)
    in_file = np.full(COUNT + 2, -1)
    in_file[mesh.vertex_ids] = mesh.vertex_ids[target] + first
    save(path, in_file)
    assert_array_equal(through(path, mesh), mesh.vertices[target, 0])
    if not first:
        in_file[3] = 0
        save(path, in_file)
        with raises(FunctionError, 1, COUNT, 3, 0):
            through(path, mesh)


@pytest.mark.parametrize("bad", [-1, COUNT, 0.5, np.nan, np.inf, 1e300])
def test_wrong_map_entries_are_counted(tmp_path, bad):
    target = np.arange(COUNT, dtype=np.float64)
    target[[4, 6]] = bad
    np.save(tmp_path / "map.npy", target)
    with raises(FunctionError, 2, COUNT, 4):
        through(tmp_path / "map.npy", MESH)


@settings(max_examples=20)
@given(
    seed=st.integers(0, 2**30),
    first=st.sampled_from([0, 1]),
    suffix=st.sampled_from([".txt", ".npy", ".sym.vts"]),
)
def test_permutations_may_count_from_0_or_1(tmp_path_factory, seed, first, suffix):
    order = np.random.default_rng(seed).permutation(COUNT)
    path = tmp_path_factory.mktemp("maps") / f"map{suffix}"
    save(path, order + first)
    assert_array_equal(through(path, MESH), MESH.vertices[order, 0])


def test_ambiguous_pairs_are_refused_as_text(tmp_path):
    pairs = np.arange(2, COUNT - COUNT % 2).reshape(-1, 2)
    save(tmp_path / "pairs.txt", pairs)
    save(tmp_path / "pairs.npy", pairs)
    with raises(FunctionError, 0, COUNT, ".npy"):
        through(tmp_path / "pairs.txt", MESH)
    swapped = np.arange(COUNT)
    swapped[pairs] = pairs[:, ::-1]
    assert_array_equal(through(tmp_path / "pairs.npy", MESH), MESH.vertices[swapped, 0])


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("name", ["pairs.sym.vts", "pairs.txt"])
def test_pairs_are_swapped(tmp_path, name, first):
    pairs = [(i, j) for i, j in enumerate(SWAP) if i < j]
    assert len(pairs) < len(SWAP) / 2  # vertices on the plane of symmetry correspond to themselves
    assert 0 in np.ravel(pairs)
    if first == 1 and len(SWAP) not in np.array(pairs) + 1:
        pairs.append((len(SWAP) - 1,) * 2)
    save(tmp_path / name, np.array(pairs) + first)
    assert_array_equal(through(tmp_path / name), SWAP_VALUES)


def test_symmetry_of_listed_vertices_is_extended_to_all(tmp_path):
    points = np.random.default_rng(3).permutation(len(SWAP))[: len(SWAP) * 3 // 4]
    save(tmp_path / "a.vts", points + 1)
    save(tmp_path / "a.sym.vts", SWAP[points] + 1)
    known = np.isin(np.arange(len(SWAP)), [*points, *SWAP[points]])
    found = through(tmp_path / "a.sym.vts")
    assert_array_equal(found[known], SWAP_VALUES[known])
    edge = np.linalg.norm(np.diff(MIRRORED.vertices[MIRRORED.edges], axis=1), axis=2).max()
    assert np.abs(found - SWAP_VALUES).max() <= 2 * edge
    assert not known.all()
    save(tmp_path / "a.vts", points[1:] + 1)
    with raises(FunctionError, "a.vts"):
        through(tmp_path / "a.sym.vts")


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ([[0, 1], [0, 2]], (0,)),
        ([[0, 1]], (2, 162)),
        ([[0, 1], [5, 500]], (1, 4, 2, 500)),
        (np.zeros((COUNT, 3)), (3,)),
    ],
)
def test_invalid_maps_are_refused(tmp_path, content, named):
    save(tmp_path / "map.txt", content)
    with raises(FunctionError, *named):
        through(tmp_path / "map.txt")


def test_detected_symmetries_compose():
    x, y, z = MIRRORED.vertices.T
    for name, exact in (("mirror", -x + 2 * y + 3 * z), ("rotation", -x - 2 * y + 3 * z)):
        found = function(MIRRORED, f"permuted:{name}(expression:x + 2*y + 3*z)")
        assert_allclose(found, exact, atol=1e-12)
    twice = function(MIRRORED, "permuted:mirror(permuted: mirror (gaussian:vertex=5))")
    assert_array_equal(twice, function(MIRRORED, "gaussian:vertex=5"))


def test_missing_symmetries_are_refused():
    x = MESH.vertices
    uneven = TriangleMesh(x * (1 + 0.3 * np.sin(3 * x[:, [1]] + x[:, [2, 0, 1]])), MESH.faces)
    with raises(FunctionError):
        through("mirror", uneven)
    with raises(FunctionError, "miror", "mirror"):
        through("miror", MESH)


FORMS = ["file:{}", "permuted:{}(coordinate:x)"]


def error_line(path, form="file:{}"):
    with pytest.raises(FunctionError) as caught:
        function(MESH, form.format(f'"{path}"'))
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) <= 600
    return message


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("a.npy", b"PK\x03\x04", ()),
        ("a.npy", npy_of("(6442450944,)", data=bytes(8)), ("size",)),
        ("a.csv", b"", ()),
        ("a.csv", b"a,b\n", ("a,b",)),
        (*("a.csv", b"a,b\n1,2\n3,x\n"), ("x", 1, 0)),
        ("a.csv", b"1,2\n3\n", ()),
        ("a.csv", b"x" * 100_000 + b"\n1\n", (1,)),
        ("a.csv", b"x" * 200_000 + b",y\n1,2\n", ()),
        (*("a.csv", b"a" * 10_000 + b",\x1b[31m,c\n" + b"1,2,3\n" * COUNT), (3, "column=0", 2)),
        ("a.csv", b"1,2\n3," + b"x" * 10_000, ()),
        ("a.csv", b"\x1b" * 10_000, ()),
        ("a.txt", b"1 " * 100_000, (100000,)),
        ("a.txt", b"1" * 100_000, (1,)),
        (*("a.txt", b"1\n\xff\1"), (2, 0, "UTF-8")),
        ("a.txt", b"1\n2\n", (2, COUNT)),
        ("a.gii", b"<GIFTI", ()),
        ("a.gii.gz", b"\x1f\x8b\x08\x00", ()),
        ("a.xyz", b"1", (".npy", ".csv", ".txt", ".gii")),
        ("lh.sulc", b"\xff\xff\xff", ()),
        ("a.mgh", b"\0\0\0\1", ()),
        ("a.mgz", b"\x1f\x8b\x08\x00", ()),
    ],
)
def test_invalid_files_are_refused_in_one_line(tmp_path, name, content, named):
    (tmp_path / name).write_bytes(content)
    line = error_line(tmp_path / name)
    check_message(line, *named)
    assert name in line
    assert error_line(tmp_path / name, FORMS[1])


@pytest.mark.parametrize(
    "path",
    ["missing.npy", "~no_such_user/a.npy", "x" * 300 + ".npy", "missing/a.txt", "missing.gii"],
)
def test_unreadable_files_are_refused(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    with raises(FunctionError):
        function(MESH, f"file:{path}")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("suffix", [".npy", ".csv", ".txt", ".vts", ".sym.vts", ".gii", ".gii.gz"])
def test_special_files_are_refused(tmp_path, suffix, form):
    os.mkfifo(tmp_path / f"pipe{suffix}")
    (tmp_path / f"zero{suffix}").symlink_to("/dev/zero")
    (tmp_path / f"folder{suffix}").mkdir()
    for name, kind in (("pipe", "pipe"), ("zero", "device"), ("folder", "directory")):
        check_message(error_line(tmp_path / f"{name}{suffix}", form), kind)


def test_line_of_other_length_is_named(tmp_path):
    """An error names the line of another length, without NumPy's advice; odd names are readable."""
    (tmp_path / "a.csv").write_text("1,2\n3,4\n5,6,7\n")
    check_message(error_line(tmp_path / "a.csv"), 2, 3)
    for name in ("a\nb.csv", "\x1b[31m.csv", "x" * 200 + ".csv"):
        (tmp_path / name).write_bytes(b"")
        check_message(error_line(tmp_path / name))


def test_column_errors_are_one_line(tmp_path):
    names = ",".join(f"name{number}" for number in range(5000))
    (tmp_path / "a.csv").write_text("\n".join([names, *[",".join(["1"] * 5000)] * COUNT]))
    check_message(error_line(tmp_path / "a.csv", "file:{},column=" + "9" * 5000))
    check_message(error_line(tmp_path / "a.csv", "file:{},column=nome12"), "name12")


def test_did_you_mean_has_bounded_time():
    assert did_you_mean("sourc", ["x" * 1000, "source"]) == " (did you mean 'source'?)"
    assert did_you_mean("a" * 10_000, ["a" * 9999]) == ""
    assert did_you_mean("wort", iter(lambda: "word", "")) == " (did you mean 'word'?)"


def check_outcomes(path):
    """Check that a file has finite values or is refused, as values and as a map."""
    for form in FORMS:
        try:
            values = function(TINY, form.format(path))
        except FunctionError as error:
            line = str(error)
            assert line.isprintable()
        else:
            assert values.shape == (SIZE,)
            assert np.isfinite(values).all()


@settings(max_examples=100)
@given(
    content=st.binary(max_size=60)
    | st.text("0123456789.,;\t\n\r\"'#+-eE naif\x00\x1b", max_size=60).map(str.encode),
    suffix=st.sampled_from(
        [".csv", ".txt", ".npy", ".gii", ".gii.gz", ".sym.vts", ".mgz", ".label", ".sulc"]
    ),
)
def test_any_bytes_are_values_or_refused(tmp_path, content, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(content)
    check_outcomes(path)


FAR_NUMBERS = """
import resource, sys, numpy
from abfm import TriangleMesh
from abfm.functions import function

vertices, faces, path = numpy.load(sys.argv[1]), numpy.load(sys.argv[2]), sys.argv[3]
mesh = TriangleMesh(vertices, faces, numbers=(numpy.arange(len(vertices)) + 7, 10**9))
function(mesh, f"permuted:{path}(coordinate:x)")
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (1 << 29), used + (1 << 29)))
assert (function(mesh, f"permuted:{path}(coordinate:x)") == vertices[::-1, 0]).all()
"""


def test_map_memory_is_bounded_for_large_files(tmp_path):
    """Vertex numbers far above those of the mesh need only a few numbers per file vertex."""
    arrays = {"vertices": TINY.vertices, "faces": TINY.faces, "map": np.arange(SIZE)[::-1] + 7}
    for name, array in arrays.items():
        np.save(tmp_path / f"{name}.npy", array)
    assert python(FAR_NUMBERS, *(tmp_path / f"{name}.npy" for name in arrays)).stderr == ""


def test_given_vertex_numbers_equal_those_of_a_file():
    complete = with_loose_vertex(TINY)
    ids = np.delete(np.arange(SIZE + 1), 5)
    again = TriangleMesh(TINY.vertices, TINY.faces, numbers=(ids, SIZE + 1))
    assert again.messages == complete.messages
    assert (again.vertex_ids == complete.vertex_ids).all()
    assert again.file_vertex_count == complete.file_vertex_count


def test_matlab_part_of_unknown_type_is_refused(tmp_path):
    """A .mat file with a part of unknown type, on which SciPy crashes, is refused."""
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"thickness": np.arange(42.0)})
    content = bytearray(path.read_bytes())
    part = content.index(np.arange(42.0).tobytes()) - 8
    content[part : part + 2] = b"\xbf\xf0"
    path.write_bytes(content)
    with raises(FunctionError, "type", 0xF0BF):
        function(icosphere(1), f"file:{path}")


def test_cifti_with_damaged_xml_is_refused(tmp_path):
    path = tmp_path / "a.dscalar.nii"
    write_values(path, np.arange(42.0), structure="CortexLeft")
    content = path.read_bytes()
    for number in (b'"42"', b'"x2"'):
        changed = content.replace(
            b'SurfaceNumberOfVertices="42"', b"SurfaceNumberOfVertices=" + number
        )
        path.write_bytes(changed.replace(b'IndexCount="42"', b"IndexCount=" + number))
        if number == b'"42"':
            assert_array_equal(function(icosphere(1), f"file:{path}"), np.arange(42.0))
        else:
            with raises(FunctionError, "XML"):
                function(icosphere(1), f"file:{path}")
