"""The meshes that a match begins on: made once, ahead if somebody asks, in a process of their own for a window."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from abfm import MatchingEnergy, Parameters, own_process
from abfm.control import CancelledError
from abfm.levels import _making, levels, prepare
from abfm.mesh import coarsening
from tests.shapes import icosphere, torus

COARSER = Parameters(levels=3)


def energy(mesh):
    f = mesh.vertices[:, 0]
    return MatchingEnergy(mesh, f, f[::-1].copy(), COARSER)


def made(mesh):
    return [level.energy.mesh for level in levels(energy(mesh), lambda: None)]


def test_what_was_prepared_is_what_a_match_uses(monkeypatch):
    mesh = torus(40, 20)
    prepare(mesh, COARSER)

    def never(*_):
        raise AssertionError("made again")

    monkeypatch.setattr(coarsening, "_collapse", never)
    found = levels(energy(mesh), lambda: None)
    assert [len(level.energy.mesh.vertices) for level in found] == [50, 200, 800]
    for level in found[:-1]:
        assert {"interpolation", "_averaging", "_to_fine", "_to_coarse"} <= vars(level._transfer).keys()


def test_a_match_waits_for_what_is_being_made(monkeypatch):
    mesh = torus(40, 20)
    begun, collapse, count = threading.Event(), coarsening._collapse, []

    def slowly(mesh, vertex_count):
        begun.set()
        count.append(vertex_count)
        time.sleep(0.2)
        return collapse(mesh, vertex_count)

    monkeypatch.setattr(coarsening, "_collapse", slowly)
    ahead = threading.Thread(target=prepare, args=(mesh, COARSER))
    ahead.start()
    assert begun.wait(10)
    assert len(made(mesh)) == 3
    ahead.join()
    assert count == [200, 50]


def test_who_waits_can_be_cancelled():
    mesh = icosphere(1)

    def cancelled():
        raise CancelledError

    with _making(mesh), pytest.raises(CancelledError), _making(mesh, cancelled):
        pass
    with _making(mesh):  # nobody holds it any more
        pass


def test_a_process_of_its_own_makes_the_same_mesh(monkeypatch):
    mesh = torus(40, 20)
    expected = coarsening.coarsened(mesh, 200)
    monkeypatch.setattr(own_process, "factor_from", 800)
    there = coarsening.coarsened(torus(40, 20), 200)
    np.testing.assert_array_equal(there.vertices, expected.vertices)
    np.testing.assert_array_equal(there.faces, expected.faces)


def test_a_process_that_was_ended_is_told_as_want_of_memory(monkeypatch):
    monkeypatch.setattr(own_process, "factor_from", 1)
    monkeypatch.setattr(own_process.OwnProcess, "send", lambda self, message: self.close())
    with pytest.raises(MemoryError, match="has ended"):
        coarsening.coarsened(torus(40, 20), 200)
