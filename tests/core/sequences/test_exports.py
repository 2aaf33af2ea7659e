import csv
import re
from dataclasses import replace

import mne
import nibabel
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm.errors import ResultError
from abfm.flow import Flow
from abfm.io import write_stc
from abfm.reading import open_file, read_collection, vtk_contents
from abfm.sequences import (
    export_intervals,
    export_pvd,
    export_speed,
    export_stc,
    export_tracks,
    read_frames,
    vertex_speed,
)
from abfm.workers.control import CancelledError, Control, controlled
from abfm.workers.progress import reporting_steps
from tests.core.reading.vtk_files import point_data
from tests.core.sequences.rotating_sphere import MESH, SPEED, TIMES, rotating_frames, solved
from tests.messages import check_message, raises
from tests.shapes import with_loose_vertex


def table(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_pvd_has_frames_and_fields(tmp_path):
    sequence, path = solved(), tmp_path / "a sequence.pvd"
    export_pvd(path, sequence)
    found = read_frames(path, MESH, "frame")
    assert_array_equal(found.values, rotating_frames())
    assert_array_equal(found.times, TIMES)
    entries = read_collection(path)
    assert entries[1][1] == "a sequence/a sequence_0001.vtu"
    for k, (_, name) in enumerate(entries):
        interval = min(k, len(sequence) - 1)
        for field in ("divergence", "curl"):
            values = point_data(tmp_path / name, field)[:, 0]
            assert_array_equal(values, getattr(sequence, field)[interval])
        written = (tmp_path / name).read_bytes()
        for certainty in ("uncertainty", "determined"):
            assert f'Name="{certainty}"'.encode() in written
            assert getattr(sequence, certainty)[interval].tobytes() in written
        advected = point_data(tmp_path / name, "advected")[:, 0]
        if k:
            flow = Flow(MESH, sequence.velocity[k - 1], TIMES[k] - TIMES[k - 1])
            assert_allclose(advected, flow.push(sequence.frames[k - 1])[:, 0], atol=1e-12)
            assert (
                np.abs(advected - rotating_frames()[k]).max()
                < 0.3 * np.abs(rotating_frames()[k - 1] - rotating_frames()[k]).max()
            )
        else:
            assert_array_equal(advected, rotating_frames()[0])


def test_pvd_marks_missing_values(tmp_path):
    export_pvd(tmp_path / "whole.pvd", solved())
    complete = vtk_contents(open_file(tmp_path / "whole/whole_0000.vtu"))
    assert "measured" not in complete.point_data
    frames = rotating_frames()[:3].copy()
    frames[1, 7] = np.nan
    known = np.ones(len(MESH.vertices))
    known[11] = 0
    some = abfm.sequence(MESH, frames, mask=known, gamma=0)
    export_pvd(tmp_path / "some.pvd", some)
    for k in range(3):
        file = tmp_path / f"some/some_{k:04}.vtu"
        measured = point_data(file, "measured")[:, 0]
        assert np.flatnonzero(measured == 0).tolist() == [7, 11]
        assert set(measured) == {0, 1}
        [tag] = re.findall(rb'<DataArray[^>]* Name="measured"[^>]*>', file.read_bytes())
        assert b'type="UInt8"' in tag


def test_cancelled_export_changes_no_files(tmp_path):
    def content():
        return {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}

    def cancelled():
        control = Control()

        def stop(now):
            if now is not None and now.task == "writing frames" and (now.done or 0) > 0.5:
                control.cancel()

        with reporting_steps(stop), controlled(control), pytest.raises(CancelledError):
            export_pvd(tmp_path / "a.pvd", solved())
        assert content() == before

    before = content()
    cancelled()
    (tmp_path / "a").mkdir()
    (tmp_path / "a/mine.txt").write_text("mine")
    earlier = replace(solved(), velocity=2 * solved().velocity)
    export_pvd(tmp_path / "a.pvd", earlier)
    before = content()
    assert len(before) == 2 + len(TIMES) + 1
    cancelled()
    export_pvd(tmp_path / "a.pvd", solved())
    assert content().keys() == before.keys()
    assert content() != before


def test_surplus_frames_of_a_longer_sequence_are_removed(tmp_path):
    path, folder = tmp_path / "a(1).pvd", tmp_path / "a(1)"

    def names():
        return {each.relative_to(tmp_path).as_posix() for each in tmp_path.rglob("*.vtu")}

    export_pvd(path, solved())
    others = ["a(1)/a(1)_0099.vtu", "a(1)/mine_0004.vtu", "other/a(1)_0007.vtu", "a(1)_0008.vtu"]
    (tmp_path / "other").mkdir()
    for name in others:
        (tmp_path / name).touch()
    others[0:0] = ["a(1)/a(1)_0050.vtu"]
    (folder / "a(1)_0050.vtu").mkdir()  # a folder, not a file
    listed = [*others[:1], *others[2:], "a(1)/../a(1)/a(1)_0099.vtu", "a(1)/a(1)_0060.vtu"]
    rows = "".join(f'<DataSet timestep="{9 + k}" file="{each}"/>' for k, each in enumerate(listed))
    path.write_text(path.read_text().replace("</Collection>", f"{rows}</Collection>"))
    (folder / "a(1)_0060.vtu").touch()
    short = abfm.sequence(MESH, rotating_frames()[:3], TIMES[:3])
    export_pvd(path, short)
    assert names() == {*others, *(f"a(1)/a(1)_{k:04}.vtu" for k in range(3))}
    assert len(read_frames(path, MESH, "frame").values) == 3
    path.write_text("no list of files")
    (folder / "a(1)_0003.vtu").touch()
    export_pvd(path, short)
    assert names() == {*others, *(f"a(1)/a(1)_{k:04}.vtu" for k in range(4))}


def test_pvd_follows_links_of_its_folder(tmp_path):
    """Frames are written on the disk of the linked folder, and then moved to it."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "a").symlink_to(tmp_path / "disk")
    places = set()

    def look(now):
        places.update(path.parent for path in tmp_path.rglob("*") if path.name.startswith(".abfm"))

    with reporting_steps(look):
        export_pvd(tmp_path / "a.pvd", solved())
    assert tmp_path / "disk" in places
    assert tmp_path not in places
    assert len([*(tmp_path / "disk").iterdir()]) == len(TIMES)
    assert len(read_frames(tmp_path / "a.pvd", MESH, "frame").values) == len(TIMES)


def test_vertex_speed_of_a_rotation_is_accurate():
    middles = MESH.vertices[MESH.faces].mean(axis=1)
    turning = np.cross([0, 0, SPEED], middles)
    found = vertex_speed(replace(solved(), velocity=np.stack([turning, 2 * turning])))
    distance = np.linalg.norm(MESH.vertices[:, :2], axis=1)
    away = distance > 0.5
    assert_allclose(found[0, away], SPEED * distance[away], rtol=0.06)
    assert_allclose(found[1], 2 * found[0])


def test_speed_is_exported_to_mne_and_workbench(tmp_path):
    speed = vertex_speed(solved())
    export_stc(tmp_path / "a-rh.stc", solved())
    found = read_frames(tmp_path / "a-rh.stc", MESH)
    assert_array_equal(found.values, speed.astype(np.float32))
    assert_allclose(found.times, solved().middles, atol=1e-7)
    estimate = mne.read_source_estimate(tmp_path / "a-rh.stc")
    assert_array_equal(estimate.data.T, speed.astype(np.float32))
    assert [each.tolist() for each in estimate.vertices] == [[], MESH.vertex_ids.tolist()]
    export_speed(tmp_path / "lh.a.func.gii", solved())
    image = nibabel.load(tmp_path / "lh.a.func.gii")
    assert_array_equal(np.stack(image.agg_data()), speed.astype(np.float32))
    assert [each.meta["Name"] for each in image.darrays] == ["-0.075", "-0.025", "0.025", "0.075"]
    assert image.meta["AnatomicalStructurePrimary"] == "CortexLeft"


def test_other_hemisphere_file_is_kept(tmp_path):
    """The other hemisphere's file is kept; a note warns if MNE cannot open both (other times)."""
    assert export_stc(tmp_path / "a-lh.stc", solved()) == ""
    assert export_stc(tmp_path / "a-rh.stc", solved()) == ""
    shape = 2 * len(MESH.vertices), len(TIMES) - 1
    assert mne.read_source_estimate(tmp_path / "a").shape == shape
    later = 2 * solved().middles
    path, speed = tmp_path / "a-lh.stc", vertex_speed(solved())
    check_message(write_stc(path, speed, MESH.vertex_ids, later), "a-rh.stc")
    assert_allclose(read_frames(tmp_path / "a-rh.stc", MESH).times, solved().middles, atol=1e-7)


def test_loose_vertices_of_the_file_are_included(tmp_path):
    mesh = with_loose_vertex(MESH)
    found = abfm.sequence(mesh, rotating_frames()[:2], gamma=0.0, parameters=solved().parameters)
    export_speed(tmp_path / "a.func.gii", found)
    values = nibabel.load(tmp_path / "a.func.gii").agg_data()
    assert_array_equal(np.delete(values, 5), vertex_speed(found)[0].astype(np.float32))
    assert np.isnan(values[5])
    export_stc(tmp_path / "a-lh.stc", found)
    assert 5 not in abfm.reading.read_stc((tmp_path / "a-lh.stc").read_bytes()).vertices


def test_tracks_table_has_rows_of_points(tmp_path):
    """The poles of a rotation are on its axis in all intervals; omitted tracks have a note."""
    count = len(solved().tracks(1))
    note = export_tracks(tmp_path / "none.csv", solved(), min_intervals=5)
    check_message(note, "none.csv", count, 5)
    assert table(tmp_path / "none.csv") == []
    assert export_tracks(tmp_path / "t.csv", solved(), min_intervals=4) == ""
    rows = table(tmp_path / "t.csv")
    tracks = solved().tracks(4)
    assert len(rows) == sum(map(len, tracks)) >= 8
    for row in rows:
        track, time = tracks[int(row["track"])], float(row["time"])
        at = int(np.flatnonzero(track.times == time)[0])
        place = [float(row[axis]) for axis in "xyz"]
        assert_array_equal(place, track.points.positions[at])
        assert int(row["face"]) == track.points.faces[at]
        assert (row["kind"], int(row["index"])) == (track.kinds[at], track.index)
    poles = [row for row in rows if row["kind"] == "spiral"]
    assert {int(row["track"]) for row in poles} == {0, 1}
    for row in poles:
        side = np.sign(float(row["z"]))
        assert abs(float(row["z"])) > 0.95
        assert_allclose(float(row["curl"]), side * 2 * SPEED, rtol=0.3)
        assert abs(float(row["divergence"])) < SPEED


def test_intervals_table_has_verdicts(tmp_path):
    export_intervals(tmp_path / "i.csv", solved())
    rows = table(tmp_path / "i.csv")
    assert_array_equal([float(row["start"]) for row in rows], TIMES[:-1])
    assert_array_equal([float(row["end"]) for row in rows], TIMES[1:])
    columns = {name: getattr(solved(), name) for name in ("speed", "residual", "folded")}
    columns["by_flow_lines"] = solved().verified_residual
    for name, expected in columns.items():
        assert_array_equal([float(row[name]) for row in rows], expected)
    assert [row["verdict"] for row in rows] == [each.kind for each in solved().verdicts]


def test_unsolved_intervals_have_empty_cells(tmp_path):
    control = abfm.workers.Control()
    stop = {"on_interval": lambda _: control.cancel(), "control": control}
    found = abfm.sequence(MESH, rotating_frames(), TIMES, solved().parameters, 0.0, **stop)
    export_intervals(tmp_path / "i.csv", found)
    rows = table(tmp_path / "i.csv")
    assert [row["by_flow_lines"] == "" for row in rows] == [False, True, True, True]
    assert [row["verdict"] for row in rows[1:]] == 3 * ["not reached"]


def test_unwritable_exports_are_refused(tmp_path):
    with raises(ResultError, ".pvd"):
        export_pvd(tmp_path / "a.vtu", solved())
    (tmp_path / "taken").write_text("")
    with raises(ResultError):
        export_pvd(tmp_path / "taken.pvd", solved())
    (tmp_path / "folder.pvd").mkdir()
    with raises(ResultError, "folder"):
        export_pvd(tmp_path / "folder.pvd", solved())
    assert not (tmp_path / "folder").exists()
    uneven = abfm.sequence(MESH, rotating_frames()[:4], [0, 1, 2, 5], solved().parameters, 0.0)
    with raises(ResultError):
        export_stc(tmp_path / "a-lh.stc", uneven)
