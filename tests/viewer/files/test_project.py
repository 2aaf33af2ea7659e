import io
import itertools
import json
import math
import os
import re
import zipfile
from dataclasses import fields, is_dataclass, replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from abfm import (
    Correspondence,
    Parameters,
    Problem,
    ResultError,
    TriangleMesh,
    load,
    match,
    sequence,
)
from abfm.matching import Verdict
from abfm.outcome import Outcome
from abfm.pages.colormaps import NAMES
from abfm.pages.front import Front
from abfm.reading.labels import Labels
from abfm.sequences import defaults
from abfm.sequences.frames import check_frames
from abfm.workers.control import Control
from abfm_viewer.document import document as documents
from abfm_viewer.document.document import (
    Channel,
    InitialMap,
    Landmark,
    MapRequest,
    Point,
    RunRecord,
    Surface,
    View,
    Viewpoint,
)
from abfm_viewer.document.frame_sequence import FrameSequence, SequenceSettings
from abfm_viewer.document.kinds import (
    MatchDocument,
    PairDocument,
    SequenceDocument,
    SubjectDocument,
)
from abfm_viewer.document.label_map import LabelMap
from abfm_viewer.files import project
from abfm_viewer.files.project import Origin, load_origin, load_project, save_project
from abfm_viewer.session.sequence_files import circular_sequence
from tests.core.reading import hostile
from tests.core.reading.hostile import members, message_of, npy_of, refusal, rewrite
from tests.messages import check_message, raises
from tests.processes import python
from tests.shapes import icosphere, torus, with_loose_vertex

BALL = icosphere(1)
SPHERE = with_loose_vertex(BALL)
"""Of 43 vertices in its file it has 42."""
CORNERS = np.arange(BALL.faces.size).reshape(-1, 3)
MERGED = TriangleMesh(BALL.vertices[BALL.faces.ravel()], CORNERS, merge=True)
X, Y = SPHERE.vertices[:, 0].copy(), SPHERE.vertices[:, 1].copy()
KNOWN = {"permuted:map ☃.txt(file:x.npy)": Y, "file:x.npy": X}


XY, YX = np.stack([X, Y], axis=1), np.stack([Y, X], axis=1)
SHORT_RUN = Parameters.of(iterations=5, refine=0, segments=1)
RESULT = match(SPHERE, XY, YX, SHORT_RUN, mask=X**2, weights=[1, 0.5])
RESULT = replace(RESULT, path=(), step=0)  # other steps are stored in single precision
LEVELS = np.array([12, 42]), np.array([0.5, 0.0])
CANCELLED = Verdict(Outcome.NOT_REACHED, "cancelled", "")
ITERATES = {
    "residuals": np.array([0.7, 0.5]),
    "sigmas": np.array([0.2, 0.1]),
    "attempts": np.array([1, 2]),
}
TERMS = ("closeness", "landmarks"), np.array([[2.0, 1.0], [1.0, 0.0]])
PROBLEM = Problem(SPHERE, RESULT.source, RESULT.target, RESULT.parameters)
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
        RunRecord(np.ones((2, 3)), np.array([0, 1]), (), 0.5, "on two meshes", *LEVELS),
        RunRecord(np.ones((2, 3)), np.array([0, 1]), (), 0.5, "of two terms", *LEVELS, *TERMS),
        RunRecord(np.zeros((0, 3)), np.zeros(0, dtype=np.int64), (), 1.0, "cancelled at once"),
        RunRecord(np.ones((2, 3)), np.array([0, 1]), (), 0.5, "left", **ITERATES),
    ),
    labels=LabelMap.of("a.annot", SPHERE, Labels(np.arange(42) % 2 + 1, {1: "one", 2: "two"})),
    time=1 / 3,
    lines=(Point(3, (0.25, 0.25, 0.5)), Point(79, (1.0, 0.0, 0.0))),
    points=(Point(0, (1.0, -1e-12, 1e-12)),),
    view=View(
        transport=True,
        streaks=True,
        fade=True,
        animate=True,
        viewpoint=Viewpoint(Front((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), 2.5, (0.1, 0.2, 0.3)),
        enlarged="target",
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


MESH_PARTS = ("vertices", "faces", "vertex_ids", "copies", "file_vertex_count", "edges")


def parts_of(value):
    """Return the parts of a value that are compared; None if it has none."""
    if isinstance(value, TriangleMesh):
        return {name: getattr(value, name) for name in MESH_PARTS}
    if isinstance(value, Correspondence):
        return value.arrays()
    if isinstance(value, tuple):
        return dict(enumerate(value))
    if not is_dataclass(value) or isinstance(value, Parameters | Problem):
        return None
    return {one.name: getattr(value, one.name) for one in fields(value) if one.name != "identity"}


def assert_same(value, expected, where="document"):
    """Assert that values have equal types and equal bits, including arrays."""
    assert type(value) is type(expected), where
    if isinstance(expected, np.ndarray):
        assert_array_equal(value, expected, err_msg=where, strict=True)
    elif isinstance(expected, Problem):
        assert value.digest == expected.digest, where
    elif (parts := parts_of(expected)) is not None:
        own = parts_of(value)
        assert own.keys() == parts.keys(), where
        for name, part in parts.items():
            assert_same(own[name], part, f"{where}.{name}")
    else:
        assert value == expected or (value != value and expected != expected), where


def pair():
    """Return two surfaces with a match that started with the map by vertex numbers."""
    a, b = (icosphere(1, radius) for radius in (1, 2))
    initial = Correspondence.of_same_faces(a, b)
    found = match(b, a.vertices[:, :1], b.vertices[:, 1:2], SHORT_RUN)
    channels, mark = (Channel("coordinate:x", "coordinate:y"),), Point(3, (1.0, 0.0, 0.0))
    initial_map = InitialMap(
        initial, MapRequest("connectivity", channels, "", (), False), ("a note",), found.source
    )
    surfaces = Surface(a, "A"), Surface(b, "B")
    return PairDocument(
        surfaces,
        channels,
        SHORT_RUN,
        landmarks=(Landmark(mark), Landmark(mark, mark, name="both")),
        result=replace(found, path=(), step=0),
        initial_map=replace(initial_map, warnings=("a warning",)),
        initial="connectivity",
    )


def sequence_document(solved=True):
    """Return phases with a mask, compared by cosine and sine, without the second field."""
    values = np.arange(4)[:, None] + X
    values[:, 4] = values[1] = np.nan
    phases = check_frames(SPHERE, values, (0.0, 0.2, 0.5, 2.0), None, [2.0])
    shown = circular_sequence(FrameSequence("wave", phases), 7.0)
    assert [*map(shown.frame_label, range(3))] == ["frame 0, 0 s", "frame 2, 0.5 s", "frame 3, 2 s"]
    control, settings = Control(), defaults(alpha=0.1, sigma=0.5, order=1)
    given = {"mask": shown.frames.mask, "weights": shown.frames.weights}
    stop = {"on_interval": lambda number: control.cancel(), "control": control}
    values = shown.frames.values.copy()
    found = sequence(SPHERE, values, shown.times, settings, **given, **stop)
    assert found.solved.tolist() == [True, False]
    result = replace(found, _frames=shown.frames) if solved else None
    settings = SequenceSettings(alpha=0.1, sigma=0.5, order=1)
    return SequenceDocument(
        (Surface(SPHERE, "ball"),), shown, settings=settings, result=result, channel=1, time=0.75
    )


@pytest.mark.parametrize(
    "document",
    [
        DOCUMENT,
        MatchDocument((Surface(BALL, "nothing yet"),)),
        MatchDocument((Surface(MERGED, "merged"),)),
        replace(DOCUMENT, result=replace(RESULT, problem=PROBLEM), runs=()),
        replace(DOCUMENT, result=replace(RESULT, verified_residual=math.nan, folded=math.nan)),
        replace(DOCUMENT, result=replace(RESULT, verdict=CANCELLED)),
        replace(DOCUMENT, solver_step=0),
        replace(DOCUMENT, surfaces=(Surface(with_loose_vertex(BALL), "equal mesh"),)),
        pair(),
        replace(pair(), result=None, initial_map=None),
        sequence_document(),
        sequence_document(solved=False),
    ],
    ids=lambda document: f"{type(document).__name__} {document.name}".encode("ascii", "replace"),
)
def test_documents_are_restored_from_projects(tmp_path, document):
    known = KNOWN if document.surface().mesh is SPHERE and document.channels else {}
    save_project(tmp_path / "p.abfm", document, known)
    opened, values = load_project(tmp_path / "p.abfm")
    assert_same(opened, document)
    assert values.keys() == known.keys()
    for spec, array in known.items():
        assert_same(values[spec], array)
    save_project(tmp_path / "again.abfm", opened, dict(reversed(values.items())))
    assert (tmp_path / "again.abfm").read_bytes() == (tmp_path / "p.abfm").read_bytes()


@pytest.mark.parametrize(
    "document", [DOCUMENT, pair(), sequence_document()], ids=["match", "pair", "sequence"]
)
def test_projects_contain_result_files(tmp_path, document):
    save_project(tmp_path / "p.abfm", document, {})
    content = members(tmp_path / "p.abfm")
    (tmp_path / "r.npz").write_bytes(content["result.npz"])
    document.complete_result.save(tmp_path / "own.npz")
    own, in_project = members(tmp_path / "own.npz"), members(tmp_path / "r.npz")
    assert in_project == own
    assert type(load(tmp_path / "r.npz")) is type(document.complete_result)
    assert not any(name.endswith("faces.npy") for name in content)
    opened = load_project(tmp_path / "p.abfm")[0]
    assert opened.result.mesh is opened.surface().mesh
    if opened.initial_map:
        assert opened.initial_map.correspondence.a is opened.surface("source").mesh
    if isinstance(opened, SequenceDocument):
        assert not opened.is_outdated
        assert opened.sequence.phases.mesh is opened.surface().mesh


def test_subjects_open_without_their_population(tmp_path):
    subject = {one.name: getattr(DOCUMENT, one.name) for one in fields(DOCUMENT)}
    save_project(tmp_path / "p.abfm", SubjectDocument(**subject, comparison=None), KNOWN)
    assert_same(load_project(tmp_path / "p.abfm")[0], DOCUMENT)


def test_numbers_of_other_types_and_unknown_members_are_read(saved):
    changed(saved, arrays={"document/runs/1/energies": np.ones((2, 3), int)})
    changed(saved, arrays={"document/runs/2/stages": np.array([0, 1], ">i4")})
    rewrite(saved, {"unknown.npy": b"no array", "unknown.json": b"none"})
    assert_same(load_project(saved)[0], DOCUMENT)


def test_missing_fields_take_their_defaults(saved):
    def cut(header, view):
        view.clear()
        view["flat"] = True
        del header["document"]["runs"]

    changed(saved, cut)
    opened = load_project(saved)[0]
    assert (opened.view, opened.runs) == (View(flat=True), ())
    assert opened.result.verdict == RESULT.verdict


numbers = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.tuples(numbers, numbers, numbers)


def turned(angle):
    """Return a front that is rotated about x."""
    return Front((0.0, -math.sin(angle), math.cos(angle)), (0.0, math.cos(angle), math.sin(angle)))


fronts = st.builds(turned, st.floats(-10, 10))
views = st.builds(
    View,
    layout=st.sampled_from(documents.LAYOUTS),
    arrow_density=st.floats(0, 1),
    colormap=st.sampled_from(["automatic", *NAMES]),
    isoline_count=st.integers(1, 100),
    arrow_length=st.floats(0.001, 10),
    viewpoint=st.none() | st.builds(Viewpoint, fronts, st.floats(0.2, 200), st.none() | vectors),
    hidden=st.lists(st.sampled_from(["source", "error"]), unique=True).map(tuple),
)
specs = st.builds(
    "gaussian:vertex={},width={!r}".format, st.integers(0, 42), st.floats(1e-300, 1e300)
)
points = st.builds(
    lambda face, u, v: Point(face, (1 - u, u * (1 - v), u * v)),
    st.integers(0, len(BALL.faces) - 1),
    st.floats(0, 1),
    st.floats(0, 1),
)
landmarks = st.lists(
    st.builds(Landmark, st.none() | points, points, st.floats(1e-9, 1e9), st.text(max_size=5)),
    max_size=4,
).map(tuple)
channels = st.lists(st.builds(Channel, specs, specs, numbers.map(abs))).map(tuple)


@settings(max_examples=30)
@given(
    view=views,
    channels=channels,
    landmarks=landmarks,
    alone=st.booleans(),
    surface=st.builds(Surface, st.just(BALL), st.text(), st.none() | fronts),
)
def test_views_channels_and_landmarks_are_restored(
    tmp_path, view, channels, landmarks, alone, surface
):
    document = MatchDocument(
        (surface,), channels=channels, landmarks=landmarks, landmarks_alone=alone, view=view
    )
    save_project(tmp_path / "p.abfm", document, {})
    assert_same(load_project(tmp_path / "p.abfm")[0], document)


def changed(path, content=lambda header, view: None, arrays=()):
    """Write a project again with other JSON and arrays; None removes an array."""
    texts = {name: json.loads(members(path)[name]) for name in ("project.json", "view.json")}
    content(*texts.values())
    others = {f"{name}.npy": array for name, array in dict(arrays).items()}
    plain = {name: json.dumps(text).encode() for name, text in texts.items()}
    rewrite(path, plain | others)


def leaves(value, place=()):
    """Return all places in JSON; of lists only the first entry."""
    parts = value.items() if isinstance(value, dict) else enumerate(value[:1])
    for name, part in parts:
        yield (*place, name)
        if isinstance(part, dict | list):
            yield from leaves(part, (*place, name))


def put(value, place, new):
    *above, last = place
    for name in above:
        value = value[name]
    value[last] = new


def put_in(number, place, new, *texts):
    """Replace the value at a place of one of the JSON members."""
    put(texts[number], place, new)


def error_line(path):
    return with_advice(refusal(load_project, path))


def with_advice(message):
    advice = ("use another copy", "upgrade abfm", "solve again", "rename it", "check the path")
    assert any(words in message.lower() for words in advice)
    return message


V, F = len(SPHERE.vertices), len(SPHERE.faces)
INVALID_FRONT = {"direction": [1, 0, 0], "up": [1, 0, 0]}
INVALID_VIEWPOINT = {"front": {"direction": [1, 0, 0], "up": [0, 1, 0]}, "zoom": 0}
HKS = {"source": "hks", "target": "hks"}
VALUES = [None, -1, 0.5, True, "x\n" * 5000, "result", "known/0", [], {}, math.inf, 10**400, [[0]]]


def test_damaged_files_are_refused(saved, tmp_path):
    complete, damaged = saved.read_bytes(), tmp_path / "damaged.abfm"
    for length in (0, 1, 100, len(complete) // 2, len(complete) - 1):
        damaged.write_bytes(complete[:length])
        check_message(error_line(damaged))
    for name in members(saved):
        damaged.write_bytes(complete)
        rewrite(damaged, {name: None})
        assert name.removesuffix(".npy") in error_line(damaged)
    hostile.with_flipped_bits(saved, load_project, lambda opened: assert_same(opened[0], DOCUMENT))


@pytest.mark.parametrize(
    "document", [DOCUMENT, pair(), sequence_document()], ids=["match", "pair", "sequence"]
)
def test_changed_json_is_refused_or_opens(tmp_path, document):
    path = tmp_path / "p.abfm"
    save_project(path, document, KNOWN if document is DOCUMENT else {})
    complete = path.read_bytes()
    texts = [json.loads(members(path)[name]) for name in ("project.json", "view.json")]
    if document is not DOCUMENT:
        texts.pop()
    places = [(number, place) for number, text in enumerate(texts) for place in leaves(text)]
    refused = 0
    for number, (text, place) in enumerate(places):
        value = VALUES[number % len(VALUES)]
        path.write_bytes(complete)
        changed(path, partial(put_in, text, place, value))
        try:
            opened, known = load_project(path)
        except ResultError as error:
            with_advice(message_of(error, path))
            refused += 1
        else:
            save_project(path, opened, known)
    assert refused > len(places) / 2


OTHER_CONTENTS = [
    np.ones((3, 3, 3)),
    np.ones(2, complex),
    np.array([None, None]),
    np.array([np.nan, np.inf]),
    b"",
    b"\x93NUMPY\x09\x00",
    npy_of("(10000000000000,)"),
    npy_of("(-1,)"),
    npy_of("(1,)", data=bytes(9)),
]


def test_invalid_arrays_are_refused(saved):
    complete = saved.read_bytes()
    contents = itertools.cycle(OTHER_CONTENTS)
    for name in (name for name in members(saved) if name.endswith(".npy")):
        array = np.load(io.BytesIO(members(saved)[name]))
        others = [*itertools.islice(contents, 4), *([array[1:]] if len(array) else [])]
        others += [-1 - array] if array.size and re.search("stages|vert|reach|shares", name) else []
        for other in others:
            rewrite(saved, {name: other})
            error_line(saved)
            saved.write_bytes(complete)
    changed(saved, arrays={"known/0": X[:-1]})
    check_message(error_line(saved), "(41,)", "file:x.npy", 42)


def test_damaged_results_are_refused(saved):
    inner = saved.with_name("r.npz")
    inner.write_bytes(members(saved)["result.npz"])
    for name, array in (("advected.npy", None), ("velocity.npy", np.zeros((1, F - 1, 3)))):
        rewrite(inner, {name: array})
        rewrite(saved, {"result.npz": inner.read_bytes()})
        assert name.removesuffix(".npy") in error_line(saved)
        RESULT.save(inner)
    ring = torus(8, 8)
    match(ring, ring.vertices[:, 0], ring.vertices[:, 1], SHORT_RUN).save(inner)
    rewrite(saved, {"result.npz": inner.read_bytes()})
    check_message(error_line(saved), "file:x.npy")


@pytest.mark.parametrize(
    ("name", "value", "named"),
    [
        ("format_version", 12, ()),
        ("format_version", 9, (9, 10)),
        ("kind", "sphere", ("sphere", "match", "sequence")),
        ("kind", "sequence", ()),
        ("has_result", False, ("result",)),
        ("known", {"a": "known/7"}, ("known/7",)),
        ("document.runs.0.restarts", [99], ("restarts",)),
        ("document.parameters", {"beyond": 1}, ("beyond",)),
        ("document.channel", 2, ("channel", 2, 0, 1)),
        ("document.bump", -1, ("bump", -1)),
        ("document.solver_step", 1, ("solver_step", 1, 0)),
        ("document.side", "left", ("source", "target")),
        ("document.channels", [{"source": "coordinate:x"}], ("target",)),
        ("document.channels", [HKS | {"source": "no:x"}], ("no",)),
        ("document.channels", [HKS | {"weight": -1}], ("weight", "-1.0")),
        ("document.mask", "(", ("(",)),
        ("document.time", 4.5, ("time", "4.5", 0, "4.0")),
        pytest.param("document.time", 10**4000, (), id="many digits"),
        ("document.lines", [{"face": F, "barycentric": [1, 0, 0]}], (80, 0, 79)),
        ("document.points", [{"face": -1, "barycentric": [1, 0, 0]}], (-1,)),
        ("document.points", [{"face": 0, "barycentric": [1, 1, -1]}], ()),
        ("document.landmarks", [{"target": {"face": F, "barycentric": [1, 0, 0]}}], (80,)),
        ("document.landmarks", [{"weight": 0}], ("weight", "0.0", 0)),
        ("document.landmark", 1, ("landmark", 1, 0)),
        ("document.surfaces.0.front", INVALID_FRONT, ("front",)),
        ("document.labels.keys", [2, 1], ("keys",)),
        ("document.labels.keys", [1, 3], ("labels", "keys")),
        ("document.labels.names", ["one"], ()),
        ("document.labels.colors", [[0, 0, 0], [0, 0, 2]], (0, 1)),
        ("document.unheard", 1, ("unheard",)),
        ("view.layout", "pile", ("row", "column")),
        ("view.theme", "dark", ("theme",)),
        ("view.colormap", "jet", ("colormap", "jet")),
        ("view.arrow_length", 0, ("arrow_length", 0)),
        ("view.viewpoint", {"front": INVALID_FRONT}, ("front",)),
        ("view.viewpoint", INVALID_VIEWPOINT, ("zoom", "0.0")),
    ],
)
def test_values_outside_their_range_are_named(saved, name, value, named):
    place = [int(part) if part.isdigit() else part for part in name.split(".")]
    changed(saved, lambda header, view: put(header | {"view": view}, place, value))
    if len(place) == 1:
        changed(saved, lambda header, view: header.update({name: value}))
    check_message(error_line(saved), *named)


@pytest.mark.parametrize(
    "text",
    [
        *("", "[1]", "{", "[" * 100_000, '{"a":' * 100_000, "1" * 100_000, "\xff"),
        *("NaN", "-Infinity", '"' + "x" * 100_000, '"\\ud800"'),
    ],
)
def test_other_json_is_refused(saved, text):
    for name in ("project.json", "view.json"):
        content = saved.read_bytes()
        rewrite(saved, {name: text.encode("latin-1")})
        check_message(error_line(saved))
        assert not re.search("codec|set_int_max", error_line(saved))
        saved.write_bytes(content)


def test_compressed_and_large_members_are_refused(saved):
    many = replace(DOCUMENT, points=(Point(0, (1.0, 0.0, 0.0)),) * 30_000)
    with raises(ResultError):
        save_project(saved, many, KNOWN)
    content = saved.read_bytes()
    rewrite(saved, {}, zipfile.ZIP_DEFLATED)
    check_message(error_line(saved))
    saved.write_bytes(content)
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
        ("text.abfm", "damaged"),
        ("none.abfm", "No such file"),
        ("", "directory"),
        ("pipe.abfm", "a pipe"),
        ("zero.abfm", "a device"),
        ("a.abfm", "damaged"),
    ):
        assert words in error_line(tmp_path / name)
        assert load_origin(tmp_path / name) is None


@pytest.mark.parametrize(
    ("change", "known", "named"),
    [
        ({"time": float("nan")}, {}, ("document.time", "nan")),
        ({"channel": 5}, {}, ("channel", 5)),
        ({"view": View(layout="pile")}, {}, ("layout",)),
        ({"surfaces": (Surface(torus(8, 8), "torus"),)}, {}, ("surface",)),
        ({}, {"file:x.npy": X[1:]}, ("file:x.npy",)),
        ({}, {"file:x.npy": np.full(V, np.inf)}, ()),
    ],
)
def test_invalid_documents_are_not_saved(saved, change, known, named):
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
def test_terms_of_files_are_found(spec, terms):
    assert project.terms_from_files(spec) == terms


def test_opening_without_a_result_loads_no_solver(tmp_path):
    save_project(tmp_path / "p.abfm", MatchDocument((Surface(BALL, "empty"),)), {})
    code = (
        "import sys; from abfm_viewer.files.project import load_project; "
        "load_project(sys.argv[1]);"
        "print(sorted({'numba', 'scipy', 'igl', 'cholespy', 'polyscope'} & set(sys.modules)))"
    )
    assert python(code, tmp_path / "p.abfm", check=True).stdout == "[]\n"


# Origins of files: whether these still exist and are unchanged


@pytest.fixture
def origin(tmp_path):
    """Return the origin of a file with an unusual name."""
    path = tmp_path / "a prøject.abfm"
    path.write_text("one")
    return Origin.of(path)


def test_origin_notices_changes_of_its_file(origin):
    assert (origin.exists, origin.changed) == (True, False)
    state = origin.path.stat()
    origin.path.write_text("two")
    os.utime(origin.path, ns=(state.st_atime_ns, state.st_mtime_ns + 1))
    assert origin.changed
    os.utime(origin.path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert not origin.changed
    origin.path.write_text("three")
    os.utime(origin.path, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert origin.changed  # the size differs
    origin.path.unlink()
    assert (origin.exists, origin.changed) == (False, False)


def test_copy_names_its_original_file(origin, tmp_path):
    copy = tmp_path / "copy.abfm"
    save_project(copy, MatchDocument((Surface(BALL, "sphere"),)), {}, origin)
    assert load_origin(copy) == origin
    origin.path.unlink()
    assert load_origin(copy) is None
    save_project(copy, MatchDocument((Surface(BALL, "sphere"),)), {})
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
def test_damaged_origins_of_copies_are_ignored(tmp_path, text):
    path = tmp_path / "p.abfm"
    document = MatchDocument((Surface(BALL, "sphere"),))
    save_project(path, document, {}, Origin.of(tmp_path / "q.abfm"))
    rewrite(path, {project.MEMBER: text.encode()})
    assert load_origin(path) is None
    assert load_project(path)[0].name == "sphere"
