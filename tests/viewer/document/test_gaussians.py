"""Editing of the Gaussians in a spec, which changes nothing else."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from abfm import FunctionError, TriangleMesh
from abfm.functions import Gaussian, Permuted, Scaled, Sum, parse
from abfm.functions.expression import Expression
from abfm.functions.places import Coordinate
from abfm.functions.spectral import Eigenfunction
from abfm_viewer.document import gaussians as bumps
from tests.messages import raises
from tests.shapes import icosphere

SPHERE = icosphere(1)
GAP = TriangleMesh(np.vstack([np.zeros((5, 3)), SPHERE.vertices]), SPHERE.faces + 5)
VERTICES = st.integers(0, len(SPHERE.vertices) - 1)
NUMBERS, WIDTHS = st.floats(-10, 10), st.floats(0.001, 10)
GAUSSIANS = st.one_of(
    st.builds(
        Gaussian,
        vertex=st.tuples(VERTICES) | st.tuples(VERTICES, VERTICES),
        width=WIDTHS,
        height=NUMBERS,
        metric=st.sampled_from(["geodesic", "euclidean"]),
    ),
    st.builds(Gaussian, x=NUMBERS, y=NUMBERS, z=NUMBERS),
)
OTHER_TERMS = st.one_of(
    st.builds(Coordinate, axis=st.sampled_from("xyz")),
    st.builds(Eigenfunction, index=st.integers(0, 9)),
    st.just(Expression(formula="(x+y)*z")),
)


def text(terms, mapped):
    """Return the spec of a sum; with ``mapped`` it is scaled and composed with a map."""
    inner = Sum(tuple(terms)) if len(terms) > 1 else terms[0]
    if not mapped:
        return str(inner)
    mapped = Permuted(path="a map (1).txt", function=inner)
    return str(Scaled(factor=2.0, function=mapped))


@given(
    st.lists(GAUSSIANS | OTHER_TERMS, max_size=4),
    GAUSSIANS,
    st.lists(OTHER_TERMS, max_size=2),
    st.booleans(),
    st.data(),
    st.tuples(WIDTHS, NUMBERS, VERTICES),
)
def test_edits_change_one_gaussian_only(before, one, after, mapped, data, values):
    terms, (width, height, vertex) = [*before, one, *after], values
    places = [number for number, term in enumerate(terms) if isinstance(term, Gaussian)]
    bump = data.draw(st.integers(0, len(places) - 1))
    spec, at = text(terms, mapped), places[bump]
    assert bumps.gaussians(spec) == [terms[place] for place in places]
    assert bumps.is_mapped(spec) == mapped

    changed = bumps.changed(spec, bump, width=width, height=height)
    wanted = [*terms[:at], replace(terms[at], width=width, height=height), *terms[at + 1 :]]
    assert parse(changed) == parse(text(wanted, mapped))
    back = bumps.changed(changed, bump, width=terms[at].width, height=terms[at].height)
    assert parse(back) == parse(spec)

    moved = bumps.gaussians(bumps.changed(spec, bump, vertex=(vertex,)))[bump]
    assert moved == replace(terms[at], vertex=(vertex,), x=None, y=None, z=None)
    assert bumps.centre(moved, SPHERE) == vertex

    more = bumps.added(spec, SPHERE)
    known = bumps.gaussians(more)
    assert known[:-1] == bumps.gaussians(spec)
    assert known[-1].width == known[-2].width
    assert parse(bumps.removed(more, len(known) - 1)) == parse(spec)
    others = [*terms[:at], *terms[at + 1 :]]
    assert parse(bumps.removed(spec, bump)) == parse(text(others or terms, mapped))


def test_new_gaussian_is_far_from_the_others():
    spec = "gaussian:x=0,y=0,z=1,width=0.3"
    first = bumps.gaussians(bumps.added(spec, SPHERE))[1]
    np.testing.assert_allclose(SPHERE.vertices[first.vertex[0]], [0, 0, -1], atol=0.3)
    assert bumps.gaussians(bumps.added("coordinate:x", SPHERE))[0].width == 0.1


def test_vertices_are_numbered_as_in_the_file():
    here, there = bumps.gaussians(bumps.added("gaussian:vertex=9", GAP))
    assert bumps.centre(here, GAP) == 9
    [_, expected] = bumps.gaussians(bumps.added("gaussian:vertex=4", SPHERE))
    assert there.vertex == (expected.vertex[0] + 5,)
    with raises(FunctionError, 0):
        bumps.centre(parse("gaussian:vertex=0"), GAP)
    lowest = 5 + int(np.argmin(SPHERE.vertices[:, 2]))
    assert parse(bumps.landmark(["gaussian:x=0,y=0,z=1"], GAP)).vertex == (lowest,)


def test_invalid_values_and_specs_are_refused():
    with raises(FunctionError, "width", "-1.0", 0):
        bumps.changed("gaussian:vertex=1 + gaussian:vertex=2", 1, width=-1.0)
    with raises(FunctionError, 4242):
        bumps.added("gaussian:vertex=4242", SPHERE)
    with raises(FunctionError):
        bumps.gaussians("gausian:vertex=1")


def test_fixed_gaussian_is_far_from_all_others():
    """A new fixed Gaussian is as far as possible from all others, with the last one's width."""
    others = ["gaussian:x=0,y=0,z=1,width=0.3", "coordinate:x + gaussian:x=0,y=1,z=0,width=0.2"]
    found = parse(bumps.landmark([*others, "eigenfunction:3"], SPHERE))
    assert found.width == 0.2
    away = np.linalg.norm(SPHERE.vertices[:, None] - [[0, 0, 1], [0, 1, 0]], axis=2).min(axis=1)
    assert away.max() <= away[found.sources(SPHERE)[0]] + 0.1  # within one edge length
    none = bumps.landmark(["coordinate:x"], SPHERE)  # works without others, or one outside the mesh
    assert bumps.landmark(["gaussian:vertex=99999"], SPHERE) == bumps.landmark([], SPHERE) == none
