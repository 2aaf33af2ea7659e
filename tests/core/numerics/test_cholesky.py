"""Factorisations, and what stays of them."""

import sys

import numpy as np
import pytest
from scipy import sparse

from abfm.numerics.cholesky import factor
from tests.processes import python

UNKNOWNS, TIMES = 20_000, 200
AGAIN_AND_AGAIN = f"""
import resource
import numpy as np
from scipy import sparse
from abfm.numerics.cholesky import factor

matrix = sparse.csr_array(sparse.diags_array(4.0 - np.arange({UNKNOWNS}) % 2))
for time in range({TIMES} + 1):
    kept = factor(matrix)
    kept(np.ones({UNKNOWNS}))
    if time == 0:
        begin = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - begin)
"""


def test_nothing_stays_of_those_that_are_forgotten_and_none_is_reported_in_the_end():
    done = python(AGAIN_AND_AGAIN, check=True)
    assert not done.stderr
    each = int(done.stdout) * (1 if sys.platform == "darwin" else 1024) / TIMES
    assert each < UNKNOWNS  # bytes; eight for each unknown if the latest right-hand side stays


@pytest.mark.parametrize("unknowns", [0, 1, 2, 50])
def test_it_solves(unknowns):
    rng = np.random.default_rng(unknowns)
    root = sparse.random_array((unknowns, unknowns), density=0.1, rng=rng)
    matrix = sparse.csr_array(root @ root.T + sparse.eye_array(unknowns))
    x = rng.standard_normal(unknowns)
    np.testing.assert_allclose(factor(matrix)(matrix @ x), x, atol=1e-10)
