"""What the tests of the calculus share."""

import pytest

from tests.core.surfaces import SURFACES


@pytest.fixture(params=SURFACES)
def mesh(request):
    """Every kind of surface."""
    return SURFACES[request.param]
