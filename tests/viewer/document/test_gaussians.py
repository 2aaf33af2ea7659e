"""Editing the Gaussians of a spec: what was not asked for stays as it was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from abfm import FunctionError, TriangleMesh
from abfm.functions import Sum, parse
from abfm.functions.expression import Expression
from abfm.functions.files import Permuted
from abfm.functions.places import Coordinate, Gaussian
from abfm.functions.spectral import Eigenfunction
from abfm_viewer.document import gaussians as bumps
from tests.shapes import icosphere

SPHERE = icosphere(1)
VERTICES = st.integers(0, len(SPHERE.vertices) - 1)
NUMBERS = st.floats(-10, 10)
GAUSSIANS = st.one_of(
    st.builds(
        Gaussian,
        vertex=st.tuples(VERTICES) | st.tuples(VERTICES, VERTICES),
        width=st.floats(0.001, 10),
        height=NUMBERS,
        metric=st.sampled_from(["geodesic", "euclidean"]),
    ),
    st.builds(Gaussian, x=NUMBERS, y=NUMBERS, z=NUMBERS),
)
OTHERS = st.one_of(
    st.builds(Coordinate, axis=st.sampled_from("xyz")),
    st.builds(Eigenfunction, index=st.integers(0, 9)),
    st.just(Expression(formula="(x+y)*z")),
)


@st.composite
def terms_and_bump(draw):
    """Terms among which there are Gaussians, whether they are inside a vertex map, and which
    Gaussian is meant.
    """
    terms = [
        *draw(st.lists(GAUSSIANS | OTHERS, max_size=4)),
        draw(GAUSSIANS),
        *draw(st.lists(OTHERS, max_size=2)),
    ]
    count = sum(isinstance(term, Gaussian) for term in terms)
    return terms, draw(st.booleans()), draw(st.integers(0, count - 1))


def text(terms, mapped):
    inner = Sum(tuple(terms)) if len(terms) > 1 else terms[0]
    return str(Permuted(path="a map (1).txt", function=inner) if mapped else inner)


def place(terms, bump):
    """Where among all terms a Gaussian is."""
    return [number for number, term in enumerate(terms) if isinstance(term, Gaussian)][bump]


@given(terms_and_bump(), st.floats(0.001, 10), NUMBERS)
def test_another_width_and_height_change_nothing_else(case, width, height):
    terms, mapped, bump = case
    spec = text(terms, mapped)
    assert bumps.gaussians(spec) == [term for term in terms if isinstance(term, Gaussian)]
    assert bumps.is_mapped(spec) == mapped
    changed = bumps.changed(spec, bump, width=width, height=height)
    at = place(terms, bump)
    wanted = [*terms[:at], replace(terms[at], width=width, height=height), *terms[at + 1 :]]
    assert parse(changed) == parse(text(wanted, mapped))
    back = bumps.changed(changed, bump, width=terms[at].width, height=terms[at].height)
    assert parse(back) == parse(spec)


@given(terms_and_bump(), VERTICES)
def test_a_vertex_takes_the_place_of_a_point(case, vertex):
    terms, mapped, bump = case
    moved = bumps.gaussians(bumps.changed(text(terms, mapped), bump, vertex=(vertex,)))[bump]
    before = terms[place(terms, bump)]
    assert moved == replace(before, vertex=(vertex,), x=None, y=None, z=None)
    assert bumps.centre(moved, SPHERE) == vertex


@given(terms_and_bump())
def test_what_was_added_can_be_removed(case):
    terms, mapped, _ = case
    spec = text(terms, mapped)
    more = bumps.added(spec, SPHERE)
    known = bumps.gaussians(more)
    assert known[:-1] == bumps.gaussians(spec)
    assert known[-1].width == known[-2].width
    assert parse(bumps.removed(more, len(known) - 1)) == parse(spec)


@given(terms_and_bump())
def test_the_other_terms_stay_when_one_is_removed(case):
    terms, mapped, bump = case
    spec = text(terms, mapped)
    at = place(terms, bump)
    kept = [*terms[:at], *terms[at + 1 :]]
    assert parse(bumps.removed(spec, bump)) == parse(text(kept or terms, mapped))


def test_a_new_bump_is_far_from_the_others():
    spec = "gaussian:x=0,y=0,z=1,width=0.3"
    first = bumps.gaussians(bumps.added(spec, SPHERE))[1]
    np.testing.assert_allclose(SPHERE.vertices[first.vertex[0]], [0, 0, -1], atol=0.3)
    assert bumps.gaussians(bumps.added("coordinate:x", SPHERE))[0].width == 0.1


def test_vertices_count_as_the_file_does():
    lonely = np.array([[9.0, 9, 9]])
    mesh = TriangleMesh(np.concatenate([lonely, SPHERE.vertices]), SPHERE.faces + 1)
    assert len(mesh.vertices) == len(SPHERE.vertices)
    here, there = bumps.gaussians(bumps.added("gaussian:vertex=5", mesh))
    assert bumps.centre(here, mesh) == 5
    assert there.vertex == (
        bumps.gaussians(bumps.added("gaussian:vertex=4", SPHERE))[1].vertex[0] + 1,
    )
    with pytest.raises(FunctionError, match="vertex 0 was dropped"):
        bumps.centre(parse("gaussian:vertex=0"), mesh)


def test_what_is_refused():
    with pytest.raises(FunctionError, match=r"width must be a number above 0 .*, not '-1\.0'"):
        bumps.changed("gaussian:vertex=1 + gaussian:vertex=2", 1, width=-1.0)
    with pytest.raises(FunctionError, match="there is no vertex 4242"):
        bumps.added("gaussian:vertex=4242", SPHERE)
    with pytest.raises(FunctionError, match="unknown function family"):
        bumps.gaussians("gausian:vertex=1")


def test_a_landmark_is_far_from_all_others_as_wide_as_the_last_and_at_a_vertex_of_the_file():
    specs = [
        "gaussian:x=0,y=0,z=1,width=0.3",
        "coordinate:x + gaussian:x=0,y=1,z=0,width=0.2",
        "eigenfunction:3",
    ]
    found = parse(bumps.landmark(specs, SPHERE))
    assert found.width == 0.2
    centre = SPHERE.vertices[found.sources(SPHERE)[0]]
    least = np.min(np.linalg.norm(centre - [[0, 0, 1], [0, 1, 0]], axis=1))
    for other in SPHERE.vertices:
        # ends of edges
        assert np.min(np.linalg.norm(other - [[0, 0, 1], [0, 1, 0]], axis=1)) <= least + 0.1
    gap = TriangleMesh(np.vstack([np.zeros((5, 3)), SPHERE.vertices]), SPHERE.faces + 5)
    assert parse(bumps.landmark(["gaussian:x=0,y=0,z=1"], gap)).vertex[0] == 5 + int(
        np.argmin(SPHERE.vertices[:, 2])
    )


def test_a_landmark_needs_no_other_gaussian_and_minds_none_that_is_not_on_the_mesh():
    none = bumps.landmark(["coordinate:x"], SPHERE)
    assert bumps.landmark(["gaussian:vertex=99999"], SPHERE) == none
    assert bumps.landmark([], SPHERE) == none
