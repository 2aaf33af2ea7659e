"""FreeSurfer files agree with nibabel, and damaged ones are refused."""

import struct

import nibabel.freesurfer as freesurfer
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from abfm.reading import (
    freesurfer_annotation,
    freesurfer_frames,
    freesurfer_label,
    freesurfer_surface,
    freesurfer_values,
    open_file,
)
from tests.mesh_writers import freesurfer_bytes
from tests.messages import raises
from tests.shapes import icosphere, tetrahedron

seeds = st.integers(0, 2**32 - 1)
COLORS = [(25, 5, 25, 0), (220, 20, 100, 0), (25, 100, 40, 128), (1, 2, 3, 255)]
NAMES = ["unknown", "precentral", "Ärmel", "?"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("freesurfer")


def packed(*numbers):
    return struct.pack(f">{len(numbers)}i", *numbers)


def text(word):
    return packed(len(word.encode()) + 1) + word.encode() + b"\0"


def annotation(colors, version, numbers=(0, 1, 2, 3), order=None):
    """Return an .annot file with vertices in an order, and numbers of their colours."""
    order = range(len(colors)) if order is None else order
    packs = [red | green << 8 | blue << 16 for red, green, blue, _ in COLORS]
    rows = [(k, packs[colors[k]] if colors[k] >= 0 else 0) for k in order]
    data = packed(len(colors), *np.ravel(rows), 1)
    data += packed(4) if version == 1 else packed(-2, max(numbers) + 1)
    data += text("colours.txt") + (b"" if version == 1 else packed(4))
    for number, name, color in zip(numbers, NAMES, COLORS, strict=True):
        data += (b"" if version == 1 else packed(number)) + text(name) + packed(*color)
    return data


@given(seed=seeds, count=st.integers(0, 30))
@settings(max_examples=30)
def test_values_agree_with_nibabel(folder, seed, count):
    values = np.random.default_rng(seed).normal(size=count).astype(np.float32)
    freesurfer.write_morph_data(folder / "lh.sulc", values, fnum=7)
    assert_array_equal(freesurfer_values((folder / "lh.sulc").read_bytes()), values)


@pytest.mark.parametrize("kind", ["u1", "i2", "i4", "f4"])
@pytest.mark.parametrize("shape", [(7, 1, 1), (7, 1, 1, 3), (1, 3, 2, 2)])
@pytest.mark.parametrize("name", ["a.mgh", "a.mgz"])
def test_overlays_agree_with_nibabel(tmp_path, kind, shape, name):
    values = (100 * np.random.default_rng(0).random(shape)).astype(kind)
    freesurfer.MGHImage(values, np.eye(4)).to_filename(tmp_path / name)
    found = freesurfer_frames(open_file(tmp_path / name).data)[0].astype(np.float64)
    expected = values.reshape(*shape[:3], -1).astype(np.float64)
    assert_array_equal(found, expected, strict=True)


def test_surfaces_agree_with_nibabel(tmp_path):
    mesh = icosphere(2)
    volume = {
        "head": [2, 0, 20],
        "valid": "1  # volume info valid",
        "filename": "T1.mgz",
        "volume": [256] * 3,
        "voxelsize": [1.0] * 3,
        "xras": [-1.0, 0, 0],
        "yras": [0.0, 0, -1],
        "zras": [0.0, 1, 0],
        "cras": [5.0, -17, 20],
    }
    for name, info in (("lh.white", volume), ("lh.sphere.reg", None)):
        freesurfer.write_geometry(tmp_path / name, 90 * mesh.vertices, mesh.faces, None, info)
        vertices, faces = freesurfer_surface((tmp_path / name).read_bytes())
        expected = freesurfer.read_geometry(tmp_path / name)
        assert_array_equal(vertices, expected[0], strict=True)
        assert_array_equal(faces, expected[1])


def test_second_line_of_a_surface_may_be_missing():
    """Files of FreeSurfer's development version of 2019, with one line of text, are read."""
    vertices, faces = freesurfer_surface(SURFACE.replace(b"\n\n", b"\n", 1))
    assert_array_equal(vertices, tetrahedron().vertices)
    assert_array_equal(faces, tetrahedron().faces)


@given(seed=seeds, count=st.integers(1, 30))
@settings(max_examples=30)
def test_annotations_agree_with_nibabel(folder, seed, count):
    values = np.random.default_rng(seed).integers(-1, 4, count)
    table = np.array(COLORS)
    path = folder / "lh.annot"
    freesurfer.write_annot(path, values, table, [name.encode() for name in NAMES])
    found = freesurfer_annotation(path.read_bytes())
    assert_array_equal(found.values, values, strict=True)
    assert_array_equal(found.values, freesurfer.read_annot(path)[0])
    assert [found.names[key] for key in range(4)] == NAMES
    for key, (red, green, blue, clear) in enumerate(COLORS):
        expected = red / 255, green / 255, blue / 255, 1 - clear / 255
        assert found.colors[key] == expected


@pytest.mark.parametrize("version", [1, 2])
def test_annotations_may_list_vertices_in_any_order(tmp_path, version):
    colors = np.array([2, -1, 0, 3, 1, 1])
    path = tmp_path / "lh.annot"
    path.write_bytes(annotation(colors, version, order=[3, 1, 0, 5, 4, 2]))
    found = freesurfer_annotation(path.read_bytes())
    assert_array_equal(found.values, colors)
    assert found.names == dict(enumerate(NAMES))
    if version == 2:  # in this version, colours have explicit numbers
        path.write_bytes(annotation(colors, version, numbers=(7, 0, 3, 40)))
        found = freesurfer_annotation(path.read_bytes())
        assert found.values.tolist() == [3, -1, 7, 40, 0, 0]
        assert found.names == dict(zip((7, 0, 3, 40), NAMES, strict=True))


def test_annotation_without_table_has_colors_as_keys():
    """Without a table, keys are the colours in the file; a table without these is refused."""
    content_with_table = annotation([1, 2], 2)
    keys = [red + 256 * green + 65536 * blue for red, green, blue, _ in COLORS[1:3]]
    for data in (content_with_table[:20], content_with_table[:20] + packed(0)):
        found = freesurfer_annotation(data)
        assert (found.values.tolist(), found.names, found.colors) == (keys, {}, {})
    other = packed(2, 0, 1, 1, 1) + content_with_table[20:]
    with raises(ValueError, 4):
        freesurfer_annotation(other)


LABEL = "#!ascii label  , from subject a vox2ras=TkReg\n{}\n5  1.0 -2.5 3.0 0.25\n0 0 0 0 1e-3\n"


def test_label_files_list_vertices_with_values(tmp_path):
    path = tmp_path / "lh.V1.label"
    path.write_text(LABEL.format(2))
    found = freesurfer_label(path.read_bytes())
    assert (found.vertices.tolist(), found.values.tolist()) == ([5, 0], [[0.25], [1e-3]])
    assert_array_equal(found.vertices, freesurfer.read_label(path))
    path.write_text("# nothing\n0\n")
    assert freesurfer_label(path.read_bytes()).vertices.tolist() == []


SURFACE = freesurfer_bytes(tetrahedron().vertices, tetrahedron().faces)
VALUES = b"\xff\xff\xff" + packed(3, 0, 1) + struct.pack(">3f", 1, 2, 3)
ANNOTATION = annotation([0, 1, 2, 3], 2)
OVERLAY = packed(1, 3, 1, 1, 2, 3, 0) + bytes(256) + struct.pack(">6f", *range(6))
LARGE = packed(2**31 - 1)


@pytest.mark.parametrize(
    ("reader", "content", "named"),
    [
        (freesurfer_surface, b"", ("FreeSurfer",)),
        (freesurfer_surface, b"\xff\xff\xfe" + b"a" * 10**6, ()),
        (freesurfer_surface, SURFACE[:20] + LARGE + SURFACE[24:], (2147483647,)),
        (freesurfer_surface, SURFACE[:24] + LARGE + SURFACE[28:], (2147483647,)),
        (freesurfer_surface, SURFACE[:20] + packed(-1) + SURFACE[24:], (-1,)),
        (freesurfer_values, SURFACE, ()),
        (freesurfer_values, VALUES[:3] + LARGE + VALUES[7:], (2147483647,)),
        (freesurfer_values, VALUES[:11] + packed(2) + VALUES[15:], (2,)),
        (freesurfer_values, VALUES + b"\0", (1, 3)),
        (freesurfer_values, b"\0\0\1" + bytes(6), ()),
        (freesurfer_frames, VALUES, (".mgh", -256)),
        (freesurfer_frames, OVERLAY[:280], (280, 284)),
        (freesurfer_frames, OVERLAY[:4] + LARGE + OVERLAY[8:], (24, 2)),
        (freesurfer_frames, OVERLAY[:4] + packed(-1) + OVERLAY[8:], (-1,)),
        (freesurfer_frames, OVERLAY[:16] + packed(0) + OVERLAY[20:], (0, 3)),
        (freesurfer_frames, OVERLAY[:20] + packed(2) + OVERLAY[24:], (2,)),
        (freesurfer_annotation, LARGE + ANNOTATION[4:], (2147483647,)),
        (freesurfer_annotation, packed(1, 1, 0), ()),
        (freesurfer_annotation, packed(2, 0, 0, 0, 0), ()),
        (freesurfer_annotation, packed(0, 1, -3), (3, 1, 2)),
        (freesurfer_annotation, packed(0, 1, 0), (0, 1, 2)),
        (freesurfer_annotation, packed(0, 1, -(2**31)), (2147483648,)),
        (freesurfer_annotation, packed(0, 1, 2**31 - 1, 0), ()),
        (freesurfer_annotation, packed(0, 1, 1, 2**31 - 1), (2147483647,)),
        (freesurfer_annotation, packed(0, 1, 1, -5), (-5,)),
        (freesurfer_annotation, packed(0, 1, 1, 0, 0, 256, 0, 0, 0), (0, 255)),
        (freesurfer_annotation, packed(0, 1, -2, 2, 0, 2) + 2 * packed(1, 0, 0, 0, 0, 0), (1,)),
        (freesurfer_label, b"", ()),
        (freesurfer_label, b"#\n1 2\n", ()),
        (freesurfer_label, b"#\n" + b"9" * 5000, (0,)),
        (freesurfer_label, LABEL.format(3).encode(), (3, 2)),
        (freesurfer_label, b"#\n1\n-1 0 0 0 0", ()),
        (freesurfer_label, b"#\n1\n1 0 0 0 nan", ()),
        (freesurfer_label, b"#\n1\n1 0 0 0 " + b"x" * 10**5, ()),
    ],
)
def test_inconsistent_files_are_refused(tmp_path, reader, content, named):
    with raises(ValueError, *named) as caught:
        reader(content)
    assert len(str(caught.value)) < 300
    assert str(caught.value).isprintable()
