import json

import nibabel
import numpy as np
import pytest
from nibabel.freesurfer import MGHImage
from numpy.testing import assert_allclose, assert_array_equal

from abfm import load
from abfm.calculus.channels import extend
from abfm.errors import FunctionError, ResultError, SeveralArraysError
from abfm.functions import sources as source_frames
from abfm.io import write_stc
from abfm.loading import task_of_file
from abfm.reading import vtk_contents
from abfm.sequences import read_frames
from abfm.sequences.reading import vtk_frames
from tests.core.reading.vtk_files import vtk_bytes
from tests.core.sequences.rotating_sphere import MESH, TIMES, rotating_frames, solved
from tests.messages import check_message, raises
from tests.shapes import icosphere, with_loose_vertex

FRAMES = rotating_frames()
COUNT = len(MESH.vertices)
SINGLE = FRAMES.astype(np.float32).astype(np.float64)
CHANNELS = np.stack([FRAMES, -FRAMES], axis=2)
ROWS = (f"its {COUNT} rows are the vertices, its columns the frames",)


def gifti(path, arrays, step=None, intent="NIFTI_INTENT_TIME_SERIES"):
    meta = {} if step is None else {"TimeStep": step}
    new, about = nibabel.gifti.GiftiDataArray, nibabel.gifti.GiftiMetaData(meta)
    darrays = [new(np.asarray(each, np.float32), intent, meta=about) for each in arrays]
    nibabel.save(nibabel.gifti.GiftiImage(darrays=darrays), path)


def series(folder, times=TIMES, data=FRAMES, name="wave_{:03}.vtu", has_time=False):
    """Write a file for each frame; return their paths."""
    paths = [folder / name.format(k) for k in range(len(data))]
    for path, time, frame in zip(paths, times, data, strict=True):
        arrays = {"u": frame, "other": np.zeros(len(frame))}
        path.write_bytes(vtk_bytes(MESH.vertices, arrays, time=time if has_time else None))
    return paths


@pytest.mark.parametrize(
    ("given", "expected", "notes"),
    [
        (FRAMES, FRAMES, ()),
        (FRAMES.T, FRAMES, ROWS),
        (CHANNELS, CHANNELS, ()),
        (CHANNELS.swapaxes(0, 1), CHANNELS, (f"{ROWS[0]} (5 frames of 2 channels)",)),
        (np.moveaxis(CHANNELS, 1, 2), CHANNELS, ()),
        (np.asfortranarray(FRAMES), FRAMES, ()),
        (FRAMES.astype(np.float16), FRAMES.astype(np.float16), ()),
        (FRAMES > 0, FRAMES > 0, ()),
        (FRAMES.astype(">f8"), FRAMES, ()),
        ((100 * FRAMES).astype(np.int16), (100 * FRAMES).astype(np.int16), ()),
    ],
)
def test_arrays_may_have_frames_or_vertices_first(tmp_path, given, expected, notes):
    np.save(tmp_path / "a.npy", given)
    np.savez(tmp_path / "a.npz", other=given)  # the name of a single array does not matter
    for name in ("a.npy", "a.npz"):
        found = read_frames(tmp_path / name, MESH)
        assert_array_equal(found.values, expected)
        assert found.values.dtype == np.float64
        assert (found.times, found.notes) == (None, notes)


def test_square_arrays_have_frames_first(tmp_path):
    square = np.random.default_rng(0).normal(size=(COUNT, COUNT))
    np.save(tmp_path / "a.npy", square)
    found = read_frames(tmp_path / "a.npy", MESH)
    assert_array_equal(found.values, square)
    (note,) = found.notes
    check_message(note)


def test_npz_may_contain_times(tmp_path):
    np.savez(tmp_path / "a.npz", frames=FRAMES, times=TIMES, mine=CHANNELS)
    found = read_frames(tmp_path / "a.npz", MESH)
    assert_array_equal(found.values, FRAMES)
    assert_array_equal(found.times, TIMES)
    assert_array_equal(read_frames(tmp_path / "a.npz", MESH, "mine").values, CHANNELS)


def test_sequence_files_are_read_as_frames(tmp_path):
    solved().save(tmp_path / "s.npz")
    found = read_frames(tmp_path / "s.npz", MESH)
    assert_array_equal(found.values, load(tmp_path / "s.npz").frames)
    assert_array_equal(found.times, TIMES)


def test_nonfinite_values_are_preserved_with_a_note(tmp_path):
    some = CHANNELS.copy()
    some[1, 3, 0], some[2, 3, 1], some[2, 9, 1] = np.nan, np.inf, np.nan
    some[4] = np.nan  # a frame without values, which another note reports
    np.save(tmp_path / "a.npy", some)
    found = read_frames(tmp_path / "a.npy", MESH)
    assert_array_equal(found.values, some)
    note = f"2 of {COUNT} vertices have values that are not finite; they are not compared"
    assert found.notes == (note,)


def test_tables_have_a_column_for_each_frame(tmp_path):
    np.savetxt(tmp_path / "a.csv", FRAMES.T, delimiter=",", header="a,b,c,d,e", comments="")
    np.savetxt(tmp_path / "b.txt", FRAMES)
    for name in ("a.csv", "b.txt"):
        assert_array_equal(read_frames(tmp_path / name, MESH).values, FRAMES)


@pytest.mark.parametrize(
    ("step", "seconds"), [(None, None), ("2", 2), ("720.0", 0.72), ("-", None)]
)
def test_gifti_time_series_agree_with_nibabel(tmp_path, step, seconds):
    gifti(tmp_path / "many.func.gii", FRAMES, step)
    gifti(tmp_path / "one.gii", [FRAMES.T], step, "NIFTI_INTENT_NONE")
    for name in ("many.func.gii", "one.gii"):
        found = read_frames(tmp_path / name, MESH)
        stored = nibabel.load(tmp_path / name).agg_data()
        expected = np.stack(stored) if isinstance(stored, tuple) else stored.T
        assert_array_equal(found.values, expected)
        if seconds is None:
            assert found.times is None
        else:
            assert_allclose(found.times, seconds * np.arange(len(FRAMES)))
            unit = "seconds" if seconds == 2 else "milliseconds"
            (note,) = found.notes
            check_message(note, "TimeStep", f"{float(step):g}", unit)


@pytest.mark.parametrize("name", ["a.mgh", "a.mgz"])
def test_freesurfer_frames_have_times(tmp_path, name):
    image = MGHImage(FRAMES.T.reshape(COUNT, 1, 1, -1).astype(np.float32), np.eye(4))
    image.header.set_zooms((1, 1, 1, 2500))
    image.to_filename(tmp_path / name)
    found = read_frames(tmp_path / name, MESH)
    assert_array_equal(found.values, SINGLE)
    assert_allclose(found.times, 2.5 * np.arange(len(FRAMES)))


def test_source_estimates_of_all_vertices_are_not_changed(tmp_path):
    shuffled = np.random.default_rng(0).permutation(COUNT)
    write_stc(tmp_path / "a-lh.stc", FRAMES[:, shuffled], shuffled, TIMES)
    found = read_frames(tmp_path / "a-lh.stc", MESH)
    assert_array_equal(found.values, SINGLE)
    assert_allclose(found.times, TIMES, atol=1e-7)
    assert found.notes == ()


def test_values_between_sources_are_interpolated(tmp_path):
    """The error is below that of harmonic extension, and falls with the number of sources."""
    fine = icosphere(3)
    frames = rotating_frames(fine)
    errors = []
    for level in (1, 2):  # the vertices of coarser spheres come first
        sources = np.arange(10 * 4**level + 2)
        write_stc(tmp_path / "a-lh.stc", frames[:, sources], sources, TIMES)
        found = read_frames(tmp_path / "a-lh.stc", fine)
        known = np.isin(np.arange(len(fine.vertices)), sources)
        assert_allclose(found.values[:, known], frames[:, known], atol=1e-6)
        check_message(found.notes[0], len(sources), 642)
        errors.append(np.sqrt(np.mean((found.values - frames) ** 2)))
        harmonic = extend(fine, np.where(known, frames[0], 0.0), known)
        assert errors[-1] < 0.25 * np.sqrt(np.mean((harmonic - frames[0]) ** 2))
    assert errors[1] < errors[0] / 4
    write_stc(tmp_path / "a-lh.stc", np.full((3, 9), 2.5), np.arange(9), np.arange(3.0))
    assert_allclose(read_frames(tmp_path / "a-lh.stc", fine).values, 2.5, rtol=1e-9)


def test_note_names_a_coarser_surface_with_the_sources(tmp_path, monkeypatch):
    monkeypatch.setattr(source_frames, "_FSAVERAGE", COUNT)
    monkeypatch.setattr(source_frames, "_COARSER_COPIES", {42: "fsaverage1"})
    for first, is_copy in ((0, True), (1, False)):
        sources = np.arange(first, first + 42)
        write_stc(tmp_path / "a-lh.stc", FRAMES[:, sources], sources, TIMES)
        (note,) = read_frames(tmp_path / "a-lh.stc", MESH).notes
        check_message(note, 42, COUNT)
        assert ("fsaverage1" in note) == is_copy


def test_vtk_lists_give_files_and_times(tmp_path):
    paths = series(tmp_path)
    order = [3, 0, 4, 1, 2]  # lists need not be sorted
    rows = [f'<DataSet timestep="{TIMES[k]}" file="{paths[k].name}"/>' for k in order]
    text = f'<VTKFile type="Collection"><Collection>{"".join(rows)}</Collection></VTKFile>'
    (tmp_path / "a.pvd").write_text(text)
    files = [{"name": paths[k].name, "time": TIMES[k]} for k in order]
    (tmp_path / "a.vtu.series").write_text(json.dumps({"files": files}))
    for name in ("a.pvd", "a.vtu.series"):
        found = read_frames(tmp_path / name, MESH, "u")
        assert_array_equal(found.values, FRAMES)
        assert_array_equal(found.times, TIMES)
        assert found.notes == ()


def test_lists_read_each_file_once(tmp_path, monkeypatch):
    paths, read = series(tmp_path), []
    monkeypatch.setattr(
        vtk_frames,
        "vtk_contents",
        lambda opened: read.append(opened.path.name) or vtk_contents(opened),
    )
    files = [{"name": paths[k % 2].name, "time": k} for k in range(200)]
    (tmp_path / "a.series").write_text(json.dumps({"files": files}))
    found = read_frames(tmp_path / "a.series", MESH, "u")
    assert_array_equal(found.values, FRAMES[np.arange(200) % 2])
    assert read == [path.name for path in paths[:2]]
    files = [{"name": paths[0].name, "time": k} for k in range(60_000)]
    (tmp_path / "a.series").write_text(json.dumps({"files": files}))
    with raises(FunctionError, 60_000, 1):
        read_frames(tmp_path / "a.series", MESH, "u")


def test_other_npz_with_similar_names_is_not_a_sequence(tmp_path):
    arrays = {"velocity": np.zeros((4, 20, 3)), "vertices": MESH.vertices}
    np.savez(tmp_path / "a.npz", frames=FRAMES, **arrays)
    assert_array_equal(read_frames(tmp_path / "a.npz", MESH).values, FRAMES)
    assert task_of_file(tmp_path / "a.npz") is None
    with raises(ResultError):
        load(tmp_path / "a.npz")


def test_ambiguous_arrays_are_listed(tmp_path):
    others = {"faces": MESH.faces, "words": np.array(["a"]), "velocity": np.zeros((1, 4, 3))}
    np.savez(tmp_path / "two.npz", v=FRAMES, u=FRAMES.T, **others)
    for path, names in ((tmp_path / "two.npz", ("u", "v")), (series(tmp_path)[1], ("other", "u"))):
        with raises(SeveralArraysError, path.name) as caught:
            read_frames(path, MESH)
        assert caught.value.names == names
        assert_array_equal(read_frames(path, MESH, "u").values, FRAMES)
    solved()[0].save(tmp_path / "match.npz")
    with raises(FunctionError) as caught:
        read_frames(tmp_path / "match.npz", MESH)
    assert not isinstance(caught.value, SeveralArraysError)


def test_numbered_file_stands_for_its_series(tmp_path):
    paths = series(tmp_path, name="wave_{}.vtu")
    (tmp_path / "wave_.vtu").write_text("no number")
    (tmp_path / "swave_3.vtu").write_text("another name")
    found = read_frames(paths[2], MESH, "u")
    assert_array_equal(found.values, FRAMES)
    assert found.times is None
    (note,) = found.notes
    check_message(note, 5, "wave_0.vtu", "wave_4.vtu")
    series(tmp_path, name="wave_{}.vtu", has_time=True)
    assert_array_equal(read_frames(paths[0], MESH, "u").times, TIMES)


def test_vectors_are_channels_and_moved_points_noted(tmp_path):
    fields = np.random.default_rng(0).normal(size=(2, COUNT, 3))
    for k, field in enumerate(fields):
        moved = MESH.vertices + np.array([0, 0, 0.1 * k])
        (tmp_path / f"a{k}.vtp").write_bytes(vtk_bytes(moved, {"v": field}, kind="PolyData"))
    found = read_frames(tmp_path / "a0.vtp", MESH)
    assert_array_equal(found.values, fields)
    _, data, places = found.notes
    check_message(data, "v")
    check_message(places, "0.1")


def test_frames_may_include_loose_vertices(tmp_path):
    mesh = with_loose_vertex(MESH)
    all_values = np.insert(FRAMES, 5, 0.0, axis=1)
    np.save(tmp_path / "a.npy", all_values)
    assert_array_equal(read_frames(tmp_path / "a.npy", mesh).values, all_values)
    write_stc(tmp_path / "a-lh.stc", all_values, np.arange(COUNT + 1), TIMES)
    assert_array_equal(read_frames(tmp_path / "a-lh.stc", mesh).values, SINGLE)


@pytest.fixture(scope="module")
def invalid_files(tmp_path_factory):
    """Return a folder of files that contain no frames of the mesh."""
    folder = tmp_path_factory.mktemp("invalid")
    np.save(folder / "short.npy", FRAMES[:, :-1])
    np.save(folder / "flat.npy", FRAMES[0])
    np.save(folder / "faces.npy", np.zeros((3, len(MESH.faces))))
    np.save(folder / "nothing.npy", FRAMES[:0])
    np.save(folder / "complex.npy", FRAMES.astype(complex))
    (folder / "cut.npz").write_bytes(b"PK")
    np.save(folder / "words.npy", np.array([["a"]]))
    np.savez(folder / "two.npz", frame=FRAMES, b=FRAMES)
    np.savez(folder / "times.npz", frames=FRAMES, times=TIMES[1:])
    np.savez(folder / "time.npz", frames=FRAMES, times="now")
    for begin in (0, 1):
        counted = np.column_stack([np.arange(begin, COUNT + begin), FRAMES.T])
        np.savetxt(folder / f"from_{begin}.csv", counted, delimiter=",")
    np.save(folder / "from_0.npy", np.column_stack([np.arange(COUNT), FRAMES.T]))
    np.savetxt(folder / "short.csv", FRAMES[:, :-1].T, delimiter=",")
    gifti(folder / "label.gii", FRAMES, intent="NIFTI_INTENT_LABEL")
    gifti(folder / "mixed.gii", [FRAMES[0], FRAMES[0, :-1]])
    gifti(folder / "none.gii", [])
    gifti(folder / "points.gii", [MESH.vertices], intent="NIFTI_INTENT_POINTSET")
    write_stc(folder / "all-lh.stc", FRAMES, np.arange(COUNT), TIMES)
    content = bytearray((folder / "all-lh.stc").read_bytes())
    (folder / "all-vl.stc").write_bytes(content)
    content[4:8] = bytes(4)
    (folder / "still-lh.stc").write_bytes(content)
    write_stc(folder / "far-lh.stc", FRAMES[:, :3], np.array([0, 5, COUNT]), TIMES)
    some = np.where(np.arange(3) == 1, np.nan, FRAMES[:, :3])
    write_stc(folder / "nan-lh.stc", some, np.arange(3), TIMES)
    series(folder)
    (folder / "still.vtu").write_bytes(b"")
    (folder / "cut_1.vtu").write_bytes((folder / "wave_001.vtu").read_bytes()[:-900])
    (folder / "small_1.vtu").write_bytes(vtk_bytes(np.zeros((3, 3)), {"u": np.zeros(3)}))
    (folder / "none.pvd").write_text('<VTKFile type="Collection"/>')
    twice = 2 * '<DataSet timestep="1" file="wave_001.vtu"/>'
    (folder / "twice.pvd").write_text(f'<VTKFile type="Collection">{twice}</VTKFile>')
    lost = '<DataSet timestep="1" file="lost.vtu"/>'
    (folder / "lost.pvd").write_text(f'<VTKFile type="Collection">{lost}</VTKFile>')
    never = '<DataSet timestep="nan" file="wave_001.vtu"/>'
    (folder / "never.pvd").write_text(f'<VTKFile type="Collection">{never}</VTKFile>')
    (folder / "never.series").write_text('{"files": [{"name": "wave_001.vtu", "time": NaN}]}')
    (folder.parent / "far.vtu").write_bytes((folder / "wave_001.vtu").read_bytes())
    far = '<DataSet timestep="1" file="../far.vtu"/>'
    (folder / "far.pvd").write_text(f'<VTKFile type="Collection">{far}</VTKFile>')
    (folder / "far.series").write_text('{"files": [{"name": "/etc/hosts", "time": 1}]}')
    (folder / "bad.series").write_text("[1")
    (folder / "odd.series").write_text('{"files": [{"name": "wave_001.vtu"}]}')
    (folder / "array.series").write_text('[{"name": "wave_001.vtu"}]')
    return folder


@pytest.mark.parametrize(
    ("name", "array", "named"),
    [
        ("none.npy", None, ()),
        ("a.xyz", None, ()),
        ("short.npy", "u", ("u", ".npy")),
        ("short.npy", None, (5, COUNT - 1, COUNT)),
        ("flat.npy", None, ()),
        ("faces.npy", None, (320,)),
        ("nothing.npy", None, (0, 162)),
        ("complex.npy", None, ("complex128",)),
        ("cut.npz", None, (".npz", "cut")),
        ("words.npy", None, ("<U1",)),
        ("two.npz", None, ("frames", "frame")),
        ("far.pvd", None, ("../far.vtu", "folder")),
        ("far.series", None, ("/etc/hosts", "folder")),
        ("two.npz", "c", ("c",)),
        ("times.npz", None, (4, "times", 5)),
        ("time.npz", None, ("<U3",)),
        ("short.csv", None, (COUNT,)),
        ("label.gii", None, ()),
        ("mixed.gii", None, (COUNT, COUNT - 1)),
        ("none.gii", None, ()),
        ("points.gii", None, ()),
        ("all-vl.stc", None, ()),
        ("still-lh.stc", None, (0,)),
        ("far-lh.stc", None, (COUNT,)),
        ("nan-lh.stc", None, ()),
        ("still.vtu", None, ()),
        ("lost_1.vtu", None, ()),
        ("wave_001.vtu", None, ("wave_000.vtu", 2)),
        ("wave_001.vtu", "w", ("w",)),
        ("cut_1.vtu", "u", ("cut_1.vtu",)),
        ("small_1.vtu", None, ("small_1.vtu", 3, COUNT)),
        ("none.pvd", None, ()),
        ("twice.pvd", "u", ()),
        ("lost.pvd", None, ("lost.vtu",)),
        ("never.pvd", "u", ("wave_001.vtu",)),
        ("never.series", "u", ("wave_001.vtu",)),
        ("bad.series", None, ("JSON", 1)),
        ("odd.series", None, ()),
        ("array.series", None, ()),
        ("from_0.csv", None, (0, COUNT - 1, "vertices")),
        ("from_1.csv", None, (1, COUNT, "vertices")),
        ("from_0.npy", None, (0, COUNT - 1, "vertices")),
    ],
)
def test_invalid_files_are_refused_in_one_line(invalid_files, name, array, named):
    with raises(FunctionError, *named) as caught:
        read_frames(invalid_files / name, MESH, array)
    assert name in str(caught.value)
    assert str(caught.value).isprintable()
