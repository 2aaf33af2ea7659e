"""What tests of the benchmarks share: a process that solves."""

import pytest

from tests.spare_processes import reused_processes


@pytest.fixture(scope="module", autouse=True)
def _one_process_for_one_batch_after_the_other():
    with reused_processes():
        yield
