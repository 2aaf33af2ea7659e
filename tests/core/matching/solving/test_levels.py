import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from abfm import MatchingEnergy, Parameters
from abfm.calculus.operators import vertex_areas
from abfm.calculus.vector_fields import to_ambient, to_frame
from abfm.maps.surface_points import project_onto_surface
from abfm.matching.solving import levels as module
from abfm.matching.solving.levels import Levels, Transfer, _making, prepare
from abfm.matching.solving.settings import SETTINGS
from abfm.mesh import TriangleMesh, coarsening
from abfm.mesh.coarsening import coarsened
from abfm.workers.control import CancelledError, Control, controlled
from tests.core.fields import bump, rotation_field, wavy_field
from tests.core.surfaces import SURFACES, moved, random_function, relative_error, renumbered
from tests.core.verification import observed_orders
from tests.shapes import hemisphere, icosphere, open_cylinder, square, torus

COARSER = Parameters.of(levels=3)


def all_levels(finest):
    return Levels.of_mesh(finest).with_coarser()


def levels_of(mesh):
    f = mesh.vertices[:, 0]
    return all_levels(MatchingEnergy(mesh, f, f[::-1].copy(), COARSER))


def test_match_uses_prepared_meshes(monkeypatch):
    mesh = torus(40, 20)
    prepare(mesh, COARSER)

    def never(*_):
        raise AssertionError("the mesh is coarsened again")

    monkeypatch.setattr(coarsening, "_collapse_edges", never)
    found = levels_of(mesh)
    assert [len(level.energy.mesh.vertices) for level in found.all] == [50, 200, 800]
    for level in found.all[:-1]:
        cached = vars(level.to_finer).keys()
        assert {"interpolation", "_covered", "_to_fine", "_to_coarse"} <= cached


def test_match_waits_for_meshes_in_preparation(monkeypatch):
    mesh = torus(40, 20)
    begun, collapse, face_counts = threading.Event(), coarsening._collapse_edges, []

    def slowly(*arguments):
        begun.set()
        face_counts.append(arguments[-1])
        time.sleep(0.2)
        collapse(*arguments)

    monkeypatch.setattr(coarsening, "_collapse_edges", slowly)
    preparing = threading.Thread(target=prepare, args=(mesh, COARSER))
    preparing.start()
    assert begun.wait(10)
    assert len(levels_of(mesh)) == 3
    preparing.join()
    assert face_counts == [400, 100]


def test_waiting_match_can_be_cancelled():
    mesh, cancelled = icosphere(1), Control()
    cancelled.cancel()
    with _making(mesh), controlled(cancelled), pytest.raises(CancelledError), _making(mesh):
        pass
    with _making(mesh):  # the lock was released
        pass


def level_count(mesh, f, g, monkeypatch, **extras):
    monkeypatch.setattr(module, "SETTINGS", replace(SETTINGS, coarsest_vertices=160))
    return len(all_levels(MatchingEnergy(mesh, f, g, Parameters(), **extras)))


def test_coarse_levels_resolve_the_functions(monkeypatch):
    """Each level has a quarter of the vertices; a bump of half the width has one level less."""
    mesh, small = icosphere(4), icosphere(2)
    for width, count in ((0.3, 3), (0.15, 2), (0.075, 1)):
        f, g = (bump(mesh, [0, 0, s], width) for s in (1, -1))
        assert level_count(mesh, f, g, monkeypatch) == count
    flat = np.ones(len(mesh.vertices))
    assert level_count(mesh, flat, flat, monkeypatch) == 3
    assert level_count(small, bump(small, [0, 0, 1], 0.5), np.ones(162), monkeypatch) == 1
    wide, narrow = (bump(mesh, [0, 0, 1], w) for w in (0.3, 0.075))
    f = np.stack([wide, narrow], axis=1)
    assert level_count(mesh, f, -f, monkeypatch, weights=[1, 1]) == 1
    assert level_count(mesh, f, -f, monkeypatch, weights=[1, 0]) == 3


def test_energy_is_similar_on_all_levels():
    mesh = icosphere(4)
    f = np.stack([bump(mesh, [0, 0, 1], 0.3), 2 * bump(mesh, [1, 0, 0], 0.3)], axis=1)
    g = np.stack([bump(mesh, [0, 1, 0], 0.3), 2 * bump(mesh, [0, 0.6, 0.8], 0.3)], axis=1)
    mask = 0.5 + 0.4 * mesh.vertices[:, 1]
    finest = MatchingEnergy(mesh, f, g, Parameters.of(levels=3), mask=mask, weights=[1.0, 0.3])
    found = [level.energy for level in all_levels(finest).all]
    assert [E.discretisation.size for E in found] == [160, 640, 2562]
    assert found[-1] is finest
    for E in found[:-1]:
        assert E.functions.function_size == finest.functions.function_size
        assert E.mesh.length_scale == 1
        assert (E.functions.mask >= 0).all()
        assert_array_equal(E.functions.weights, finest.functions.weights)
        for reach in (0.0, 0.5):
            here, there = (
                each.objective(0.1, reach).evaluate(np.zeros(each.shape)).energy
                for each in (E, finest)
            )
            assert abs(here / there - 1) < 0.15


def test_fields_round_trip_between_levels():
    """Fields are in the unit of each mesh scaled to unit area, although the areas differ."""
    ball = icosphere(4)
    f, g = (bump(ball, [0, 0, s], 0.3) for s in (1, -1))
    level, finer = all_levels(MatchingEnergy(ball, f, g, Parameters.of(levels=2))).all
    coarse, fine = level.energy.mesh, finer.energy.mesh
    field = rotation_field(fine, AXIS)[None]
    down = level.fields_from_finer(field)
    expected = rotation_field(coarse, AXIS)
    assert relative_error(coarse, to_ambient(coarse, down[0]), expected) < 0.02
    up = to_ambient(fine, level.fields_to_finer(down))
    assert relative_error(fine, up[0], field[0]) < 0.02


def test_transfers_of_different_meshes_are_distinct():
    fine, coarse = icosphere(2), icosphere(1)
    other = renumbered(coarse, 1)[0]
    assert module._transfer(fine, coarse).coarse is coarse
    assert module._transfer(fine, other).coarse is other
    assert module._transfer(fine, other) is module._transfer(fine, other)


AXIS = [0.3, -0.5, 0.8]
FINE = {
    "sphere": icosphere(3),
    "torus": torus(40, 20),
    "genus two": SURFACES["genus two"],
    "square": square(20),
    "hemisphere": hemisphere(14),
    "cylinder": open_cylinder(30, 12),
}


def transfer(fine):
    return Transfer(coarsened(fine, len(fine.vertices) // 4), fine)


@pytest.mark.parametrize("fine", FINE.values(), ids=FINE.keys())
def test_transfers_are_averages_and_adjoint(fine):
    """No weight is negative, and ``<f, P h> = <P* f, h>`` with the areas of the fine mesh."""
    pair = transfer(fine)
    on_coarse, on_fine = (len(mesh.vertices) for mesh in (pair.coarse, pair.fine))
    for transferred, before, after in (
        (pair.function_to_fine, on_coarse, on_fine),
        (pair.function_to_coarse, on_fine, on_coarse),
    ):
        flat = np.full((2, after), 3.0)
        assert_allclose(transferred(np.full((2, before), 3.0)), flat, rtol=1e-14, strict=True)
        matrix = transferred(np.eye(before)).T
        assert (matrix >= 0).all()
        assert_allclose(matrix.sum(axis=1), 1, rtol=1e-12)
    f, h, areas = random_function(fine), random_function(pair.coarse), vertex_areas(fine)
    covered = pair.interpolation.T @ areas
    assert (covered > 0).mean() > 0.95
    there = (areas * f) @ pair.function_to_fine(np.where(covered > 0, h, 0.0))
    assert there == pytest.approx((covered * h) @ pair.function_to_coarse(f), rel=1e-10)


def test_averages_preserve_integrals():
    """Integrals are exact by areas of hat functions, and of order 2 by areas of the coarse mesh."""
    errors = []
    for subdivisions in (3, 4, 5):
        pair = transfer(icosphere(subdivisions))
        f, areas = bump(pair.fine, [0, 0, 1], 0.2), vertex_areas(pair.fine)
        integral, down = areas @ f, pair.function_to_coarse(f)
        assert (pair.interpolation.T @ areas) @ down == pytest.approx(integral, rel=1e-10)
        errors.append(abs(vertex_areas(pair.coarse) @ down / integral - 1))
    assert observed_orders([4, 2, 1], errors).min() > 1.8
    assert errors[-1] < 0.005


def test_linear_functions_on_a_plane_are_exact():
    pair, slope = transfer(FINE["square"]), np.array([2.0, -3.0, 0.0])
    mesh, coarse = pair.fine, pair.coarse
    covered = project_onto_surface(coarse, mesh.vertices).distances_from(mesh.vertices) < 1e-12
    assert covered.mean() > 0.8
    found = pair.function_to_fine(1 + coarse.vertices @ slope)
    assert_allclose(found[covered], (1 + mesh.vertices @ slope)[covered], atol=1e-14)
    on_coarse, on_fine = (np.tile(slope, (len(each.faces), 1)) for each in (coarse, mesh))
    assert_allclose(to_ambient(mesh, pair.field_to_fine(on_coarse)), on_fine, atol=1e-12)
    assert_allclose(to_ambient(coarse, pair.field_to_coarse(on_fine)), on_coarse, atol=1e-12)


def errors_between(subdivisions, nested):
    """Return errors of functions in both directions, then of the field of a rotation."""
    fine = icosphere(subdivisions)
    pair = Transfer(icosphere(subdivisions - 1), fine) if nested else transfer(fine)
    coarse = pair.coarse
    f, h = (bump(mesh, [0, 0, 1], 0.2) for mesh in (fine, coarse))
    v, u = (rotation_field(mesh, AXIS) for mesh in (fine, coarse))
    return [
        relative_error(fine, pair.function_to_fine(h), f),
        relative_error(coarse, pair.function_to_coarse(f), h),
        relative_error(fine, to_ambient(fine, pair.field_to_fine(u)), v),
        relative_error(coarse, to_ambient(coarse, pair.field_to_coarse(v)), u),
    ]


def test_transfer_errors_have_order_two():
    """Errors have order 2; averages on uneven meshes, which are centred less well, order 1."""
    nested, uneven = (
        np.transpose([errors_between(k, kind) for k in (3, 4, 5)]) for kind in (True, False)
    )
    for errors in (*nested, *uneven[[0, 2, 3]]):
        assert observed_orders([4, 2, 1], errors).min() > 1.6
    assert observed_orders([4, 2, 1], uneven[1]).min() > 0.8
    assert uneven[:, -1].max() < 0.015


def test_discretisation_errors_of_levels_have_order_two():
    mesh = icosphere(4)
    f, g = (bump(mesh, axis, 0.3) for axis in ([0, 0, 1], [0, 1, 0]))

    def errors(f, g):
        found = all_levels(MatchingEnergy(mesh, f, g, COARSER))
        return [found.error(level) for level in range(3)]

    found = errors(f, g)
    assert 0.01 < found[0] < 0.2
    assert 2.5 < found[0] / found[1] < 5  # four times the vertices; the coarsest mesh is uneven
    assert found[2] == 0
    assert_allclose(errors(7 * f + 3, 7 * g + 3), found, rtol=1e-9)
    assert errors(np.ones(len(f)), np.ones(len(f)))[0] < 1e-12


def assert_equal_except_on_edges(found, expected):
    """Compare fields, but not on edges, where rounding decides which of two faces is used."""
    errors = np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1).max()
    assert np.mean(errors > 1e-7) < 0.35
    assert np.sqrt(np.mean(errors**2)) < 0.02


@pytest.mark.parametrize("name", ["genus two", "hemisphere"])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e9])
def test_transfers_are_invariant_to_motion_and_unit(name, scale):
    here, rotation = transfer(FINE[name]), Rotation.from_rotvec([0.3, 1.0, -0.4]).as_matrix()
    fine, coarse = here.fine, here.coarse
    there = Transfer(
        TriangleMesh(scale * moved(coarse, rotation).vertices, coarse.faces),
        TriangleMesh(scale * moved(fine, rotation).vertices, fine.faces),
    )
    f, h = bump(fine, fine.vertices[40], 0.2), bump(coarse, coarse.vertices[10], 0.2)
    assert_allclose(there.function_to_coarse(f), here.function_to_coarse(f), atol=1e-8)
    assert_allclose(there.function_to_fine(h), here.function_to_fine(h), atol=1e-8)
    for mesh, name in ((coarse, "field_to_fine"), (fine, "field_to_coarse")):
        field = wavy_field(mesh, 3)
        other = getattr(there, name)(scale * field @ rotation.T)
        assert_equal_except_on_edges(other / scale, getattr(here, name)(field))


def test_transfers_are_invariant_to_numbering():
    one = transfer(FINE["genus two"])
    fine, coarse = one.fine, one.coarse
    mixed, vertices, faces = renumbered(coarse, 1)
    h, u = bump(coarse, coarse.vertices[10], 0.2), wavy_field(coarse, 3)
    other = Transfer(mixed, fine)
    assert_allclose(other.function_to_fine(h[vertices]), one.function_to_fine(h), atol=1e-12)
    assert_equal_except_on_edges(other.field_to_fine(u[faces]), one.field_to_fine(u))
    f = bump(fine, fine.vertices[40], 0.2)
    assert_allclose(other.function_to_coarse(f), one.function_to_coarse(f)[vertices], atol=1e-12)


def test_transfers_are_bitwise_reproducible():
    found = []
    for prepared in (False, True):
        pair = transfer(torus(40, 20))
        if prepared:
            pair.prepare()
        up = pair.field_to_fine(wavy_field(pair.coarse, 1))
        found.append(np.concatenate([up, pair.field_to_coarse(wavy_field(pair.fine, 1))]))
    assert_array_equal(*found)


def test_transfer_to_the_same_mesh_preserves_functions():
    mesh = icosphere(4)
    pair = Transfer(mesh, TriangleMesh(mesh.vertices, mesh.faces))
    f = bump(mesh, [0, 0, 1], 0.1)
    assert_allclose(pair.function_to_fine(f), f, atol=1e-12)
    assert_allclose(pair.function_to_coarse(f), f, atol=1e-12)
    v = rotation_field(mesh, AXIS)
    for transferred in (pair.field_to_fine, pair.field_to_coarse):
        assert relative_error(mesh, to_ambient(mesh, transferred(v)), v) < 0.003


def test_uncovered_vertices_have_the_closest_value():
    coarse, fine = icosphere(3), icosphere(1)
    pair = Transfer(coarse, fine)
    assert (pair.interpolation.T @ vertex_areas(fine) == 0).sum() > 500
    assert_allclose(pair.function_to_coarse(np.ones(len(fine.vertices))), 1, rtol=1e-12)
    z = fine.vertices[:, 2]
    assert_allclose(pair.function_to_coarse(z), coarse.vertices[:, 2], atol=0.15)


def test_fields_rotate_with_the_surface():
    """Between cylinders whose normals differ by 12 degrees, fields keep length and direction."""
    coarse, fine = open_cylinder(15, 4), open_cylinder(60, 16)
    pair = Transfer(coarse, fine)
    around = to_ambient(fine, pair.field_to_fine(rotation_field(coarse, [0, 0, 1])))
    assert relative_error(fine, around, rotation_field(fine, [0, 0, 1])) < 0.03
    on_coarse, on_fine = (np.tile([0.0, 0.0, 1.0], (len(mesh.faces), 1)) for mesh in (coarse, fine))
    assert_allclose(pair.field_to_fine(on_coarse), to_frame(fine, on_fine), atol=1e-9)
