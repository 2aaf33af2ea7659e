"""Result files that lie: about sizes, in zips that overlap or are compressed, and in values that
make no sense.
"""

import os
import shutil
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from abfm import Match, Parameters, ResultError, load_match, match
from abfm.io import load_arrays
from abfm.io.results import open_archive
from tests.core.reading.hostile import (
    bomb,
    load_or_refuse,
    members,
    npy_of,
    one_byte_changed,
    overlapping_zip,
    refusal,
    rewrite,
    zipped,
)
from tests.processes import python
from tests.shapes import icosphere, with_loose_vertex

ROOT = Path(__file__).parents[3]
SPHERE = with_loose_vertex(icosphere(0))
X, Y, Z = SPHERE.vertices.T
V, F = len(SPHERE.vertices), len(SPHERE.faces)


@pytest.fixture(scope="module")
def result() -> Match:
    return match(SPHERE, X, Y, Parameters(iterations=2, levels=1), mask=np.ones(V))


@pytest.fixture
def saved(tmp_path: Path, result: Match) -> Path:
    result.save(tmp_path / "m.npz")
    return tmp_path / "m.npz"


def put(path: Path, **arrays: Any) -> None:
    """Write a result anew with other arrays; bytes are put as they are."""
    rewrite(path, {f"{name}.npy": array for name, array in arrays.items()})


error_line = partial(refusal, load_match)


def same_shape(loaded: Match) -> None:
    assert loaded.velocity.shape == (1, F, 3)


def test_one_wrong_byte_of_a_header_is_noticed_though_the_zip_is_whole(saved: Path) -> None:
    content = members(saved)
    for name in ("velocity.npy", "stop_reason.npy"):
        whole = content[name]
        for changed in one_byte_changed(whole, 128):
            saved.write_bytes(zipped(content | {name: changed}))
            load_or_refuse(saved, load_match, same_shape)


@pytest.mark.parametrize(
    "shape", ["(6442450944,)", "(1, 9999999999, 3)", "(999999999999999999, 0, 3)"]
)
def test_shapes_are_held_against_sizes(saved: Path, shape: str) -> None:
    put(saved, velocity=npy_of(shape, data=bytes(8)))
    assert "velocity" in error_line(saved)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mask": -np.ones(V)}, "mask has the value -1; expected 0 to inf"),
        ({"weights": np.array([-0.5])}, "weights has the value -0.5"),
        ({"mismatch": np.array(-1.0)}, "mismatch has the value -1"),
        ({"verified_mismatch": np.array(-1.0)}, "verified_mismatch has the value -1"),
        ({"mask": np.zeros(V)}, "mask must be finite, not negative, and not zero everywhere"),
        ({"weights": np.zeros(1)}, "weights must be finite, not negative, and not zero everywhere"),
        (
            {"source": np.full((V, 1), 1e200)},
            "source has the value 1e+200; expected -1e+154 to 1e+154",
        ),
        ({"target": np.full((V, 1), -1e308)}, "target has the value -1e+308"),
        ({"advected": np.full((V, 1), 1e155)}, "advected has the value 1e+155"),
        (
            {"velocity": np.full((1, F, 3), 1e300)},
            "velocity has the value 1e+300; expected up to 1e+154",
        ),
        ({"folded": np.array(1.5)}, "folded has the value 1.5; expected 0 to 1"),
        ({"folded": np.array(np.nan)}, "folded has values that are not finite"),
        ({"stages": np.full(3, -1)}, "stages has"),
        (
            {"file_vertex_count": np.array(10**8)},
            f"the mesh file had 100000000 vertices, and {V} are used",
        ),
        (
            {"file_vertex_count": np.array(4 * 10**18)},
            "the mesh file had 4000000000000000000 vertices",
        ),
        ({"file_vertex_count": np.array(2**63, dtype=np.uint64)}, "beyond those of 64 bits"),
        ({"format_version": np.zeros((100, 100))}, "format_version is array"),
        ({"format_version": np.array("x\n" * 5000)}, "format_version is 'x"),
        ({"format_version": np.array([1])}, "format_version is array"),
        ({"velocity": np.array("x\n" * 5000)}, "velocity has type"),
        ({"stop_reason": np.array("a\nb")}, "some that cannot be shown"),
        ({"stop_reason": np.array("\x1b[31m")}, "some that cannot be shown"),
        ({"stop_reason": np.array("a" * 10_001)}, "more than 10000 characters"),
        ({"parameters": np.array("[" * 9000)}, "parameters are not JSON"),
        ({"parameters": np.array('{"tau": 1, "method": "' + "x" * 5000 + '"}')}, "method is 'xxx"),
        ({"parameters": np.array('{"tau": 1, "' + "x" * 5000 + '": 1}')}, "unknown parameter 'xxx"),
        (
            {"parameters": np.array('{"tau": 1, "alpha": ' + "1" * 5000 + "}")},
            "a number of too many digits",
        ),
        ({"parameters": np.array('{"tau": 1, "alpha": Infinity}')}, "alpha is inf"),
        ({"parameters": np.array('{"tau": 1, "alpha": [[[[]]]]}')}, "alpha is [[[[]]]]"),
        ({"parameters": np.array('{"tau": 1, "method": []}')}, "method is []"),
        ({"remedies": np.array("[" * 9000)}, "the remedies are '[[["),
        ({"remedies": np.array("5")}, "the remedies are '5'"),
        ({"remedies": np.array('{"a": 1}')}, "the remedies are"),
        ({"remedies": np.array('[{"label": [], "words": ""}]')}, "the label of a remedy is no str"),
        (
            {"remedies": np.array('[{"label": "", "words": "", "parameters": 3}]')},
            "the remedies are",
        ),
        ({"verdict": np.array(["pink", "", ""])}, "the verdict is 'pink'"),
        ({"verdict": np.full((3,), "\ud800").astype("<U1")}, "cannot be shown"),
        ({"verdict": npy_of("(3,)", "<U1", b"\xff" * 12)}, "verdict"),
        ({"channels_given": npy_of("()", "|b1", b"\x02")}, "neither 0 nor 1"),
    ],
)
def test_values_that_make_no_sense_are_named(
    saved: Path, changes: dict[str, Any], words: str
) -> None:
    put(saved, **changes)
    assert words in error_line(saved)


def test_large_and_small_values_that_were_once_written_load(saved: Path) -> None:
    put(
        saved,
        source=np.full((V, 1), 1e-160),
        target=np.full((V, 1), 1e150),
        velocity=np.full((1, F, 3), 1e140),
    )
    assert load_match(saved).source.max() == 1e-160


def test_a_vertex_that_no_face_uses_is_refused(saved: Path) -> None:
    arrays = load_arrays(saved)
    kept = ~(arrays["faces"] == V - 1).any(axis=1)
    put(saved, faces=arrays["faces"][kept], velocity=arrays["velocity"][:, kept])
    assert f"1 of its {V} vertices are in no face" in error_line(saved)
    with pytest.raises(ResultError, match="in no face"):
        load_arrays(saved)


def test_vertices_that_the_mesh_file_had_besides_need_no_room(saved: Path) -> None:
    assert load_match(saved).mesh.messages == SPHERE.messages
    sparse = saved.with_name("sparse.npz")
    shutil.copy(saved, sparse)
    put(sparse, file_vertex_count=np.array(V + 9_999_999))
    code = (
        "import sys, abfm; from tests import peak_memory\n"
        "abfm.load_match(sys.argv[1]); before = peak_memory.megabytes()\n"
        "mesh = abfm.load_match(sys.argv[2]).mesh; print(mesh.file_vertex_count, *mesh.messages)\n"
        "print(peak_memory.megabytes() - before < 8)  # not a byte for each"
    )
    done = python(code, saved, sparse, check=True, cwd=ROOT)
    assert done.stdout == (
        f"{V + 9_999_999} 9999999 vertices that no face uses were dropped (for example vertex 5)\n"
        "True\n"
    )


def test_members_that_are_not_listed_are_not_read(saved: Path) -> None:
    content = members(saved)
    saved.write_bytes(zipped(content | {"unknown.npy": b"no array"}))
    assert load_match(saved).mismatch >= 0
    zeros = npy_of("(100000000,)", "|u1", bytes(100_000_000))
    saved.write_bytes(zipped(content | {"unknown.npy": zeros}, zipfile.ZIP_DEFLATED))
    assert load_match(saved).mismatch >= 0


def test_what_a_zip_unpacks_to_is_bounded_by_its_size(saved: Path, tmp_path: Path) -> None:
    content = members(saved)
    data = npy_of("(2, 40000000)", "|u1") + bytes(80_000_000)
    saved.write_bytes(zipped(content | {"source.npy": data}, zipfile.ZIP_DEFLATED))
    assert "more bytes than a zip of this size can hold" in error_line(saved)
    saved.write_bytes(zipped(content | {"source.npy": bytes(1000)}, zipfile.ZIP_LZMA))
    assert "a method other than deflate" in error_line(saved)
    overlapping_zip(
        tmp_path / "overlap.npz", [f"{number}.npy" for number in range(30)], bytes(4_000_000)
    )
    with (  # newer versions of Python refuse overlapping members themselves
        pytest.raises(
            ResultError, match=r"more bytes than a zip of this size can hold|Overlapped entries"
        ),
        open_archive(tmp_path / "overlap.npz", "result", "") as archive,
    ):
        assert all(archive.read(f"{number}.npy") for number in range(30))


def test_a_zip_that_lies_about_a_size_is_refused(saved: Path) -> None:
    content = members(saved)
    packed = bomb(64 << 20)
    whole = zipped(content | {"mask.npy": packed})
    for size in (1 << 40, 100, len(packed) - 1):
        for width in (4, 8):
            lie = whole.replace(
                len(packed).to_bytes(width, "little"), (size % 256**width).to_bytes(width, "little")
            )
            saved.write_bytes(lie)
            error_line(saved)


def test_devices_and_pipes_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    (tmp_path / "zero.npz").symlink_to("/dev/zero")
    (tmp_path / "random.npz").symlink_to("/dev/urandom")
    assert "it is a pipe, not a file" in error_line(tmp_path / "pipe.npz")
    assert "it is a device, not a file" in error_line(tmp_path / "zero.npz")
    assert "it is a device, not a file" in error_line(tmp_path / "random.npz")


def test_names_that_cannot_be_printed_are_told_in_one_line(tmp_path: Path) -> None:
    for name in ("a\nb.npz", "\x1b[31m.npz", "\u202e.npz", "x" * 200 + ".npz"):
        (tmp_path / name).write_bytes(b"no zip")
        with pytest.raises(ResultError) as caught:
            load_match(tmp_path / name)
        assert str(caught.value).isprintable()
        assert "no result file of abfm" in str(caught.value)
