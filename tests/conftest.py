"""Options of all tests, threads of compiled libraries, and checks at the end of a run."""

import gc
import os

import pytest
from hypothesis import HealthCheck, settings

from tests.messages import MessageSnapshot
from tests.viewer.end_to_end.widget_coverage import WidgetCoverage

# LP_NUM_THREADS is a variable of Mesa
for _threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "LP_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # with pytest-xdist there is a process for each core
_SLOW_TEST_NAMES = (
    "test_real_window",
    "test_defaults_match",
    "end_to_end/",
    "core/registration/",
    "test_distant_targets",
    "test_attack",
)
"""Parts of the names of tests that take 10 seconds or more, the longest first."""
_OBJECTS_PER_COLLECTION = 10_000
# examples of hypothesis share the fixtures of a test; no deadline, since machines may be busy
_FIXTURES = [HealthCheck.function_scoped_fixture]
settings.register_profile(
    "untimed", deadline=None, max_examples=50, suppress_health_check=_FIXTURES
)
settings.load_profile("untimed")


def pytest_addoption(parser):
    parser.addoption(
        "--update-snapshots",
        action="store_true",
        help="rewrite the pictures and messages in tests/snapshots",
    )


def pytest_collection_modifyitems(items):
    # the longest tests start first, so that all processes end at about the same time
    def rank(item):
        return next(
            (k for k, name in enumerate(_SLOW_TEST_NAMES) if name in item.nodeid),
            len(_SLOW_TEST_NAMES),
        )

    items.sort(key=rank)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Exclude the collected tests from garbage collection, since there are thousands.

    Less frequent collections save 2% of the time.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(_OBJECTS_PER_COLLECTION)
        gc.enable()


def pytest_configure(config):
    config.pluginmanager.register(WidgetCoverage(config), "widget coverage")
    config.pluginmanager.register(MessageSnapshot(config), "message snapshot")


def pytest_xdist_auto_num_workers():
    """Return one process more than there are cores, as tests wait for subprocesses."""
    return (os.cpu_count() or 1) + 1
