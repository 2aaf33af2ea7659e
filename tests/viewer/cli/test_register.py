import json
import re

import nibabel
import numpy as np
import pytest

import abfm as library
from abfm import Correspondence, TriangleMesh, load_mesh
from abfm.functions import read_column, read_labels
from abfm.io import export_ply, write_labels, write_values
from abfm.maps import PointMap
from abfm.mesh.shapes import even_sphere
from abfm.reading import Labels
from abfm_viewer.cli import main
from tests.core.registration.test_register import TURN, flowed, hills
from tests.messages import check_message, line_with
from tests.processes import words_of
from tests.shapes import icosphere, with_loose_vertex
from tests.viewer.cli.conftest import MESHES

A, B = even_sphere(800), icosphere(3)
SHORT_RUN = "--set=iterations=30 --refine 0 --quiet"
PAIR = "{f}/a.ply {f}/b.ply --source=file:{f}/a.npy --target=file:{f}/b.npy"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with a sphere and a rotated, bent one, with a function and labels on both."""
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
    line = f"register {PAIR} --sigma=2 {SHORT_RUN} --out={{f}}/r.npz"
    assert main(words_of(line, f=files)) in (0, 3)
    return files / "r.npz"


@pytest.fixture
def apply(abfm, registration, files):
    def run(line, *words, **options):
        return abfm(f"apply {{r}} {line}", *words, r=registration, f=files, **options)

    return run


def test_registration_is_printed_and_written(files, abfm, tmp_path):
    line = f"register {PAIR} --sigma=2 {SHORT_RUN} --max-distortion=2"
    words = [f"--out={tmp_path}/r.{suffix}" for suffix in ("npz", "csv", "ply", "html")]
    output = abfm(line, *words, f=files)
    assert output.out.startswith("registered")
    check_message(line_with(output.err, "note: initial map"), "sphere")
    check_message(line_with(abfm("info {t}/r.npz").out, "covered"), "100.0%")
    assert "distortion within 2" in output.out
    placed = load_mesh(tmp_path / "r.ply")
    np.testing.assert_array_equal(placed.faces, A.faces)
    found = library.load(tmp_path / "r.npz")
    np.testing.assert_allclose(placed.vertices, found.back.positions, atol=1e-5)
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "r.csv"), found.to_vertices())
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "<dt>A covered</dt>" in page
    abfm("render {t}/r.npz --out {t}/r.png --size 320x240 --background transparent")
    abfm("render {t}/r.npz --out {t}/z.html --up z")
    text = (tmp_path / "z.html").read_text(encoding="utf-8")
    shown = json.loads(re.search(r'id="page">(.*?)</script>', text).group(1))
    assert [panel["title"] for panel in shown["panels"]] == ["A", "A on B", "B"]
    up = np.reshape(shown["panels"][1]["axes"], (3, 3))[1]
    assert np.argmax(up) == 2


def test_ambiguous_initial_map_is_not_registered(files, abfm, tmp_path):
    """The functions match well, but every rotation about z is as good."""
    functions = "--source=expression:z --target=expression:z --initial=sphere"
    line = f"register {{f}}/a.ply {{f}}/b.ply {functions} {SHORT_RUN} --json --out={{t}}/r.npz"
    output = abfm(line, f=files, status=3)
    facts = json.loads(output.out)
    assert (facts["verdict"]["kind"], facts["verdict"]["cause"]) == ("not reached", "initial map")
    assert facts["worse_residual"] < 0.15
    assert len(facts["warnings"]) >= 1
    assert "warning: " in output.err
    assert "note: warning: " not in output.err
    assert library.load(tmp_path / "r.npz").facts.outcome == "not reached"


def test_initial_map_by_connectivity_is_noted(files, abfm):
    functions = "--source=expression:z --target=expression:z"
    output = abfm(
        f"register {{f}}/a.ply {{f}}/a.ply {functions} {SHORT_RUN} --out={{t}}/r.npz", f=files
    )
    check_message(line_with(output.err, "note: initial map"), "connectivity", "faces")


def test_json_of_a_registration_has_its_facts(files, abfm):
    output = abfm(
        "register {f}/a.ply {f}/b.ply --channel file:{f}/a.npy file:{f}/b.npy 2 --initial=closest "
        "--mask-a=expression:x>-2 --mask-b=expression:1 --sigma=5 --json --out={t}/r.npz "
        f"{SHORT_RUN}",
        f=files,
    )
    facts = json.loads(output.out)
    assert (facts["map"]["folded"], facts["map"]["coverage"]) == (0, 1)
    check_message(facts["notes"][0], "A")
    assert (facts["parameters"]["order"], facts["parameters"]["sigma"]) == (1, 5)


def test_data_labels_and_points_return(registration, files, apply, tmp_path):
    found = library.load(registration)
    for by in ("area", "point"):
        apply(f"--data={{f}}/a.npy --by={by} --out={{t}}/d.csv")
        transferred = np.loadtxt(tmp_path / "d.csv", delimiter=",")
        np.testing.assert_allclose(transferred, found.transfer(np.load(files / "a.npy"), by))
    output = apply("--labels={f}/a.label.gii --out={t}/l.label.gii")
    assert output.out == f"wrote {tmp_path}/l.label.gii\n"
    labels, wanted = read_labels(tmp_path / "l.label.gii"), read_labels(files / "b.label.gii")
    assert labels.names == {2: "south", 5: "north"}
    assert (labels.values == wanted.values).mean() > 0.95
    apply("--inverse --labels={t}/l.label.gii --out={t}/k.csv")
    back = np.loadtxt(tmp_path / "k.csv", delimiter=",")
    assert (back == read_labels(files / "a.label.gii").values).mean() > 0.95
    np.savetxt(tmp_path / "p.csv", [3, 17], fmt="%d")
    apply("--points={t}/p.csv --out={t}/q.csv")
    places = np.loadtxt(tmp_path / "q.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(places, found.back.positions[[3, 17]])
    np.savetxt(tmp_path / "q.txt", places)
    apply("--inverse --points={t}/q.txt --out={t}/p.csv")
    places = np.loadtxt(tmp_path / "p.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(places, A.vertices[[3, 17]], atol=1e-3)


def test_times_of_frames_are_kept(apply, tmp_path):
    """Times of a CIFTI series are written in the format of Workbench."""
    times, values = 0.72 * np.arange(3), np.outer(A.vertices[:, 0], [1, 2, 3])
    write_values(tmp_path / "a.dtseries.nii", values, "CortexLeft", times=times)
    apply("--data={t}/a.dtseries.nii --out={t}/lh.b.dtseries.nii")
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


def test_column_of_labels_is_chosen(registration, tmp_path, apply):
    write_two_columns(tmp_path)
    left = (A.vertices[:, 0] > 0).astype(int)
    wanted = library.load(registration).transfer_labels(left, "area")
    for name, column in (("two.csv", "left"), ("two.csv", "1"), ("two.label.gii", "left")):
        apply(f"--labels {{t}}/{name} --column {column} --out {{t}}/x.csv")
        np.testing.assert_array_equal(np.loadtxt(tmp_path / "x.csv"), wanted)


@pytest.mark.parametrize(
    ("option", "given", "out", "missing"),
    [
        ("--data", "a.npy", "x.csv", np.nan),
        ("--data", "a.npy", "x.mgh", np.nan),
        ("--data", "a.npy", "x.func.gii", np.nan),
        ("--labels", "a.label.gii", "x.txt", -1),
        ("--labels", "a.label.gii", "x.label.gii", 0),
    ],
)
def test_unused_vertices_have_no_value(files, tmp_path, abfm, option, given, out, missing):
    loose = with_loose_vertex(A)
    numbers = loose.vertex_ids, loose.file_vertex_count
    b = TriangleMesh(loose.vertices, loose.faces, numbers=numbers, structure="CortexRight")
    found = Correspondence(PointMap.of_vertices(b, A), PointMap.of_vertices(A, b))
    found.save(tmp_path / "r.npz")
    abfm(f"apply {{t}}/r.npz {option} {{f}}/{given} --out {{t}}/{out}", f=files)
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


def test_points_off_the_surface_are_noted(tmp_path, apply):
    for points, named in (([[0, 0, 1.0], [0, 1.25, 0]], 2), (A.vertices[[4]], None)):
        np.savetxt(tmp_path / "p.csv", points)
        output = apply("--points={t}/p.csv --out={t}/q.csv").err
        if named:
            check_message(output, named)
        else:
            assert output == ""


def test_map_command_measures_errors_between_surfaces(tmp_path, abfm):
    a, b = (load_mesh(MESHES[f"human_{pose}"]) for pose in "AB")
    count = len(a.vertices)
    Correspondence.of_same_faces(a, b).save(tmp_path / "c.npz")
    np.savetxt(tmp_path / "t.txt", np.arange(count), fmt="%d")
    output = abfm("map {t}/c.npz --truth={t}/t.txt --out={t}/m.txt").out
    assert line_with(output, "error, sqrt(area)").split()[2] == "0"
    check_message(line_with(output, "covered"))
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "m.txt"), np.arange(count))
    output = abfm("info {t}/c.npz").out
    check_message(output.splitlines()[0], "2,454")
    check_message(line_with(output, "covered"))
    assert json.loads(abfm("info {t}/c.npz --json").out)["map"]["coverage"] == 1
    for style in ("", "--style sheet"):
        output = abfm(f"render {{t}}/c.npz --out {{t}}/x.png {style}", status=2).err
        check_message(output, "correspondence", "abfm info")
    facts = json.loads(abfm("map {t}/c.npz --truth identity --inverse --json").out)
    assert facts["accuracy"]["maximum"] < 1e-9
    assert facts["map"]["coverage"] == 1


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("{a} {b} --source=file:{n} --out={t}/r.npz", []),
        ("{a} {b} --source={x} --target={x} --initial=sphere:~-/a,~-/b --out={t}/r.npz", ["~-/a"]),
        ("{a} {b} --out {t}/r.npz", ["source", "target"]),
        ("{a} {b} --source={x} --target={x} --out={b}", ["b.ply"]),
        ("{a} {b} --landmarks={n} --initial=file:{t}/p.csv --out={t}/p.csv", ["p.csv"]),
        ("{a} {a} --source={x} --target={x} --out={t}/x.reg", []),
        ("{a} {a} --source={x} --target={x} --out={t}/x.shape.gii", []),
        ("{a} {b} --landmarks={t}/p.csv --mask-a={x} --out={t}/r.npz", []),
        ("{a} {b} --landmarks={t}/huge.csv --out={t}/r.npz", ["1e+300"]),
    ],
)
def test_register_refuses_bad_input(line, named, files, tmp_path, abfm):
    (tmp_path / "p.csv").write_text("1,2\n")
    (tmp_path / "huge.csv").write_text("1e300,2\n")
    places = {"a": files / "a.ply", "b": files / "b.ply", "n": files / "a.npy"}
    output = abfm(f"register {line}", x="expression:1+x", status=2, **places)
    check_message(output.err, *named)


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("--labels={t}/inf.csv --out={t}/x.csv", []),
        ("--data {f}/a.npy", ["--out"]),
        ("--out {t}/x.csv", []),
        ("--inverse --data={f}/a.npy --out={t}/x.csv", []),
        ("--labels {f}/a.npy --out {t}/x.csv", []),
        ("--points {f}/a.npy --out {t}/x.csv", []),
        ("--points={t}/p.csv --out={t}/p.csv", ["p.csv"]),
        ("--points={t}/p.csv --by=area --out={t}/x.csv", ["--by", "--data", "--labels"]),
        ("--points={t}/far.csv --out={t}/x.csv", [2, 39]),
        ("--data={f}/a.npy --column=0 --out={t}/x.csv", ["--column", "--labels"]),
        ("--labels={t}/two.csv --out={t}/x.csv", ["--column", 0, 1]),
        ("--labels={t}/two.label.gii --out={t}/x.csv", ["--column", 0, 1]),
        ("--data={f}/a.npy --size 30 --out={t}/x.csv", ["--texture"]),
    ],
)
def test_apply_refuses_bad_input(line, named, apply, tmp_path):
    (tmp_path / "p.csv").write_text("1,2\n")
    (tmp_path / "far.csv").write_text("0,0,2\n0,40,0\n")
    (tmp_path / "inf.csv").write_text("1\n" * (len(A.vertices) - 1) + "inf\n")
    write_two_columns(tmp_path)
    check_message(apply(line, status=2).err, *named)


def test_wrong_files_are_refused(registration, files, abfm):
    check_message(abfm("map {r} --truth identity --time 1", r=registration, status=2).err)
    line = "apply {f}/a.ply --data {f}/a.npy --out {t}/x.csv"
    check_message(abfm(line, f=files, status=2).err)


def test_advice_for_a_registration_has_no_start(files, abfm):
    pair = "--source gaussian:vertex=5 --target gaussian:vertex=300 --initial=connectivity"
    line = f"register {{f}}/b.ply {{f}}/b.ply {pair} --set=iterations=3 --refine=0 --quiet"
    output = abfm(f"{line} --out {{t}}/r.npz", f=files, status=3).out
    assert "\nadvice: " in output
    assert "--start" not in output
