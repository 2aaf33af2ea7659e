from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import abfm
from abfm import Parameters
from abfm.registration import MEASURED_PARAMETERS
from abfm_viewer.computing.background import Jobs
from abfm_viewer.document.document import Channel, Landmark, Point, Surface
from abfm_viewer.document.kinds import PairDocument
from abfm_viewer.files.project import load_project, save_project
from abfm_viewer.session.functions import known_values
from abfm_viewer.session.initial_maps import InitialMaps
from abfm_viewer.session.session import Session
from tests.messages import check_message
from tests.shapes import ellipsoid, icosphere
from tests.spare_processes import reused_processes
from tests.viewer.sessions import QUICK, matched, ready, until

A, B = ellipsoid(2, 1.0, 0.7, 0.55), icosphere(2, 10.0)
SURFACES = Surface(A, "a.off"), Surface(B, "b.off")
GAUSSIAN = "gaussian:x=0.5,y=0.4,z=0.3,width=0.3"
SHORT_RUN = Parameters.of(iterations=5, refine=0, cooling_stages=1)


@pytest.fixture(scope="module", autouse=True)
def _reused_processes():
    with reused_processes():
        yield


@pytest.fixture
def pair():
    session = Session(A, "a.off")
    session.set_surfaces(*SURFACES)
    session.editor.amend(channels=(Channel(GAUSSIAN, GAUSSIAN),), parameters=SHORT_RUN)
    yield ready(session)
    session.close()


def test_result_belongs_to_its_initial_map(pair):
    matched(pair)
    assert pair.document.initial_map.correspondence is pair.work.prepared.initial.correspondence
    assert_array_equal(pair.result.mesh.vertices, B.vertices)
    assert not pair.outdated
    pair.editor.change("change the initial map", initial="closest")
    until(lambda: pair.outdated, pair)
    pair.undo()
    until(lambda: not pair.outdated, pair)
    assert pair.document.complete_result.points.domain is B
    pair.editor.change("change the initial map", initial="sphere")  # an egg is not a sphere
    until(lambda: "not a sphere" in pair.obstacle, pair)
    pair.match()
    assert pair.notices.latest.is_error


def test_measured_functions_are_matched_in_standard_deviations(pair):
    pair.editor.amend(parameters=Parameters())
    rough = "sin(40*x)*sin(50*y)*sin(60*z)"
    pair.editor.set_spec("target", f"expression:100+7*{rough}")
    pair.editor.set_spec("source", f"expression:{rough}")
    until(lambda: not pair.obstacle, pair)
    until(lambda: pair.work.prepared.suggested_parameters == MEASURED_PARAMETERS, pair)
    until(lambda: pair.work.flow_values("target") is not None, pair)
    areas = abfm.calculus.vertex_areas(B)
    target = pair.work.flow_values("target")
    deviation = target - np.average(target, weights=areas)
    assert np.average(deviation**2, weights=areas) == pytest.approx(1)
    pair.match()
    assert pair.parameters == MEASURED_PARAMETERS
    check_message(pair.notices.latest.text)  # the message lists the parameters that were set
    pair.solver.cancel()
    until(lambda: not pair.solver.running, pair)


def test_equal_specs_on_both_surfaces_have_separate_values(pair, tmp_path):
    files = Channel("file:there.npy", "file:there.npy")
    rng = np.random.default_rng(0)
    on_a, on_b = rng.normal(size=len(A.vertices)), rng.normal(size=len(B.vertices))
    document = PairDocument(SURFACES, (files,), parameters=SHORT_RUN)
    pair.restore(document, {"A: file:there.npy": on_a, "file:there.npy": on_b}, None)
    ready(pair)
    assert_array_equal(pair.values("source"), on_a)
    assert_array_equal(pair.values("target"), on_b)
    known = known_values(pair.document, pair.functions.of_document(pair.document))
    save_project(tmp_path / "p.abfm", pair.document, known)
    opened, again = load_project(tmp_path / "p.abfm")
    assert again.keys() == known.keys()
    for name, values in known.items():
        assert_array_equal(again[name], values)
    assert [one.name for one in opened.surfaces] == ["a.off", "b.off"]


SOURCE_SPEC, TARGET_SPEC = "gaussian:x=1,y=0,z=0,width=0.3", "gaussian:x=0.8,y=0.4,z=0,width=0.3"


@pytest.fixture
def registered(pair):
    """Return a session after a match that started with the same connectivity."""
    channels = (Channel(SOURCE_SPEC, TARGET_SPEC),)
    pair.editor.amend(parameters=QUICK, channels=channels, initial="connectivity")
    return matched(ready(pair))


def test_distortion_of_the_initial_map_is_only_reported(registered):
    before = registered.result
    registered.bound.maximum = 0.05
    registered.bound.start()
    until(lambda: not registered.bound.busy, registered)
    assert registered.result is before
    check_message(registered.notices.log[-1].text, "0.05")


def test_registrations_have_functions_of_a(registered):
    functions = registered.document.complete_result.functions
    assert_allclose(functions[:, 0], registered.values("source"))


def test_run_with_an_earlier_map_belongs_to_its_landmarks(pair, held):
    pair.editor.change("change the initial map", initial="connectivity")
    ready(pair)
    _, may_end = held(abfm.registration, "prepare")
    pair.editor.place_landmark("source", Point(0, (1.0, 0.0, 0.0)))
    pair.editor.place_landmark("target", Point(9, (1.0, 0.0, 0.0)))
    pair.update()
    spec = pair.work.problem
    assert len(spec.landmarks) == 1
    assert spec.initial.request.landmarks == ()  # the result of the run is outdated
    assert not spec.initial.is_for(pair.document)
    may_end.set()
    ready(pair)
    assert pair.work.problem.initial.is_for(pair.document)


def test_initial_map_waits_until_placing_stops():
    """While landmarks are placed, the map of the earlier landmarks is used."""
    maps, pair = InitialMaps(Jobs(), None, None), Landmark(Point(0, (1, 0, 0)), Point(0, (1, 0, 0)))

    def choose(pairs, tool="landmark", initial=""):
        view = SimpleNamespace(tool=tool)
        document = SimpleNamespace(identity=maps, initial=initial, pairs=pairs, view=view)
        maps._choose_landmarks(document)
        return maps.waits_for_placing(document)

    assert not choose((), "nothing")
    assert choose((pair,))
    assert not choose((pair,), initial="landmarks")  # it cannot be found by fewer landmarks
    assert choose(2 * (pair,))
    assert not choose(2 * (pair,), "nothing")


def test_match_stops_placing_and_finds_the_map_first(pair, held):
    pair.editor.switch_placing()
    pair.update()
    for side in ("source", "target"):
        pair.editor.place_landmark(side, Point(0, (1.0, 0.0, 0.0)))
    ready(pair)
    assert pair.initial_maps.waits_for_placing(pair.document)
    _, may_end = held(abfm.registration, "prepare")
    pair.match()
    pair.update()
    assert pair.view.tool == "nothing"
    assert not pair.solver.running
    may_end.set()
    until(lambda: pair.result is not None and not pair.solver.running, pair)
    assert pair.document.initial_map.request.landmarks == pair.document.pairs
    assert not pair.outdated
