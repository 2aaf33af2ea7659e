"""`abfm register`, `abfm apply` and `abfm map` of two surfaces, run in this process."""

import json

import nibabel
import numpy as np
import pytest

import abfm as library
from abfm import Correspondence, TriangleMesh, load_mesh
from abfm.assets import asset_path
from abfm.functions import read_column, read_labels
from abfm.io import export_ply, write_labels, write_values
from abfm.maps import PointMap
from abfm.mesh.shapes import even_sphere
from abfm.reading import Labels
from tests.core.registration.test_register import TURN, flowed, hills
from tests.messages import check_message, line_with
from tests.processes import argv
from tests.shapes import icosphere, with_loose_vertex

A, B = even_sphere(1500), icosphere(3)
POSES = [str(asset_path(f"human_{pose}.off")) for pose in "AB"]
SHORT = ["--set=iterations=30", "--refine", "0", "--quiet"]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two spheres of which one is turned and bent, with a function and labels on both."""
    folder = tmp_path_factory.mktemp("spheres")
    seen = flowed(B, TURN.inv().apply(B.vertices.copy()))
    for name, mesh, directions in (("a", A, A.vertices), ("b", B, seen)):
        export_ply(folder / f"{name}.ply", mesh, {}, {})
        np.save(folder / f"{name}.npy", hills(directions))
        keys = np.where(directions[:, 2] > 0, 5, 2)
        write_labels(folder / f"{name}.label.gii", Labels(keys, {2: "south", 5: "north"}, {}))
    return folder


@pytest.fixture(scope="module")
def registration(files):
    from abfm_viewer.cli import main

    words = [
        "register",
        files / "a.ply",
        files / "b.ply",
        f"--source=file:{files}/a.npy",
        f"--target=file:{files}/b.npy",
        "--sigma=2",
        *SHORT,
        f"--out={files}/r.npz",
    ]
    assert main(argv(*words)) in (0, 3)
    return files / "r.npz"


def test_a_registration_is_told_and_written_in_several_forms(files, abfm, tmp_path):
    outs = [tmp_path / name for name in ("r.npz", "r.csv", "r.ply", "lh.sphere.reg", "r.surf.gii")]
    words = [f"--out={out}" for out in outs]
    told = abfm(
        "register",
        files / "a.ply",
        files / "b.ply",
        f"--source=file:{files}/a.npy",
        f"--target=file:{files}/b.npy",
        "--sigma=2",
        *SHORT,
        "--max-distortion=2",
        *words,
    )
    assert told.out.startswith("registered: ")
    check_message(line_with(told.err, "note: initial map"), "sphere")
    check_message(line_with(told.out, "covered"), "100.0%")
    assert "within distortion 2" in told.out
    found = library.load(outs[0])
    numbers = np.loadtxt(outs[1], delimiter=",", skiprows=0)
    np.testing.assert_array_equal(numbers, found.to_vertices())
    for path in outs[2:]:
        placed = load_mesh(path)
        np.testing.assert_array_equal(placed.faces, A.faces)
        np.testing.assert_allclose(placed.vertices, found.back.positions, atol=1e-5)


def test_an_ambiguous_initial_map_is_not_registered(files, abfm, tmp_path):
    """However well the functions match: any turn about z is as good."""
    told = abfm(
        "register",
        files / "a.ply",
        files / "b.ply",
        "--source=expression:z",
        "--target=expression:z",
        "--initial=sphere",
        *SHORT,
        "--json",
        f"--out={tmp_path}/r.npz",
        status=3,
    )
    facts = json.loads(told.out)
    assert facts["verdict"]["kind"] == "not reached"
    assert facts["verdict"]["cause"] == "initial map"
    assert facts["worse_residual"] < 0.15
    assert len(facts["warnings"]) >= 1
    assert "warning: " in told.err
    found = library.load(tmp_path / "r.npz")
    assert len(found.warnings) == 1
    assert found.facts.outcome == "not reached"


def test_what_machines_are_told_is_whole(files, abfm, tmp_path):
    told = abfm(
        "register",
        files / "a.ply",
        files / "b.ply",
        "--channel",
        f"file:{files}/a.npy",
        f"file:{files}/b.npy",
        "2",
        "--initial=sphere",
        "--mask-a=expression:x>-2",
        "--mask-b=expression:1",
        *SHORT,
        "--sigma=5",
        "--json",
        f"--out={tmp_path}/r.npz",
    ).out
    facts = json.loads(told)
    assert facts["map"]["folded"] == 0
    assert facts["map"]["coverage"] == 1
    check_message(facts["notes"][0], "A")
    assert facts["parameters"]["order"] == 1
    assert facts["parameters"]["sigma"] == 5


def test_data_labels_and_points_go_there_and_back(registration, files, abfm, tmp_path):
    found = library.load(registration)
    for by in ("area", "point"):
        abfm(
            "apply", registration, f"--data={files}/a.npy", f"--by={by}", f"--out={tmp_path}/d.csv"
        )
        carried = np.loadtxt(tmp_path / "d.csv", delimiter=",")
        np.testing.assert_allclose(carried, found.carry(np.load(files / "a.npy"), by))
    told = abfm(
        "apply", registration, f"--labels={files}/a.label.gii", f"--out={tmp_path}/l.label.gii"
    )
    assert told.out == f"wrote {tmp_path}/l.label.gii\n"
    labels, wanted = read_labels(tmp_path / "l.label.gii"), read_labels(files / "b.label.gii")
    assert labels.names == {2: "south", 5: "north"}
    assert (labels.values == wanted.values).mean() > 0.95
    abfm(
        "apply",
        registration,
        "--inverse",
        f"--labels={tmp_path}/l.label.gii",
        f"--out={tmp_path}/k.csv",
    )
    back = np.loadtxt(tmp_path / "k.csv", delimiter=",")
    assert (back == read_labels(files / "a.label.gii").values).mean() > 0.95
    np.savetxt(tmp_path / "p.csv", [3, 17], fmt="%d")
    abfm("apply", registration, f"--points={tmp_path}/p.csv", f"--out={tmp_path}/q.csv")
    places = np.loadtxt(tmp_path / "q.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(places, found.back.positions[[3, 17]])
    np.savetxt(tmp_path / "q.txt", places)
    abfm(
        "apply", registration, "--inverse", f"--points={tmp_path}/q.txt", f"--out={tmp_path}/p.csv"
    )
    places = np.loadtxt(tmp_path / "p.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(places, A.vertices[[3, 17]], atol=1e-3)


def test_times_of_frames_are_kept(registration, abfm, tmp_path):
    """From one series of CIFTI to another, as Workbench reads them."""
    times = 0.72 * np.arange(3)
    write_values(
        tmp_path / "a.dtseries.nii",
        np.outer(A.vertices[:, 0], [1, 2, 3]),
        "CortexLeft",
        times=times,
    )
    abfm(
        "apply",
        registration,
        f"--data={tmp_path}/a.dtseries.nii",
        f"--out={tmp_path}/lh.b.dtseries.nii",
    )
    axis = nibabel.load(tmp_path / "lh.b.dtseries.nii").header.get_axis(0)
    np.testing.assert_allclose(axis.time, times)


def write_two_columns(folder):
    """Write labels of A in two columns, as GIFTI and as a table."""
    keys = np.stack([A.vertices[:, 2] > 0, A.vertices[:, 0] > 0]).astype(np.int32)
    np.savetxt(folder / "two.csv", keys.T, fmt="%d", delimiter=",", header="up,left", comments="")
    arrays = [
        nibabel.gifti.GiftiDataArray(row, "NIFTI_INTENT_LABEL", meta={"Name": name})
        for row, name in zip(keys, ("up", "left"), strict=True)
    ]
    nibabel.save(nibabel.gifti.GiftiImage(darrays=arrays), folder / "two.label.gii")


def test_one_of_several_columns_of_labels_is_chosen(registration, tmp_path, abfm):
    write_two_columns(tmp_path)
    left = (A.vertices[:, 0] > 0).astype(int)
    wanted = library.load(registration).carry_labels(left, "area")
    for name, column in (("two.csv", "left"), ("two.csv", "1"), ("two.label.gii", "left")):
        labels = ["--labels", f"{tmp_path}/{name}", "--column", column]
        abfm("apply", registration, *labels, "--out", tmp_path / "x.csv")
        np.testing.assert_array_equal(np.loadtxt(tmp_path / "x.csv"), wanted)


@pytest.mark.parametrize(
    ("option", "given", "out", "missing"),
    [
        ("--data", "a.npy", "x.npy", np.nan),
        ("--data", "a.npy", "x.csv", np.nan),
        ("--data", "a.npy", "x.mgh", np.nan),
        ("--data", "a.npy", "x.func.gii", np.nan),
        ("--labels", "a.label.gii", "x.txt", -1),
        ("--labels", "a.label.gii", "x.label.gii", 0),
    ],
)
def test_vertices_without_faces_have_no_value(files, tmp_path, abfm, option, given, out, missing):
    """They are NaN in data; their label is unknown, -1 in tables, never a real one. The structure
    of the surface is written, also if no name says it.
    """
    loose = with_loose_vertex(A)
    numbers = loose.vertex_ids, loose.file_vertex_count
    b = TriangleMesh(loose.vertices, loose.faces, numbers=numbers, structure="CortexRight")
    found = Correspondence(PointMap.of_vertices(b, A), PointMap.of_vertices(A, b))
    found.save(tmp_path / "r.npz")
    words = [option, files / given, "--out", tmp_path / out]
    abfm("apply", tmp_path / "r.npz", *words)
    if out.endswith(".label.gii"):
        labels = read_labels(tmp_path / out)
        rows, wanted = labels.values, read_labels(files / given).values
        assert labels.names == {0: "???", 2: "south", 5: "north"}
    else:
        rows = read_column(str(tmp_path / out))
        wanted = read_labels(files / given).values if missing == -1 else np.load(files / given)
    if out.endswith(".gii"):
        meta = dict(nibabel.load(tmp_path / out).meta)
        assert meta == {"AnatomicalStructurePrimary": "CortexRight"}
    np.testing.assert_array_equal(rows[5], missing)
    np.testing.assert_allclose(np.delete(rows, 5), wanted, atol=1e-6)


def test_points_beside_a_surface_are_told(registration, tmp_path, abfm):
    np.savetxt(tmp_path / "p.csv", [[0, 0, 1.0], [0, 1.25, 0]])
    told = abfm("apply", registration, f"--points={tmp_path}/p.csv", f"--out={tmp_path}/q.csv")
    check_message(told.err, 2)
    np.savetxt(tmp_path / "p.csv", A.vertices[[4]])
    told = abfm("apply", registration, f"--points={tmp_path}/p.csv", f"--out={tmp_path}/q.csv")
    assert told.err == ""


def test_a_map_between_surfaces_is_judged_by_a_true_one(tmp_path, abfm):
    a, b = map(load_mesh, POSES)
    count = len(a.vertices)
    Correspondence.of_same_faces(a, b).save(tmp_path / "c.npz")
    np.savetxt(tmp_path / "t.txt", np.arange(count), fmt="%d")
    told = abfm(
        "map", tmp_path / "c.npz", f"--truth={tmp_path}/t.txt", f"--out={tmp_path}/m.txt"
    ).out
    check_message(line_with(told, "error"), "0.0000")
    check_message(line_with(told, "covered"))
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "m.txt"), np.arange(count))
    told = abfm("info", tmp_path / "c.npz").out
    check_message(told.splitlines()[0], "2,454")
    check_message(line_with(told, "covered"))
    assert json.loads(abfm("info", tmp_path / "c.npz", "--json").out)["map"]["coverage"] == 1
    for style in ([], ["--style", "sheet"]):
        told = abfm("render", tmp_path / "c.npz", "--out", tmp_path / "x.png", *style, status=2).err
        check_message(told, "Correspondence", "abfm info")
    facts = json.loads(
        abfm("map", tmp_path / "c.npz", "--truth", "identity", "--inverse", "--json").out
    )
    assert facts["accuracy"]["maximum"] < 1e-9
    assert facts["map"]["coverage"] == 1


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["register", "{a}", "{b}", "--source=file:{n}", "--out={t}/r.npz"], ()),
        (
            [
                "register",
                "{a}",
                "{b}",
                "--source={x}",
                "--target={x}",
                "--initial=sphere:~-/a,~-/b",
                "--out={t}/r.npz",
            ],
            ("~-/a",),
        ),
        (["register", "{a}", "{b}", "--out", "{t}/r.npz"], ("source", "target")),
        (
            ["register", "{a}", "{b}", "--source={x}", "--target={x}", "--out={b}"],
            ("b.ply",),
        ),
        (
            [
                "register",
                "{a}",
                "{b}",
                "--landmarks={n}",
                "--initial=file:{t}/p.csv",
                "--out={t}/p.csv",
            ],
            ("p.csv",),
        ),
        (
            [
                "register",
                "{a}",
                "{b}",
                "--source=file:{t}/p.csv",
                "--target={x}",
                "--out={t}/p.csv",
            ],
            ("p.csv",),
        ),
        (
            ["register", "{a}", "{b}", "--source=file:{n}", "--target=file:{n}", "--out={t}/r.npz"],
            (),
        ),
        (
            ["register", "{a}", "{a}", "--source=file:{n}", "--target=file:{n}", "--out={t}/r.xyz"],
            (),
        ),
        (
            [
                "register",
                "{a}",
                "{a}",
                "--source=file:{n}",
                "--target=file:{n}",
                "--initial=spher",
                "--out={t}/r.npz",
            ],
            (),
        ),
        (
            ["register", "{a}", "{a}", "--source=file:{n}", "--target=file:{n}", "--out={t}/x.reg"],
            (),
        ),
        (
            ["register", "{a}", "{a}", "--source={x}", "--target={x}", "--out={t}/x.shape.gii"],
            (),
        ),
        (
            [
                "register",
                "{a}",
                "{b}",
                "--source={x}",
                "--target={x}",
                "--alpha=-1",
                "--out={t}/r.npz",
            ],
            ("alpha", "-1.0"),
        ),
        (
            ["register", "{a}", "{b}", "--landmarks={t}/p.csv", "--mask-a={x}", "--out={t}/r.npz"],
            (),
        ),
        (
            ["register", "{a}", "{b}", "--landmarks={t}/huge.csv", "--out={t}/r.npz"],
            ("1e+300",),
        ),
        (["apply", "{r}", "--labels={t}/inf.csv", "--out={t}/x.csv"], ()),
        (["apply", "{r}", "--data", "{n}"], ("--out",)),
        (["apply", "{r}", "--out", "{t}/x.csv"], ()),
        (
            ["apply", "{r}", "--inverse", "--data={n}", "--out={t}/x.csv"],
            (),
        ),
        (["apply", "{r}", "--labels", "{n}", "--out", "{t}/x.csv"], ()),
        (["apply", "{a}", "--data", "{n}", "--out", "{t}/x.csv"], ()),
        (["apply", "{r}", "--points", "{n}", "--out", "{t}/x.csv"], ()),
        (
            ["apply", "{r}", "--points={t}/p.csv", "--out={t}/p.csv"],
            ("p.csv",),
        ),
        (
            ["apply", "{r}", "--points={t}/p.csv", "--by=area", "--out={t}/x.csv"],
            ("--by", "--data", "--labels"),
        ),
        (
            ["apply", "{r}", "--points={t}/far.csv", "--out={t}/x.csv"],
            (2, 39),
        ),
        (
            ["apply", "{r}", "--data={n}", "--column=0", "--out={t}/x.csv"],
            ("--column", "--labels"),
        ),
        (["apply", "{r}", "--labels={t}/two.csv", "--out={t}/x.csv"], ("--column", 0, 1)),
        (
            ["apply", "{r}", "--labels={t}/two.label.gii", "--out={t}/x.csv"],
            ("--column", 0, 1),
        ),
        (["map", "{r}", "--truth", "identity", "--time", "1"], ()),
    ],
)
def test_what_does_not_fit_is_refused_in_a_line(words, named, registration, files, tmp_path, abfm):
    names = {"a": files / "a.ply", "b": files / "b.ply", "n": files / "a.npy"}
    (tmp_path / "p.csv").write_text("1,2\n")
    (tmp_path / "huge.csv").write_text("1e300,2\n")
    (tmp_path / "far.csv").write_text("0,0,2\n0,40,0\n")
    write_two_columns(tmp_path)
    (tmp_path / "inf.csv").write_text("1\n" * (len(A.vertices) - 1) + "inf\n")
    places = {**names, "r": registration, "t": tmp_path, "x": "expression:1+x"}
    check_message(abfm(*(word.format(**places) for word in words), status=2).err, *named)


def test_what_was_not_reached_says_what_to_try_without_a_result_to_start_from(
    files, abfm, tmp_path
):
    pair = ["--source", "gaussian:vertex=5", "--target", "gaussian:vertex=300"]
    words = [
        "register",
        files / "b.ply",
        files / "b.ply",
        *pair,
        "--set=iterations=3",
        "--refine=0",
        "--quiet",
    ]
    told = abfm(*words, "--out", tmp_path / "r.npz", status=3).out
    assert "\nto try: " in told
    assert "--start" not in told
