import pytest

from tests.core.surfaces import SURFACES


@pytest.fixture(params=SURFACES)
def mesh(request):
    return SURFACES[request.param]
