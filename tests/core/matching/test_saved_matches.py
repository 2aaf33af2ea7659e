"""Matches on disk: what is known of one comes back."""

import json
import pickle
from dataclasses import asdict, replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal, assert_equal

import abfm
from abfm.errors import ResultError
from abfm.matching import Remedy
from abfm.parameters import PAPER, Parameters
from tests.core.fields import bump
from tests.shapes import icosphere

MESH = icosphere(2)


@pytest.fixture(scope="module")
def match():
    f, g = bump(MESH, [0, 0, 1], 0.2), bump(MESH, [0, 0.8, 0.6], 0.2)
    return abfm.match(MESH, f, g, Parameters(iterations=8, levels=2, segments=2))


@pytest.fixture
def path(match, tmp_path):
    match.save(tmp_path / "match.npz")
    return tmp_path / "match.npz"


def rewritten(path, **changes):
    """The file with some entries changed, or left out where None."""
    with np.load(path) as archive:
        entries = {**archive, **changes}
    np.savez(path, **{name: value for name, value in entries.items() if value is not None})
    return path


def test_everything_comes_back(match, path):
    loaded = abfm.load_match(path)
    assert np.isfinite([match.verified_mismatch, match.folded]).all()
    values = "mismatch verified_mismatch folded stop_reason verdict parameters channels_given"
    for name in values.split():
        assert getattr(loaded, name) == getattr(match, name)
    for name in ("source", "target", "advected", "velocity", "energy_history", "stages", "weights"):
        assert_array_equal(getattr(loaded, name), getattr(match, name))
    assert_equal(asdict(loaded.verify(subdivided=False)), asdict(match.verify(subdivided=False)))
    before = path.read_bytes()
    loaded.save(path)
    assert path.read_bytes() == before


def test_a_match_goes_to_another_process_without_what_was_computed_from_it(match):
    abfm.matching.prepare(match.mesh, abfm.Parameters(levels=2))  # keeps a coarser mesh and a lock
    there = match.advect([-0.5, 0.5, 1.0])
    sent = pickle.dumps(match)
    assert len(sent) < 200_000  # the memory that flows work in alone is larger
    came = pickle.loads(sent)
    assert_array_equal(came.advect([-0.5, 0.5, 1.0]), there)
    assert not came.mesh.vertices.flags.writeable


def test_what_is_not_known_stays_unknown(tmp_path):
    control = abfm.Control()
    control.cancel(briefly=True)
    f = bump(MESH, [0, 0, 1], 0.2)
    match = abfm.match(MESH, f, f[::-1].copy(), control=control)
    match.save(tmp_path / "match.npz")
    loaded = abfm.load_match(tmp_path / "match.npz")
    for one in (match, loaded):
        assert np.isnan([one.verified_mismatch, one.folded]).all()
    assert loaded.stop_reason == "cancelled"


@pytest.mark.parametrize(("mismatch", "kind"), [(0.03, "matched"), (0.4, "not reached")])
def test_a_file_without_the_new_entries_is_one_of_the_papers_energy(match, path, mismatch, kind):
    given = match.parameters.to_dict()
    former = json.dumps({name: given[name] for name in given if name not in PAPER})
    new = dict.fromkeys(("verdict", "verified_mismatch", "folded"))
    known = {"parameters": former, "mismatch": mismatch, "stop_reason": "converged"}
    loaded = abfm.load_match(rewritten(path, **known, **new))
    assert loaded.parameters == Parameters(**given | PAPER)
    assert loaded.verdict == abfm.matching.Verdict(kind, "converged", "")
    assert np.isnan([loaded.verified_mismatch, loaded.folded]).all()
    assert_array_equal(loaded.velocity, match.velocity)
    again = abfm.match(MESH, loaded.source, loaded.target, loaded.parameters, start=loaded.velocity)
    assert again.energy_history[-1, 0] <= again.energy_history[0, 0]


def test_remedies_come_back_and_files_without_them_have_none(match, path):
    closer = Remedy("Match closer", "smaller", {"sigma": 0.5, "order": 1})
    remedies = Remedy("Continue", "go on", {}, True), closer
    judged = replace(match, verdict=replace(match.verdict, remedies=remedies))
    judged.save(path)
    assert abfm.load_match(path).verdict == judged.verdict
    former = abfm.load_match(rewritten(path, remedies=None))
    assert former.verdict == replace(match.verdict, remedies=())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[{}]", "'\\[{}\\]'; expected .* JSON of what has label, words, parameters, goes_on"),
        ("{", "the remedies are '{'; expected a list in JSON"),
        ("3", "the remedies are '3'; expected a list in JSON"),
        ('[{"label": "", "words": "", "parameters": {"sigmma": 1}}]', "unknown parameter 'sigmma'"),
    ],
)
def test_damaged_remedies_are_refused_in_words(path, text, words):
    with pytest.raises(ResultError, match=words):
        abfm.load_match(rewritten(path, remedies=np.array(text)))


def test_an_entry_whose_name_is_no_text_is_told_in_words(path):
    content = bytearray(path.read_bytes())
    content[7] |= 8  # the name of the first entry is UTF-8
    content[30] = 0xFF  # its first letter
    path.write_bytes(content)
    with pytest.raises(ResultError, match="byte 0, counting from 0, is no text in UTF-8"):
        abfm.load_match(path)


def test_a_verdict_of_another_kind_is_refused_in_words(path):
    strange = rewritten(path, verdict=np.array(["perhaps", "why", "what"]))
    with pytest.raises(ResultError, match="is 'perhaps'; expected one of matched, nearly"):
        abfm.load_match(strange)
