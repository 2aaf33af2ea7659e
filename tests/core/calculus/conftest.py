"""What the tests of the calculus share."""

import pytest

from abfm.mesh import TriangleMesh
from tests.core.surfaces import SURFACES


@pytest.fixture(params=SURFACES)
def mesh(request: pytest.FixtureRequest) -> TriangleMesh:
    """Every kind of surface."""
    return SURFACES[request.param]
