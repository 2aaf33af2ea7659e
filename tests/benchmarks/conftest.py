"""Fixture for tests of benchmarks, by which batches reuse one worker process."""

import pytest

from tests.spare_processes import reused_processes


@pytest.fixture(scope="module", autouse=True)
def _batches_reuse_one_process():
    with reused_processes():
        yield
