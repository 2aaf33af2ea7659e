"""Project files: what goes in comes out, and damage is named."""

from __future__ import annotations

import json
import random
import zipfile
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm import Parameters, TriangleMesh, match
from abfm_viewer.document import COLORINGS, LAYOUTS, Camera, Channel, Document, Front, Point, Run, View
from abfm_viewer.plain import PlainError, from_plain, to_plain
from abfm_viewer.project import ProjectError, load_project, save_project, terms_from_files
from tests.shapes import icosphere

SPHERE = icosphere(2)
VALUES = SPHERE.vertices[:, 0].copy()


@pytest.fixture(scope="module")
def document() -> Document:
    result = match(SPHERE, VALUES, SPHERE.vertices[:, 1], Parameters(iterations=5))
    return Document(
        mesh=SPHERE,
        name="a sphere",
        channels=(Channel("file:x.npy", "coordinate:y"), Channel("gaussian:vertex=3", "eigenfunction:2", 0.5)),
        channel=1,
        side="target",
        bump=1,
        parameters=Parameters(alpha=0.3, iterations=7),
        mask="indicator:axis=x,above=0.0",
        result=result,
        runs=(Run(result.energy_history, result.stages, (2,), 0.25, "alpha 1"),),
        time=0.75,
        lines=(Point(3, (0.25, 0.25, 0.5)),),
        points=(Point(0, (1.0, 0.0, 0.0)),),
        view=View(camera=Camera((1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 20.0), isolines=True),
    )


@pytest.fixture
def saved(document: Document, tmp_path: Path) -> Path:
    path = tmp_path / "my project.abfm"
    save_project(path, document, {"file:x.npy": VALUES})
    return path


def test_everything_comes_back(document: Document, saved: Path) -> None:
    opened, known = load_project(saved)
    for entry in fields(Document):
        if entry.name not in ("mesh", "result", "runs"):
            assert getattr(opened, entry.name) == getattr(document, entry.name), entry.name
    for name in ("vertices", "faces", "vertex_ids"):
        np.testing.assert_array_equal(getattr(opened.mesh, name), getattr(SPHERE, name))
    np.testing.assert_array_equal(known["file:x.npy"], VALUES)
    assert opened.result is not None
    assert document.result is not None
    assert opened.result.mesh is opened.mesh
    np.testing.assert_array_equal(opened.result.advect(0.5), document.result.advect(0.5))
    [run], [before] = opened.runs, document.runs
    np.testing.assert_array_equal(run.energies, before.energies)
    assert (run.restarts, run.mismatch, run.label) == (before.restarts, before.mismatch, before.label)


def test_what_was_opened_saves_to_the_same_bytes(saved: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.abfm"
    save_project(again, *load_project(saved))
    assert again.read_bytes() == saved.read_bytes()


def test_vertices_keep_the_numbers_of_the_mesh_file(tmp_path: Path) -> None:
    sparse = TriangleMesh(np.insert(SPHERE.vertices, 5, 9.0, axis=0), SPHERE.faces + (SPHERE.faces >= 5))
    save_project(tmp_path / "p.abfm", Document(sparse, "with a loose vertex"), {})
    mesh = load_project(tmp_path / "p.abfm")[0].mesh
    assert mesh.file_vertex_count == sparse.file_vertex_count == 163
    np.testing.assert_array_equal(mesh.vertex_ids, sparse.vertex_ids)


def test_terms_that_read_files() -> None:
    spec = "file:a.npy + gaussian:vertex=1 + permuted:b.txt(eigenfunction:3)"
    assert terms_from_files(spec) == ["file:a.npy", "permuted:b.txt(eigenfunction:3)"]


def test_damaged_files_are_refused_or_read_right(document: Document, saved: Path) -> None:
    """Whatever bit flips or wherever the file ends: one line that names it, or the same document."""
    whole, choose = saved.read_bytes(), random.Random(0)
    refusals = []
    for attempt in range(150):
        if attempt % 2:
            damaged = bytearray(whole)
            damaged[choose.randrange(len(whole))] ^= 1 << choose.randrange(8)
        else:
            damaged = bytearray(whole[: choose.randrange(len(whole))])
        saved.write_bytes(damaged)
        try:
            opened, _ = load_project(saved)
        except ProjectError as error:
            refusals.append(str(error))
        else:
            assert opened.channels == document.channels
            np.testing.assert_array_equal(opened.mesh.vertices, SPHERE.vertices)
    assert len(refusals) > 140
    assert all(str(saved) in refusal and "\n" not in refusal for refusal in refusals)


def rewritten(path: Path, change: dict[str, object]) -> None:
    """Replace entries of `project.json`."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["project.json"] = json.dumps(json.loads(members["project.json"]) | change).encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"format_version": 99}, "upgrade abfm"),
        ({"format_version": "one"}, "format_version"),
        ({"view": {"theme": "pink"}}, "theme"),
        ({"view": {"no such": 1}}, "no such"),
        ({"channel": 7}, "channel 7"),
        ({"time": 3.0}, "time 3"),
        ({"time": float("nan")}, "finite"),
        ({"lines": [{"face": 100_000, "barycentric": [1, 0, 0]}]}, "face"),
        ({"parameters": {"alpha": -1}}, "alpha"),
        ({"file_vertex_count": 10**12}, "numbers"),
        ({"file_vertex_count": 12}, "numbers"),
        ({"channels": [{"source": 3, "target": "x"}]}, "source"),
        ({"channels": "many"}, "list"),
        ({"runs": [{"restarts": [], "mismatch": 0, "label": "a"}] * 2}, "damaged"),
    ],
)
def test_entries_that_make_no_sense_are_named(saved: Path, change: dict[str, object], reason: str) -> None:
    rewritten(saved, change)
    with pytest.raises(ProjectError, match=reason):
        load_project(saved)


def test_files_of_another_kind_are_named(document: Document, tmp_path: Path) -> None:
    assert document.result is not None
    document.result.save(tmp_path / "r.npz")
    (tmp_path / "text.abfm").write_text("not a zip")
    for name, reason in (("r.npz", "result"), ("text.abfm", "no project"), ("none.abfm", "No such file")):
        with pytest.raises(ProjectError, match=reason):
            load_project(tmp_path / name)


def test_a_failed_save_leaves_the_old_file(document: Document, saved: Path) -> None:
    before = saved.read_bytes()
    broken = replace(document, time=float("nan"))
    with pytest.raises(ValueError, match="JSON"):
        save_project(saved, broken, {})
    assert saved.read_bytes() == before
    assert list(saved.parent.iterdir()) == [saved]


numbers = st.floats(allow_nan=False, allow_infinity=False)
vectors = st.tuples(numbers, numbers, numbers)
views = st.builds(
    View,
    layout=st.sampled_from(LAYOUTS),
    coloring=st.sampled_from(COLORINGS),
    isolines=st.booleans(),
    isoline_count=st.integers(1, 100),
    arrow_length=numbers,
    front=st.none() | st.builds(Front, vectors, vectors),
    camera=st.none() | st.builds(Camera, vectors, vectors, vectors, numbers),
)


@given(views)
def test_views_survive_json(view: View) -> None:
    assert from_plain(View, json.loads(json.dumps(to_plain(view))), "view") == view


@given(st.lists(st.builds(Channel, st.text(), st.text(), numbers)).map(tuple))
def test_channels_survive_json(channels: tuple[Channel, ...]) -> None:
    plain = json.loads(json.dumps(to_plain(channels)))
    assert from_plain(tuple[Channel, ...], plain, "channels") == channels


def test_missing_fields_take_their_defaults_and_needed_ones_are_named() -> None:
    assert from_plain(View, {}, "view") == View()
    with pytest.raises(PlainError, match="also target"):
        from_plain(Channel, {"source": "a"}, "channel")
    with pytest.raises(PlainError, match="finite"):
        from_plain(Channel, {"source": "a", "target": "b", "weight": True}, "channel")
