"""Result files, exports and the atomic replacement of files."""

from __future__ import annotations

import csv
import json
import os
import stat
import sys
import xml.etree.ElementTree as ElementTree
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_array_equal

from abfm.errors import ResultError
from abfm.io import (
    FORMAT_VERSION,
    export_energy_csv,
    export_ply,
    export_vtu,
    load_arrays,
    save_arrays,
    write_atomically,
)
from tests.core.reading.hostile import refusal, with_flipped_bits
from tests.shapes import square, tetrahedron, torus

Arrays = dict[str, Any]


def result_arrays() -> Arrays:
    """What a match of two channels with three fields on a square of 16 vertices leaves."""
    mesh, random = square(3), np.random.default_rng(7)
    vertices, faces = len(mesh.vertices), len(mesh.faces)
    return {
        "vertices": mesh.vertices,
        "faces": mesh.faces,
        "source": random.normal(size=(vertices, 2)),
        "target": random.normal(size=(vertices, 2)),
        "advected": random.normal(size=(vertices, 2)),
        "velocity": random.normal(size=(3, faces, 3)),
        "energy_history": random.uniform(size=(5, 3)),
        "stages": np.array([0, 0, 1, 1, 2]),
        "mismatch": 0.03125,
        "stop_reason": "iteration limit",
        "parameters": json.dumps({"tau": 1, "method": "linearised", "note": "ümlaut ∇"}),
        "vertex_ids": np.arange(vertices) + 3,
        "file_vertex_count": vertices + 3,
        "channels_given": True,
        "weights": np.array([1.0, 2.0]),
        "mask": random.uniform(size=vertices),
    }


def saved_by_numpy(path: Path, **changes: Any) -> Path:
    """A result file with some arrays changed, or left out where None, behind the writer's back."""
    arrays = {"format_version": FORMAT_VERSION, **result_arrays(), **changes}
    np.savez(path, **{name: value for name, value in arrays.items() if value is not None})
    return path


error_line = partial(refusal, load_arrays)


class TestResultFile:
    @pytest.mark.parametrize("left_out", [(), ("mask",)])
    def test_everything_comes_back_exactly(self, tmp_path: Path, left_out: tuple[str, ...]) -> None:
        given = {name: value for name, value in result_arrays().items() if name not in left_out}
        save_arrays(tmp_path / "m.npz", given)
        loaded = load_arrays(tmp_path / "m.npz")
        assert loaded.keys() == given.keys()
        for name, value in given.items():
            assert_array_equal(loaded[name], value, err_msg=name, strict=True)

    def test_is_plain_numpy_with_the_parameters_as_json_text(self, tmp_path: Path) -> None:
        save_arrays(tmp_path / "m.npz", result_arrays())
        with np.load(tmp_path / "m.npz", allow_pickle=False) as file:
            assert file["format_version"] == FORMAT_VERSION
            assert file["parameters"].shape == ()
            assert file["parameters"].dtype.kind == "U"
            assert json.loads(str(file["parameters"]))["tau"] == 1
            assert file["velocity"].shape == (3, 18, 3)

    def test_same_arrays_give_the_same_bytes(self, tmp_path: Path) -> None:
        save_arrays(tmp_path / "a.npz", result_arrays())
        save_arrays(tmp_path / "b.npz", result_arrays())
        assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()

    def test_name_is_kept_without_suffix(self, tmp_path: Path) -> None:
        save_arrays(tmp_path / "result", result_arrays())
        assert os.listdir(tmp_path) == ["result"]
        assert len(load_arrays(tmp_path / "result")["vertices"]) == 16

    def test_other_number_types_are_converted(self, tmp_path: Path) -> None:
        arrays = result_arrays()
        path = saved_by_numpy(
            tmp_path / "m.npz",
            faces=arrays["faces"].astype(np.uint16),
            velocity=arrays["velocity"].astype(">f4"),
            mismatch=1,
        )
        loaded = load_arrays(path)
        assert loaded["faces"].dtype == np.int64
        assert loaded["velocity"].dtype == np.float64
        assert loaded["mismatch"].dtype == np.float64

    def test_arrays_of_later_versions_are_ignored(self, tmp_path: Path) -> None:
        assert "colour" not in load_arrays(saved_by_numpy(tmp_path / "m.npz", colour=np.ones(3)))

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"velocity": None}, "lacks velocity"),
            ({"source": None, "target": None}, "lacks source, target"),
            ({"format_version": None}, "format_version is None; expected"),
            ({"format_version": FORMAT_VERSION + 1}, "upgrade abfm"),
            ({"format_version": 0}, "format_version is 0"),
            ({"format_version": "one"}, "format_version is .one."),
            ({"vertices": np.zeros((16, 2))}, r"vertices has shape \(16, 2\); expected \(V, 3\)"),
            ({"faces": np.zeros((0, 3), dtype=int)}, r"faces has shape \(0, 3\)"),
            ({"faces": np.full((18, 3), 16)}, "faces has an index outside 0 to 15"),
            ({"faces": np.full((18, 3), -1)}, "faces has an index outside 0 to 15"),
            ({"faces": np.zeros((18, 3))}, "faces has type float64; expected integer"),
            ({"source": np.zeros(16)}, r"source has shape \(16,\); expected \(16, C\)"),
            ({"target": np.zeros((16, 3))}, r"target has shape \(16, 3\); expected \(16, 2\)"),
            ({"advected": np.zeros((15, 2))}, r"advected has shape \(15, 2\); expected \(16, 2\)"),
            ({"advected": np.full((16, 2), 1j)}, "advected has type complex128"),
            (
                {"velocity": np.zeros((3, 17, 3))},
                r"velocity has shape \(3, 17, 3\); expected \(N, 18, 3\)",
            ),
            ({"velocity": np.zeros((0, 18, 3))}, r"velocity has shape \(0, 18, 3\)"),
            ({"velocity": np.full((1, 18, 3), np.nan)}, "velocity has values that are not finite"),
            (
                {"energy_history": np.full((5, 3), np.inf)},
                "energy_history has values that are not finite",
            ),
            ({"stages": np.zeros(4, dtype=int)}, r"stages has shape \(4,\); expected \(5\)"),
            ({"vertex_ids": np.arange(16) + 4}, "vertex_ids has an index outside 0 to 18"),
            ({"vertex_ids": np.arange(16)[::-1] + 3}, "vertex_ids do not ascend"),
            ({"weights": np.ones(3)}, r"weights has shape \(3,\)"),
            ({"mask": np.ones(15)}, r"mask has shape \(15,\)"),
            ({"channels_given": 1}, "channels_given has type int64; expected boolean"),
            ({"stop_reason": b"converged"}, "stop_reason has type .S9; expected text"),
            ({"stop_reason": ["a", "b"]}, r"stop_reason has shape \(2,\)"),
            ({"parameters": "{'tau': 1}"}, "not JSON"),
            ({"parameters": "[1]"}, "not one flat JSON object"),
            ({"parameters": '{"tau": 1, "more": {"a": 1}}'}, "not one flat JSON object"),
            ({"parameters": '{"alpha": 1}'}, "tau = None"),
            ({"parameters": '{"tau": true}'}, "tau = True"),
            ({"parameters": '{"tau": NaN}'}, "tau = nan"),
            ({"parameters": '{"tau": 1' + 400 * "0" + "}"}, "tau = inf"),
            ({"source": np.array([[{}]], dtype=object)}, "damaged"),
        ],
    )
    def test_wrong_content_is_named(self, tmp_path: Path, change: Arrays, words: str) -> None:
        with pytest.raises(ResultError, match=words):
            load_arrays(saved_by_numpy(tmp_path / "m.npz", **change))
        assert "; " in error_line(tmp_path / "m.npz")

    def test_other_files_are_refused(self, tmp_path: Path) -> None:
        for content in (b"", b"OFF\n4 4 0\n", b"\x80\x04N."):
            (tmp_path / "m.npz").write_bytes(content)
            assert "no result file of abfm" in error_line(tmp_path / "m.npz")
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as file:
            file.writestr("readme.txt", "hello")
        assert "no result file of abfm" in error_line(tmp_path / "a.zip")
        with zipfile.ZipFile(tmp_path / "b.zip", "w") as file:
            file.writestr("format_version.npy", "hello")
        assert "format_version" in error_line(tmp_path / "b.zip")

        assert "No such file" in error_line(tmp_path / "none.npz")
        assert "directory" in error_line(tmp_path)

    def test_damage_is_noticed(self, tmp_path: Path) -> None:
        path, given = tmp_path / "m.npz", result_arrays()
        save_arrays(path, given)
        whole = path.read_bytes()

        def check(loaded: Arrays) -> None:
            assert loaded.keys() == given.keys()
            for name, array in loaded.items():
                assert_array_equal(array, given[name])

        with_flipped_bits(path, load_arrays, check)
        for length in range(0, len(whole), len(whole) // 50):
            path.write_bytes(whole[:length])
            assert "cut short" in error_line(path)

    def test_what_would_not_load_is_not_saved(self, tmp_path: Path) -> None:
        path = tmp_path / "m.npz"
        with pytest.raises(
            ResultError, match=r"m\.npz not written: velocity has values that are not finite"
        ):
            save_arrays(path, result_arrays() | {"velocity": np.full((1, 18, 3), np.nan)})
        with pytest.raises(ResultError, match="no place for colour"):
            save_arrays(path, result_arrays() | {"colour": np.ones(3)})
        assert os.listdir(tmp_path) == []


class TestWriteAtomically:
    def test_works_in_the_same_folder_under_the_same_suffix(self, tmp_path: Path) -> None:
        with write_atomically(tmp_path / "a.tar.gz") as temporary:
            assert temporary.parent == tmp_path
            assert temporary.suffix == ".gz"

    def test_a_failure_leaves_the_old_file(self, tmp_path: Path) -> None:
        path = tmp_path / "a.txt"
        path.write_text("old")

        def interrupted() -> None:
            with write_atomically(path) as temporary:
                temporary.write_text("half")
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert path.read_text() == "old"
        assert os.listdir(tmp_path) == ["a.txt"]

    def test_the_data_is_on_the_disk_before_the_old_file_goes(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        path = tmp_path / "a.txt"
        path.write_text("old")
        flushed = []
        monkeypatch.setattr(os, "fsync", lambda _: flushed.append(path.read_text()))
        with write_atomically(path) as temporary:
            temporary.write_text("new")
        assert flushed[0] == "old"

    @pytest.mark.parametrize("mode", [0o600, 0o644])
    def test_permissions_stay(self, tmp_path: Path, mode: int) -> None:
        path = tmp_path / "a.txt"
        path.touch()
        path.chmod(mode)
        with write_atomically(path) as temporary:
            temporary.write_text("new")
        assert stat.S_IMODE(path.stat().st_mode) == mode

    def test_a_new_file_gets_the_usual_permissions(self, tmp_path: Path) -> None:
        (tmp_path / "usual").touch()
        with write_atomically(tmp_path / "new") as temporary:
            temporary.write_text("new")
        assert (tmp_path / "new").stat().st_mode == (tmp_path / "usual").stat().st_mode

    def test_a_link_keeps_pointing(self, tmp_path: Path) -> None:
        (tmp_path / "link").symlink_to(tmp_path / "file")
        with write_atomically(tmp_path / "link") as temporary:
            temporary.write_text("new")
        assert (tmp_path / "link").is_symlink()
        assert (tmp_path / "file").read_text() == "new"


def read_vtu(path: Path) -> dict[str, np.ndarray]:
    """Every array of a VTU file with raw appended data, by name, as the VTK file format
    describes it.
    """
    head, _, data = path.read_bytes().partition(b'<AppendedData encoding="raw">')
    data = data[data.index(b"_") + 1 :]
    root = ElementTree.fromstring(head + b"</VTKFile>")
    assert root.attrib == {
        "type": "UnstructuredGrid",
        "version": "1.0",
        "byte_order": {"little": "LittleEndian", "big": "BigEndian"}[sys.byteorder],
        "header_type": "UInt64",
    }
    arrays = {}
    for element in root.iter("DataArray"):
        dtype = np.dtype(element.attrib["type"].lower())
        start = int(element.attrib["offset"])
        size = int(np.frombuffer(data, np.uint64, 1, start)[0])
        array = np.frombuffer(data, dtype, size // dtype.itemsize, start + 8)
        components = int(element.attrib["NumberOfComponents"])
        arrays[element.attrib["Name"]] = array.reshape(-1, components) if components > 1 else array
    return arrays


class TestExports:
    mesh = torus(7, 5)
    random = np.random.default_rng(3)
    f, colours, v_map = (
        random.normal(size=35),
        random.normal(size=(35, 4)),
        random.normal(size=(35, 3)),
    )
    area, velocity = random.uniform(size=70), random.normal(size=(70, 3))

    def test_vtu_keeps_every_digit(self, tmp_path: Path) -> None:
        path = tmp_path / "a.b.vtu"
        export_vtu(
            path,
            self.mesh,
            {"f": self.f, "colours": self.colours, "map": self.v_map},
            {"area": self.area, "velocity": self.velocity, "flipped": self.area > 0.5},
        )
        assert os.listdir(tmp_path) == ["a.b.vtu"]
        arrays = read_vtu(path)
        assert_array_equal(arrays["points"], self.mesh.vertices)
        assert_array_equal(arrays["connectivity"].reshape(-1, 3), self.mesh.faces)
        assert_array_equal(arrays["offsets"], np.arange(3, 211, 3))
        assert_array_equal(arrays["types"], np.full(70, 5))  # VTK_TRIANGLE
        assert_array_equal(arrays["f"], self.f)
        assert_array_equal(
            np.stack([arrays[f"colours_{k}"] for k in range(4)], axis=1), self.colours
        )
        assert_array_equal(arrays["map"], self.v_map)
        assert_array_equal(arrays["area"], self.area)
        assert_array_equal(arrays["velocity"], self.velocity)
        assert_array_equal(arrays["flipped"], self.area > 0.5)

    def test_ply_keeps_every_digit(self, tmp_path: Path) -> None:
        path = tmp_path / "a.ply"
        export_ply(
            path,
            self.mesh,
            {"f": self.f, "colours": self.colours},
            {"area": self.area, "velocity": self.velocity},
        )
        read = trimesh.load_mesh(path, process=False)
        assert_array_equal(read.vertices, self.mesh.vertices)
        assert_array_equal(read.faces, self.mesh.faces)
        points, cells = (read.metadata["_ply_raw"][name]["data"] for name in ("vertex", "face"))
        assert_array_equal(points["f"], self.f)
        assert_array_equal(
            np.stack([points[f"colours_{k}"] for k in range(4)], axis=1), self.colours
        )
        assert_array_equal(cells["area"].ravel(), self.area)
        assert_array_equal(
            np.stack([cells[f"velocity_{k}"].ravel() for k in range(3)], axis=1), self.velocity
        )

    def test_ply_without_data_is_a_plain_mesh(self, tmp_path: Path) -> None:
        export_ply(tmp_path / "a.ply", tetrahedron(), {}, {})
        assert (
            b"property double z\nelement face 4\nproperty list uchar int vertex_indices\n"
            b"end_header\n" in (tmp_path / "a.ply").read_bytes()
        )

    @pytest.mark.parametrize(
        ("points", "cells", "words"),
        [
            ({"f": np.ones(34)}, {}, r"'f' has shape \(34,\); expected \(35,\) or \(35, C\)"),
            ({}, {"v": np.ones((35, 3))}, r"'v' has shape \(35, 3\); expected \(70,\)"),
            ({"f": np.ones((35, 2, 2))}, {}, r"'f' has shape \(35, 2, 2\)"),
            ({"my f": np.ones(35)}, {}, "cannot be named 'my f'"),
            ({}, {"<v>": np.ones(70)}, "cannot be named '<v>'"),
            ({"f": np.ones((35, 2)), "f_1": np.ones(35)}, {}, "cannot be named 'f_1'"),
        ],
    )
    def test_data_that_does_not_fit_is_refused(
        self, tmp_path: Path, points: Arrays, cells: Arrays, words: str
    ) -> None:
        for export, name in ((export_ply, "a.ply"), (export_vtu, "a.vtu")):
            with pytest.raises(ResultError, match=words):
                export(tmp_path / name, self.mesh, points, cells)
        assert os.listdir(tmp_path) == []

    def test_names_of_the_format_are_refused(self, tmp_path: Path) -> None:
        with pytest.raises(ResultError, match="cannot be named 'x'"):
            export_ply(tmp_path / "a.ply", self.mesh, {"x": self.f}, {})
        with pytest.raises(ResultError, match=r"must end in \.vtu"):
            export_vtu(tmp_path / "a.vtk", self.mesh, {}, {})

    def test_energy_table(self, tmp_path: Path) -> None:
        history = np.random.default_rng(1).uniform(size=(3, 3)) ** 40
        export_energy_csv(tmp_path / "energy.csv", history, np.array([0, 0, 1]))
        with (tmp_path / "energy.csv").open(newline="") as file:
            head, *rows = csv.reader(file)
        assert head == ["iteration", "stage", "total", "regularity", "mismatch"]
        assert [row[:2] for row in rows] == [["0", "0"], ["1", "0"], ["2", "1"]]
        assert_array_equal(np.array([row[2:] for row in rows], dtype=float), history)
