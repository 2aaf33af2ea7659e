"""Project files: what goes in comes out, and damage is named."""

import json
import math
import os
import re
import zipfile
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from abfm import (
    Match,
    Parameters,
    PathStep,
    Problem,
    ResultError,
    TriangleMesh,
    match,
)
from abfm.matching import Verdict
from abfm.outcome import Outcome
from abfm.pages.colormaps import NAMES
from abfm.pages.front import Front
from abfm.reading.labels import Labels
from abfm_viewer.document import document as documents
from abfm_viewer.document.document import (
    Channel,
    Document,
    Landmark,
    Look,
    Point,
    RunRecord,
    Surface,
    View,
)
from abfm_viewer.document.kinds import MatchDocument
from abfm_viewer.document.label_map import LabelMap
from abfm_viewer.files import project
from abfm_viewer.files.project import Origin, load_origin, load_project, save_project
from tests.core.reading import hostile
from tests.core.reading.hostile import members, npy_of, refusal, rewrite, zipped
from tests.messages import check_message, raises
from tests.processes import python
from tests.shapes import icosphere, torus, with_loose_vertex

WHOLE = icosphere(1)
SPHERE = with_loose_vertex(WHOLE)
"""Of 43 vertices in its file it has 42."""
CORNERS = np.arange(WHOLE.faces.size).reshape(-1, 3)
MERGED = TriangleMesh(WHOLE.vertices[WHOLE.faces.ravel()], CORNERS, merge=True)
X, Y = SPHERE.vertices[:, 0].copy(), SPHERE.vertices[:, 1].copy()
KNOWN = {"permuted:map ☃.txt(file:x.npy)": Y, "file:x.npy": X}


XY, YX = np.stack([X, Y], axis=1), np.stack([Y, X], axis=1)
SHORT = Parameters.of(iterations=5, refine=0, segments=1)
RESULT = match(SPHERE, XY, YX, SHORT, mask=X**2, weights=[1, 0.5])
RESULT = replace(RESULT, path=(), step=0)  # files have others' fields in single precision
COURSE = np.array([12, 42]), np.array([0.5, 0.0])
CANCELLED = Verdict(Outcome.NOT_REACHED, "cancelled", "")
ITERATES = {"residuals": np.array([0.7, 0.5]), "sigmas": np.array([0.2, 0.1])}
TERMS = ("closeness", "landmarks"), np.array([[2.0, 1.0], [1.0, 0.0]])
PLAIN = Problem(SPHERE, RESULT.source, RESULT.target, RESULT.parameters)
DOCUMENT = MatchDocument(
    (Surface(SPHERE, "a ☃ sphere\udc80", Front((0.0, 0.0, 1.0), (0.0, 1.0, 0.0))),),
    channels=(
        Channel("file:x.npy + gaussian:vertex=7", "coordinate:y"),
        Channel("expression:x**2", "geodesic:vertex=4", 0.5),
    ),
    channel=1,
    side="target",
    bump=1,
    parameters=Parameters.of(tau=2, alpha=0.1 + 0.2, iterations=7, method="linearised"),
    mask="indicator:axis=x,above=0.0",
    result=RESULT,
    runs=(
        RunRecord(RESULT.energy_history, RESULT.stages, (2, len(RESULT.stages)), 0.25, "alpha 1"),
        RunRecord(np.ones((2, 3)), np.array([0, 1]), (), 0.5, "on two meshes", *COURSE),
        RunRecord(np.ones((2, 3)), np.array([0, 1]), (), 0.5, "of two terms", *COURSE, *TERMS),
        RunRecord(np.zeros((0, 3)), np.zeros(0, dtype=np.int64), (), 1.0, "cancelled at once"),
        RunRecord(np.ones((2, 3)), np.array([0, 1]), (), 0.5, "left", **ITERATES),
    ),
    time=1 / 3,
    lines=(Point(3, (0.25, 0.25, 0.5)), Point(79, (1.0, 0.0, 0.0))),
    points=(Point(0, (1.0, -1e-12, 1e-12)),),
    view=View(
        theme="dark",
        transport=True,
        streaks=True,
        fade=True,
        animate=True,
        look=Look(Front((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), 2.5, (0.1, 0.2, 0.3)),
        large="target",
        hidden=("source",),
        wireframe=True,
        finer=True,
    ),
)


@pytest.fixture
def saved(tmp_path):
    path = tmp_path / "my ☃ project.abfm"
    save_project(path, DOCUMENT, KNOWN)
    return path


def error_line(path):
    """Why a file is not opened, and what to do."""
    message = refusal(load_project, path)
    advice = ("take another copy", "upgrade abfm", "solve again", "open it as", "check the path")
    assert any(words in message for words in advice)
    return message


def assert_same(value, expected, where="document"):
    """Equal to the last bit, types and all, down to the arrays."""
    assert type(value) is type(expected), where
    if isinstance(expected, np.ndarray):
        assert_array_equal(value, expected, err_msg=where, strict=True)
    elif isinstance(expected, TriangleMesh):
        for name in ("vertices", "faces", "vertex_ids", "copies", "file_vertex_count", "edges"):
            assert_same(getattr(value, name), getattr(expected, name), f"{where}.{name}")
    elif isinstance(expected, Document | Match | PathStep | RunRecord | Surface):
        for name in (one.name for one in fields(expected) if one.name != "identity"):
            assert_same(getattr(value, name), getattr(expected, name), f"{where}.{name}")
    elif isinstance(expected, Problem):
        assert value.digest == expected.digest, where
    elif isinstance(expected, tuple):
        assert len(value) == len(expected), where
        for part, other in zip(value, expected, strict=True):
            assert_same(part, other, where)
    else:
        assert value == expected or (value != value and expected != expected), where


@pytest.mark.parametrize(
    "document",
    [
        DOCUMENT,
        MatchDocument((Surface(WHOLE, "nothing yet"),)),
        MatchDocument((Surface(WHOLE, "no channels"),), view=View(look=None)),
        MatchDocument((Surface(MERGED, "merged"),)),
        replace(DOCUMENT, result=replace(RESULT, problem=PLAIN), runs=()),
        replace(DOCUMENT, result=replace(RESULT, verified_residual=math.nan, folded=math.nan)),
        replace(DOCUMENT, result=replace(RESULT, verdict=CANCELLED)),
        replace(DOCUMENT, chosen=0),
    ],
    ids=lambda document: document.name.encode("ascii", "replace"),
)
def test_everything_comes_back(tmp_path, document):
    known = KNOWN if document.surface().mesh is SPHERE else {}
    save_project(tmp_path / "p.abfm", document, known)
    opened, values = load_project(tmp_path / "p.abfm")
    assert_same(opened, document)
    assert values.keys() == known.keys()
    for spec, array in known.items():
        assert_same(values[spec], array)


def test_a_project_is_plain_numpy_and_json_and_the_same_one_the_same_bytes(saved, tmp_path):
    with zipfile.ZipFile(saved) as archive:
        content = json.loads(archive.read("project.json"))
        with archive.open("result/velocity.npy") as file:
            assert_array_equal(np.load(file, allow_pickle=False), RESULT.velocity)
    assert content["format_version"] == 6
    assert content["document"]["view"]["theme"] == "dark"
    assert content["known"] == sorted(KNOWN)
    opened, values = load_project(saved)
    mesh = opened.surface().mesh
    assert opened.result.mesh is mesh  # and flows, and vertices keep their numbers
    assert_array_equal(opened.result.advect(0.5), RESULT.advect(0.5))
    assert (len(mesh.vertices), mesh.file_vertex_count) == (42, 43)
    assert mesh.local_vertex(6) == 5
    save_project(tmp_path / "again.abfm", opened, dict(reversed(values.items())))
    assert (tmp_path / "again.abfm").read_bytes() == saved.read_bytes()


def test_a_project_in_other_number_types_and_with_other_members_opens(saved):
    velocity = np.asfortranarray(RESULT.velocity)
    faces, vertices = SPHERE.faces.astype("<i4"), SPHERE.vertices.astype(">f8")
    changed(saved, arrays={"mesh/faces": faces, "mesh/vertices": vertices})
    changed(saved, arrays={"result/velocity": velocity, "runs/1/energies": np.ones((2, 3), int)})
    assert_same(load_project(saved)[0], DOCUMENT)
    rewrite(saved, {"unknown.npy": b"no array", "runs/7/stages.npy": b"none"})
    assert load_project(saved)[0].name == DOCUMENT.name


def test_remedies_come_back_and_a_view_with_one_field_has_the_defaults_of_the_others(saved):
    assert RESULT.verdict.remedies
    changed(saved, lambda content: content["document"].update(view={"theme": "dark"}))
    opened = load_project(saved)[0]
    assert opened.view == View(theme="dark")
    assert opened.result.verdict == RESULT.verdict


def test_every_term_of_a_run_has_its_share(saved):
    changed(saved, lambda content: content["runs"][2].update(words=["one"]))
    check_message(error_line(saved), 2, 1)


def test_large_meshes_are_kept_as_they_are_and_once(tmp_path):
    mesh, path = torus(250, 250), tmp_path / "p.abfm"
    velocity = np.random.default_rng(0).normal(size=(1, len(mesh.faces), 3))
    f = mesh.vertices[:, :1]
    problem = Problem(mesh, f, f, RESULT.parameters)
    result = replace(RESULT, problem=problem, advected=f, fine_velocity=velocity)
    save_project(
        path, MatchDocument((Surface(mesh, "large"),), result=result), {"file:x.npy": f[:, 0]}
    )
    held = [mesh.vertices, mesh.faces, mesh.vertex_ids, velocity, *4 * [f]]
    assert path.stat().st_size < sum(array.nbytes for array in held) + 50_000
    opened, known = load_project(path)
    assert np.array_equal(opened.result.velocity, velocity)
    assert np.array_equal(known["file:x.npy"], f[:, 0])


numbers = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.tuples(numbers, numbers, numbers)


def turned(angle):
    """A front at an angle about x."""
    return Front((0.0, -math.sin(angle), math.cos(angle)), (0.0, math.cos(angle), math.sin(angle)))


fronts = st.builds(turned, st.floats(-10, 10))
views = st.builds(
    View,
    theme=st.sampled_from(documents.THEMES),
    ui_scale=st.floats(0.5, 4),
    layout=st.sampled_from(documents.LAYOUTS),
    colormap=st.sampled_from(["automatic", *NAMES]),
    isolines=st.booleans(),
    isoline_count=st.integers(1, 100),
    coloring=st.sampled_from(documents.COLORINGS),
    arrow_length=st.floats(0.001, 10),
    arrow_density=st.floats(0, 1),
    look=st.none() | st.builds(Look, fronts, st.floats(0.2, 200), st.none() | vectors),
    flat=st.booleans(),
    hidden=st.lists(st.sampled_from(["source", "error"]), unique=True).map(tuple),
    part=st.sampled_from(documents.FIELD_PARTS),
    tool=st.sampled_from(documents.CLICK_TOOLS),
)
specs = st.builds(
    "gaussian:vertex={},width={!r}".format, st.integers(0, 42), st.floats(1e-300, 1e300)
)
points = st.builds(
    lambda face, u, v: Point(face, (1 - u, u * (1 - v), u * v)),
    st.integers(0, len(WHOLE.faces) - 1),
    st.floats(0, 1),
    st.floats(0, 1),
)
landmarks = st.lists(
    st.builds(Landmark, st.none() | points, points, st.floats(1e-9, 1e9), st.text(max_size=5)),
    max_size=4,
).map(tuple)
channels = st.lists(st.builds(Channel, specs, specs, numbers.map(abs))).map(tuple)


@settings(
    deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    view=views,
    channels=channels,
    landmarks=landmarks,
    alone=st.booleans(),
    surface=st.builds(Surface, st.just(WHOLE), st.text(), st.none() | fronts),
)
def test_any_view_channels_and_landmarks_come_back(
    tmp_path, view, channels, landmarks, alone, surface
):
    document = MatchDocument(
        (surface,), channels=channels, landmarks=landmarks, landmarks_alone=alone, view=view
    )
    save_project(tmp_path / "p.abfm", document, {})
    assert_same(load_project(tmp_path / "p.abfm")[0], document)


def changed(path, content=lambda content: None, arrays=(), compression=zipfile.ZIP_STORED):
    """Write a project anew with another `project.json` and other arrays: None leaves one out,
    bytes are put as such.
    """
    header = json.loads(members(path)["project.json"])
    content(header)
    others = {f"{name}.npy": array for name, array in dict(arrays).items()}
    rewrite(path, {"project.json": json.dumps(header).encode()} | others, compression)


V, F = len(SPHERE.vertices), len(SPHERE.faces)
ALIKE = {"mesh/vertex_ids": np.zeros((0,), dtype=int), "mesh/vertices": np.zeros((0, 3))}
TURNED = np.vstack([SPHERE.faces[:1, ::-1], SPHERE.faces[1:]])
BENT = {"direction": [1, 0, 0], "up": [1, 0, 0]}
FLAT = {"front": {"direction": [1, 0, 0], "up": [0, 1, 0]}, "zoom": 0}
RUN, HKS = {"residual": 0, "label": "a"}, {"source": "hks", "target": "hks"}


def same_shape(opened):
    assert opened[0].result.velocity.shape == (1, F, 3)


def test_a_cut_flipped_bits_and_one_wrong_byte_of_a_header_are_noticed(saved, tmp_path):
    whole, damaged = saved.read_bytes(), tmp_path / "damaged.abfm"
    for length in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        damaged.write_bytes(whole[:length])
        check_message(error_line(damaged))
    content = members(saved)
    for other in hostile.one_byte_changed(content["result/velocity.npy"], 128):
        saved.write_bytes(zipped(content | {"result/velocity.npy": other}))
        hostile.load_or_refuse(saved, load_project, same_shape)
    saved.write_bytes(zipped(content))
    hostile.with_flipped_bits(saved, load_project, lambda opened: assert_same(opened[0], DOCUMENT))


@pytest.mark.parametrize("member", ["project.json", "mesh/faces", "runs/1/stages", "result/mask"])
def test_a_missing_member_is_named(saved, member):
    changed(saved, arrays={member: None})
    if member == "project.json":
        saved.write_bytes(zipped({"readme.txt": b"hello"}))
    assert member in error_line(saved)


@pytest.mark.parametrize(
    ("name", "array", "named"),
    [
        ("mesh/vertices", SPHERE.vertices[1:], ("(41, 3)", "(42, 3)", "mesh/vertices")),
        ("mesh/vertices", np.full((V, 3), np.nan), ("mesh/vertices",)),
        ("mesh/faces", np.full((F, 3), V), (0, 41)),
        ("mesh/faces", -SPHERE.faces, (0, 41)),
        ("mesh/faces", SPHERE.faces * 1.0, ("mesh/faces", "float64")),
        ("mesh/faces", SPHERE.faces[:0], ("(0, 3)", "mesh/faces")),
        ("mesh/faces", SPHERE.faces[:1], ()),
        ("mesh/faces", TURNED, ()),
        ("mesh/faces", np.int64(3), ("mesh/faces",)),
        ("mesh/vertex_ids", SPHERE.vertex_ids[::-1], ("vertex_ids",)),
        ("mesh/vertex_ids", SPHERE.vertex_ids + 1, ("vertex_ids", 0, 42)),
        ("mesh/vertex_ids", SPHERE.vertex_ids - 1, ("vertex_ids", 0, 42)),
        (None, ALIKE, ("vertex_ids",)),
        ("known/0", X[:-1], ("(41,)", "file:x.npy", 42)),
        ("known/0", np.full(V, np.inf), ("file:x.npy",)),
        ("runs/0/energies", np.zeros((1, 3)), ("runs/0/energies",)),
        ("runs/0/stages", RESULT.stages * 1.0, ("runs/0/stages", "float64")),
        ("runs/1/vertices", np.array([12]), ("runs/1/vertices",)),
        ("runs/1/reaches", np.array([True, False]), ("runs/1/reaches",)),
        ("runs/1/reaches", None, ("runs/1/reaches",)),
        ("runs/4/residuals", np.array([0.5]), ("(1,)", "runs/4/residuals", 2)),
        ("result/velocity", np.zeros((1, F - 1, 3)), ("result/velocity",)),
        ("result/velocity", np.zeros((2, F, 3)), (2, 1)),
        ("result/velocity", RESULT.velocity.astype(complex), ("complex128",)),
        ("result/mask", np.zeros(V + 1), ("result/mask",)),
        ("result/source", X, ("result/source",)),
        ("result/weights", np.ones(3), ("(3,)", "result/weights", 2)),
        ("result/weights", np.float64(1), ("result/weights",)),
        ("result/weights", np.array([None, None]), ()),
        ("result/weights", b"", ()),
        ("result/weights", b"\x93NUMPY\x09\x00", ()),
        ("result/weights", npy_of("(10000000000000,)"), ()),
        ("result/weights", npy_of("(-1,)"), ()),
        ("result/weights", npy_of("(1,)", data=bytes(9)), ()),
        ("result/mask", -np.ones(V), ("result/mask", -1, 0)),
        ("result/velocity", np.full((1, F, 3), 1e300), ("velocity", "1e+300")),
        ("result/weights", np.array([-1.0, 1.0]), ("result/weights", -1)),
        ("result/velocity", npy_of("(1, 6442450944, 3)", data=bytes(8)), ("result/velocity",)),
        ("mesh/faces", SPHERE.faces[~(SPHERE.faces == 3).any(axis=1)], ()),
        ("runs/1/stages", np.array([-1, 0]), ("runs/1/stages",)),
        ("runs/1/vertices", np.array([-1, 0]), ("runs/1/vertices",)),
        ("runs/1/reaches", np.array([-0.5, 0]), ("runs/1/reaches",)),
    ],
)
def test_arrays_that_do_not_fit_are_named(saved, name, array, named):
    changed(saved, arrays={name: array} if name else array)
    check_message(error_line(saved), *named)


@pytest.mark.parametrize(
    ("part", "name", "value", "named"),
    [
        ("", "format_version", 7, ()),
        ("", "format_version", 2, ()),
        ("", "format_version", 0, ("format_version", 0)),
        ("", "format_version", "one", ("one", "format_version")),
        ("", "format_version", None, ("format_version",)),
        ("", "file_vertex_count", 12, ("vertex_ids", 0, 11)),
        ("", "file_vertex_count", 10**15, (1000000000000000, 42)),
        ("", "runs", [RUN | {"restarts": []}] * 6, ("runs/5",)),
        ("", "runs", [RUN | {"restarts": [99]}], ("restarts",)),
        ("", "known", ["a", "b", "c"], ("known/2",)),
        ("", "document", None, ("project.document",)),
        ("", "file_vertex_count", 10**8, (100000000, V)),
        ("", "file_vertex_count", 4 * 10**18, (4000000000000000000,)),
        ("", "file_vertex_count", 10**30, ()),
        ("", "file_vertex_count", -1, ("vertex_ids",)),
        ("", "format_version", [[0] * 100] * 100, ("format_version",)),
        ("", "x\n" * 5000, 1, ("project",)),
        ("", "known", ["a", "b", "\n" * 5000], ("known/2",)),
        ("document", "side", "x\n" * 5000, ("project.document.side",)),
        ("document", "time", 10**4000, ()),
        ("document", "bump", -(10**4000), ("bump",)),
        ("document", "channels", [HKS | {"source": "\x1b" * 9999}], ()),
        ("document", "channels", [HKS | {"source": "x" * 99_999}], (10000,)),
        ("document", "parameters", {"x\n" * 5000: 1}, ("unknown",)),
        ("result", "residual", -1, ("result/residual", -1)),
        ("result", "folded", 2, ("result/folded", 2, 0, 1)),
        ("result", "stop_reason", "a\nb", ()),
        ("result", "residual", [[1]] * 1000, ("(1000, 1)", "result/residual")),
        ("result", "residual", [[1], []], ()),
        ("result", "residual", {"a": 1}, ("result/residual",)),
        ("result", "verdict", ["good", "none", "", ""], ("good",)),
        ("result", "verdict", ["missing", "none", "", ""], ("missing",)),
        ("result", "verdict", ["matched", "luck", "", ""], ("luck",)),
        ("result", "verdict", ["matched"], ("(1,)", "result/verdict")),
        ("result", "verdict", None, ("result/verdict",)),
        ("result", "remedies", [{}], ("result/remedies",)),
        ("result", "remedies", "[{}]", ("remedies",)),
        ("document", "name", 3, ("project.document.name", 3)),
        ("document", "channel", 2, ("channel", 2, 0, 1)),
        ("document", "channel", -1, ("channel", -1)),
        ("document", "channel", True, ("document.channel",)),
        ("document", "channel", 0.5, ("document.channel", "0.5")),
        ("document", "bump", -1, ("bump", -1)),
        ("document", "chosen", 1, ("chosen", 1, 0)),
        ("document", "side", "left", ("source", "target")),
        ("document", "channels", "many", ()),
        ("document", "channels", [{"source": "coordinate:x"}], ()),
        ("document", "channels", [HKS | {"source": "no:x"}], ("no",)),
        ("document", "channels", [HKS | {"weight": -1}], ("weight", "-1.0")),
        ("document", "mask", "(", ("(",)),
        ("document", "time", 4.5, ("time", "4.5", 0, "4.0")),
        ("document", "time", -1, ("time", "-1.0")),
        ("document", "time", float("nan"), ()),
        ("document", "time", 10**400, ()),
        ("document", "parameters", {"alpha": -1}, ("alpha", -1)),
        ("document", "parameters", {"beyond": 1}, ("beyond",)),
        ("document", "lines", [{"face": F, "barycentric": [1, 0, 0]}], (80, 0, 79)),
        ("document", "points", [{"face": -1, "barycentric": [1, 0, 0]}], (-1,)),
        ("document", "landmarks", [{"target": {"face": F, "barycentric": [1, 0, 0]}}], (80,)),
        ("document", "landmarks", [{"weight": 0}], ("weight", "0.0", 0)),
        ("document", "landmark", 1, ("landmark", 1, 0)),
        ("document", "points", [{"face": 0, "barycentric": [1, 0]}], (3,)),
        ("document", "points", [{"face": 0, "barycentric": [1, 1, -1]}], ()),
        ("document", "points", [{"face": 0, "barycentric": [1, 1, 1]}], ()),
        ("document", "view", {"theme": "pink"}, ("light", "dark")),
        ("document", "view", {"coloring": "rainbow"}, ("coloring",)),
        ("document", "view", {"coloring": ["function"]}, ("coloring",)),
        ("document", "view", {"colormap": "jet"}, ("colormap", "jet")),
        ("document", "view", {"no such": 1}, ("no such",)),
        ("document", "view", {"ui_scale": 0}, ("ui_scale", 0)),
        ("document", "view", {"camera": None}, ("camera",)),
        ("document", "view", {"front": BENT}, ("front",)),
        ("document", "view", [], ("view",)),
        ("document", "name", None, ()),
        ("document", "view", {"look": {"front": BENT}}, ("front",)),
        ("document", "view", {"look": FLAT}, ("zoom", "0.0")),
        ("document", "unheard", 1, ("unheard",)),
    ],
)
def test_headers_that_make_no_sense_are_told_in_one_line(saved, part, name, value, named):
    changed(saved, lambda content: (content[part] if part else content).update({name: value}))
    check_message(error_line(saved), *named)


@pytest.mark.parametrize(
    "text",
    [
        *("", "[1]", "{", "[" * 100_000, '{"a":' * 100_000, "1" * 100_000, "\xff"),
        *("NaN", "-Infinity", '"' + "x" * 100_000, '"\\ud800"'),
    ],
)
def test_json_that_is_no_header_is_refused(saved, text):
    rewrite(saved, {"project.json": text.encode("latin-1")})
    check_message(error_line(saved))
    assert not re.search("codec|set_int_max", error_line(saved))


def test_what_is_not_an_array_is_small_and_nothing_is_unpacked_to_more_than_the_file_holds(saved):
    many = replace(DOCUMENT, points=(Point(0, (1.0, 0.0, 0.0)),) * 30_000)
    with raises(ResultError):
        save_project(saved, many, KNOWN)
    changed(saved, compression=zipfile.ZIP_DEFLATED)
    check_message(error_line(saved))
    rewrite(saved, {"project.json": members(saved)["project.json"] + b" " * (2 << 20)})
    check_message(error_line(saved), "project.json")


def test_files_of_another_kind_are_named(tmp_path):
    RESULT.save(tmp_path / "r.npz")
    (tmp_path / "text.abfm").write_text("not a zip")
    os.mkfifo(tmp_path / "pipe.abfm")
    (tmp_path / "zero.abfm").symlink_to("/dev/zero")
    hostile.overlapping_zip(tmp_path / "a.abfm", ["project.json", "mesh/faces.npy"], b"{}")
    for name, words in (
        ("r.npz", "a result file, not a project"),
        ("text.abfm", "no project of abfm"),
        ("none.abfm", "No such file"),
        ("", "directory"),
        ("pipe.abfm", "it is a pipe"),
        ("zero.abfm", "it is a device"),
        ("a.abfm", "damaged"),
    ):
        assert words in error_line(tmp_path / name)
        assert load_origin(tmp_path / name) is None


@pytest.mark.parametrize(
    ("change", "known", "named"),
    [
        ({"time": float("nan")}, {}, ("document.time", "nan")),
        ({"channel": 5}, {}, ("channel", 5)),
        ({"view": View(theme="pink")}, {}, ("theme",)),
        ({"surfaces": (Surface(torus(8, 8), "torus"),)}, {}, ("result/source",)),
        ({}, {"file:x.npy": X[1:]}, ("file:x.npy",)),
        ({}, {"file:x.npy": np.full(V, np.inf)}, ()),
    ],
)
def test_what_would_not_open_is_not_saved(saved, change, known, named):
    before = saved.read_bytes()
    with pytest.raises(ResultError) as caught:
        save_project(saved, replace(DOCUMENT, **change), known)
    check_message(str(caught.value), saved, *named)
    assert saved.read_bytes() == before
    assert os.listdir(saved.parent) == [saved.name]


DETECTED = "permuted:rotation(coordinate:x + file:a.npy)"
READ = "permuted:b.txt(file:a.npy + coordinate:x)"


@pytest.mark.parametrize(
    ("spec", "terms"),
    [
        ("gaussian:vertex=1 + coordinate:x", []),
        ("file: a.npy", ["file:a.npy"]),
        ("file:path=a.csv,column=2", ["file:a.csv,column=2"]),
        ("file:a.npy + hks + (permuted:b.txt(hks))", ["file:a.npy", "permuted:b.txt(hks)"]),
        ("permuted:mirror(coordinate:x) + coordinate:y", []),
        (DETECTED, [DETECTED]),
        (READ, [READ]),
    ],
)
def test_terms_that_read_files(spec, terms):
    assert project.terms_from_files(spec) == terms


def test_opening_loads_no_solver_before_there_is_a_result(tmp_path):
    save_project(tmp_path / "p.abfm", MatchDocument((Surface(WHOLE, "empty"),)), {})
    code = (
        "import sys; from abfm_viewer.files.project import load_project; "
        "load_project(sys.argv[1]);"
        "print(sorted({'numba', 'scipy', 'igl', 'cholespy', 'polyscope'} & set(sys.modules)))"
    )
    assert python(code, tmp_path / "p.abfm", check=True).stdout == "[]\n"


def test_missing_fields_take_their_defaults_and_needed_ones_are_named():
    assert project.from_plain(View, {}, "view") == View()
    with raises(ValueError, "target"):
        project.from_plain(Channel, {"source": "a"}, "channel")
    with raises(ValueError, "weight"):
        project.from_plain(Channel, {"source": "a", "target": "b", "weight": True}, "channel")


@given(st.lists(st.builds(Channel, st.text(), st.text(), numbers)).map(tuple))
def test_any_text_survives_json(channels):
    plain = json.loads(json.dumps(channels, default=project.to_plain))
    assert project.from_plain(tuple[Channel, ...], plain, "channels") == channels


# Files that are known from earlier: whether they are still there, and as they were


@pytest.fixture
def origin(tmp_path):
    """Of a file whose name is not plain."""
    path = tmp_path / "a prøject.abfm"
    path.write_text("one")
    return Origin.of(path)


def test_a_file_is_unchanged_until_it_is_written_and_none_when_it_is_gone(origin):
    assert (origin.exists, origin.changed) == (True, False)
    state = origin.path.stat()
    origin.path.write_text("two")
    os.utime(origin.path, ns=(state.st_atime_ns, state.st_mtime_ns + 1))
    assert origin.changed
    os.utime(origin.path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert not origin.changed
    origin.path.write_text("three")
    os.utime(origin.path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert origin.changed  # its size tells
    origin.path.unlink()
    assert (origin.exists, origin.changed) == (False, False)


def test_a_copy_says_of_which_file_it_is_as_long_as_that_is_there(origin, tmp_path):
    copy = tmp_path / "copy.abfm"
    save_project(copy, MatchDocument((Surface(WHOLE, "sphere"),)), {}, origin)
    assert load_origin(copy) == origin
    origin.path.unlink()
    assert load_origin(copy) is None
    save_project(copy, MatchDocument((Surface(WHOLE, "sphere"),)), {})
    assert load_origin(copy) is None


@pytest.mark.parametrize(
    "text",
    [
        *("[]", "{", "[" * 100_000, "1" * 5000, '"\\ud800"'),
        '{"path": 1, "modified": 2, "size": 3}',
        '{"path": "\\u0000", "modified": 2, "size": 3}',
        '{"path": "/", "modified": 1e999, "size": 0}',
    ],
)
def test_copies_may_say_anything_of_their_origin(tmp_path, text):
    path = tmp_path / "p.abfm"
    save_project(
        path, MatchDocument((Surface(WHOLE, "sphere"),)), {}, Origin.of(tmp_path / "q.abfm")
    )
    rewrite(path, {project.MEMBER: text.encode()})
    assert load_origin(path) is None
    assert load_project(path)[0].name == "sphere"


@pytest.mark.parametrize(
    ("name", "value", "named"),
    [
        ("keys", [2, 1], ("keys",)),
        ("keys", [1, 3], ("labels", "keys")),
        ("names", ["one"], ()),
        ("colors", [[0, 0, 0], [0, 0, 2]], (0, 1)),
        ("colors", [[0, 0, 0], [0, 0]], (3,)),
        ("values", 3, ()),
    ],
)
def test_labels_that_do_not_fit_are_refused(tmp_path, name, value, named):
    labels = LabelMap.of("a.annot", WHOLE, Labels(np.arange(V) % 2 + 1, {1: "one", 2: "two"}))
    path = tmp_path / "p.abfm"
    save_project(path, MatchDocument((Surface(WHOLE, "ball"),), labels=labels), {})
    assert load_project(path)[0].labels.colors == labels.colors
    changed(path, lambda content: content["labels"].update({name: value}))
    check_message(error_line(path), *named)
