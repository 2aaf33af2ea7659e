"""Factorisations, their memory, and compiled libraries with little spare memory."""

import sys

import numpy as np
import pytest
from scipy import sparse

from abfm.numerics import cholesky
from abfm.numerics.cholesky import factor
from tests.processes import python

UNKNOWNS, TIMES = 20_000, 200
REPEATED_FACTORISATION = f"""
import resource
import numpy as np
from scipy import sparse
from abfm.numerics.cholesky import factor

matrix = sparse.csr_array(sparse.diags_array(4.0 - np.arange({UNKNOWNS}) % 2))
for time in range({TIMES} + 1):
    solve = factor(matrix)
    solve(np.ones({UNKNOWNS}))
    if time == 0:
        begin = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - begin)
"""


def test_released_factorisations_leak_no_memory():
    done = python(REPEATED_FACTORISATION, check=True)
    assert not done.stderr
    each = int(done.stdout) * (1 if sys.platform == "darwin" else 1024) / TIMES
    assert each < UNKNOWNS  # bytes; a leaked right-hand side has eight bytes for each unknown


@pytest.mark.parametrize("unknowns", [0, 1, 2, 50])
@pytest.mark.parametrize("by_cholespy", [True, False])
def test_solver_solves_linear_systems(unknowns, by_cholespy, monkeypatch):
    if not by_cholespy:
        monkeypatch.setattr(cholesky, "CholeskySolverD", None)
    rng = np.random.default_rng(unknowns)
    root = sparse.random_array((unknowns, unknowns), density=0.1, rng=rng)
    matrix = sparse.csr_array(root @ root.T + sparse.eye_array(unknowns))
    solve = factor(matrix)
    for x in rng.standard_normal((2, unknowns)):
        given = matrix @ x
        np.testing.assert_allclose(solve(given), x, atol=1e-12)
        np.testing.assert_array_equal(given, matrix @ x)  # b itself is unchanged


RUNS = """
import os, resource

def inside(library):
    def called(*given, **named):
        try:
            return library(*given, **named)
        except MemoryError:
            os._exit(3)
    return called

def with_little_more(call, most):
    for kilobytes in range(0, most, 128):
        if not os.fork():
            used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, 2 * (used + kilobytes * 2**10,))
            try:
                call()
            except MemoryError:
                os._exit(1)
            os._exit(0)
        print(os.waitstatus_to_exitcode(os.wait()[1]), end=" ")
"""
DISTANCES = """
import potpourri3d
from abfm.assets import asset_path
from abfm.calculus.geodesics import geodesic_distance
from abfm.mesh import load_mesh

geodesic_distance(load_mesh(asset_path("eight.off")), 0)
potpourri3d.MeshHeatMethodDistanceSolver = inside(potpourri3d.MeshHeatMethodDistanceSolver)
mesh = load_mesh(asset_path("human_A.off")).normalized()
with_little_more(lambda: geodesic_distance(mesh, 7), most=12_000)
"""
FACTORISATION = """
import numpy as np
from scipy import sparse
from abfm.numerics import cholesky

path = sparse.diags_array([2.01, -1, -1], offsets=[0, 1, -1], shape=(60, 60))
one = sparse.eye_array(60)
grid = sparse.csr_array(sparse.kron(path, one) + sparse.kron(one, path))
cholesky.factor(sparse.csr_array(path))(np.ones(60))
if cholesky.CholeskySolverD is not None:
    cholesky.CholeskySolverD = inside(cholesky.CholeskySolverD)
with_little_more(lambda: cholesky.factor(grid)(np.ones(3600)), most=8_000)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="other systems cannot limit memory")
@pytest.mark.parametrize("what", [DISTANCES, FACTORISATION], ids=["distances", "factorisation"])
def test_missing_memory_is_detected_before_the_library_call(what):
    """With any memory limit, a call succeeds or raises a MemoryError outside of the library."""
    done = python(RUNS + what, check=True)
    assert set(done.stdout.split()) == {"0", "1"}
    assert done.stderr == ""
