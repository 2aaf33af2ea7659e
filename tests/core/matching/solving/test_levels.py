"""The meshes that a match begins on: made once, ahead if somebody asks."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from abfm import MatchingEnergy, Parameters
from abfm.calculus.vector_fields import to_ambient
from abfm.matching.solving import levels as module
from abfm.matching.solving.levels import Level, _making, levels, on_the_mesh, prepare
from abfm.mesh import coarsening
from abfm.workers.control import CancelledError, Control, controlled
from tests.core.fields import bump, rotation_field
from tests.core.surfaces import relative_error, renumbered
from tests.shapes import icosphere, torus

COARSER = Parameters(levels=3)


def energy(mesh):
    f = mesh.vertices[:, 0]
    return MatchingEnergy(mesh, f, f[::-1].copy(), COARSER)


def all_levels(finest: MatchingEnergy) -> list[Level]:
    return levels(on_the_mesh(finest))


def made(mesh):
    return [level.energy.mesh for level in all_levels(energy(mesh))]


def test_what_was_prepared_is_what_a_match_uses(monkeypatch):
    mesh = torus(40, 20)
    prepare(mesh, COARSER)

    def never(*_):
        raise AssertionError("made again")

    monkeypatch.setattr(coarsening, "_collapse_edges", never)
    found = all_levels(energy(mesh))
    assert [len(level.energy.mesh.vertices) for level in found] == [50, 200, 800]
    for level in found[:-1]:
        assert {"interpolation", "_covered", "_to_fine", "_to_coarse"} <= vars(
            level._to_finer
        ).keys()


def test_a_match_waits_for_what_is_being_made(monkeypatch):
    mesh = torus(40, 20)
    begun, collapse, face_counts = threading.Event(), coarsening._collapse_edges, []

    def slowly(*arguments):
        begun.set()
        face_counts.append(arguments[-1])
        time.sleep(0.2)
        collapse(*arguments)

    monkeypatch.setattr(coarsening, "_collapse_edges", slowly)
    ahead = threading.Thread(target=prepare, args=(mesh, COARSER))
    ahead.start()
    assert begun.wait(10)
    assert len(made(mesh)) == 3
    ahead.join()
    assert face_counts == [400, 100]


def test_who_waits_can_be_cancelled():
    mesh = icosphere(1)

    cancelled = Control()
    cancelled.cancel()
    with _making(mesh), controlled(cancelled), pytest.raises(CancelledError), _making(mesh):
        pass
    with _making(mesh):  # nobody holds it any more
        pass


def chosen(mesh, f, g, monkeypatch, **extras):
    """How many meshes are used where their number is chosen by the mesh and the functions."""
    monkeypatch.setattr(module, "COARSEST", 160)
    return len(all_levels(MatchingEnergy(mesh, f, g, Parameters(), **extras)))


def test_meshes_that_do_not_resolve_the_functions_are_left_out(monkeypatch):
    """A bump of half the width allows for one mesh less, of a quarter of the vertices each."""
    mesh = icosphere(4)
    counts = [
        chosen(mesh, *(bump(mesh, [0, 0, s], w) for s in (1, -1)), monkeypatch)
        for w in (0.3, 0.15, 0.075)
    ]
    assert counts == [3, 2, 1]
    flat = np.ones(len(mesh.vertices))
    assert chosen(mesh, flat, flat, monkeypatch) == 3
    # small enough
    assert chosen(icosphere(2), bump(icosphere(2), [0, 0, 1], 0.5), np.ones(162), monkeypatch) == 1


def test_what_has_no_weight_does_not_choose(monkeypatch):
    mesh = icosphere(4)
    wide, narrow = (bump(mesh, [0, 0, 1], w) for w in (0.3, 0.075))
    f = np.stack([wide, narrow], axis=1)
    assert chosen(mesh, f, -f, monkeypatch, weights=[1, 1]) == 1
    assert chosen(mesh, f, -f, monkeypatch, weights=[1, 0]) == 3


def test_the_energy_is_about_the_same_on_all_meshes():
    """At rest, in the norm of the parameters and in one that reaches far, with mask and weights."""
    mesh = icosphere(4)
    f = np.stack([bump(mesh, [0, 0, 1], 0.3), 2 * bump(mesh, [1, 0, 0], 0.3)], axis=1)
    g = np.stack([bump(mesh, [0, 1, 0], 0.3), 2 * bump(mesh, [0, 0.6, 0.8], 0.3)], axis=1)
    mask = 0.5 + 0.4 * mesh.vertices[:, 1]
    finest = MatchingEnergy(mesh, f, g, Parameters(levels=3), mask=mask, weights=[1.0, 0.3])
    found = all_levels(finest)
    assert [level.energy.discretisation.size for level in found] == [160, 640, 2562]
    assert found[-1].energy is finest
    for level in found[:-1]:
        E = level.energy
        assert E.functions.function_size == finest.functions.function_size
        assert E.mesh.length_scale == 1
        assert (E.functions.mask >= 0).all()
        np.testing.assert_array_equal(E.functions.weights, finest.functions.weights)
        for reach in (0.0, 0.5):
            here, there = (
                each.objective(0.1, reach).evaluate(np.zeros(each.shape)).energy
                for each in (E, finest)
            )
            assert abs(here / there - 1) < 0.15


def test_fields_there_and_back_move_as_far():
    """In units of each mesh scaled to unit area, whose surfaces differ."""
    finest = MatchingEnergy(
        icosphere(4), *(bump(icosphere(4), [0, 0, s], 0.3) for s in (1, -1)), Parameters(levels=2)
    )
    coarser, finer = all_levels(finest)
    field = rotation_field(finer.energy.mesh, [0.3, -0.5, 0.8])[None]
    down = coarser.fields_from_finer(field)
    expected = rotation_field(coarser.energy.mesh, [0.3, -0.5, 0.8])
    assert (
        relative_error(coarser.energy.mesh, to_ambient(coarser.energy.mesh, down[0]), expected)
        < 0.02
    )
    up = to_ambient(finest.mesh, coarser.fields_to_finer(down))
    assert relative_error(finest.mesh, up[0], field[0]) < 0.02


def test_coarser_meshes_of_one_size_are_not_taken_for_each_other():
    """Two that were asked for differently may have as many vertices, and other faces."""
    fine, coarse = icosphere(2), icosphere(1)
    other = renumbered(coarse, 1)[0]
    assert module._transfer(fine, coarse).coarse is coarse
    assert module._transfer(fine, other).coarse is other
    assert module._transfer(fine, other) is module._transfer(fine, other)
