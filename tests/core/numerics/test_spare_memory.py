"""Compiled libraries in processes with little more memory than they use, and ever more."""

import sys

import pytest

from tests.processes import python

pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="elsewhere memory has no limit that can be set"
)

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


@pytest.mark.parametrize("what", [DISTANCES, FACTORISATION], ids=["distances", "factorisation"])
def test_a_library_is_not_called_where_memory_would_run_out_inside_it(what):
    """There it may not only raise a MemoryError (3) but, by chance, crash (below 0)."""
    done = python(RUNS + what, check=True)
    assert set(done.stdout.split()) == {"0", "1"}
    assert done.stderr == ""
