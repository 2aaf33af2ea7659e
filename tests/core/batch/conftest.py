"""Fixture for tests of batches that are not about their processes."""

import pytest

from tests.spare_processes import reused_processes


@pytest.fixture
def spare_process():
    """Reuse the worker process of an earlier test."""
    with reused_processes():
        yield
