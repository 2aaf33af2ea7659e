"""Options of all tests, the threads of one process, and what is checked at the end of a run."""

import gc
import os

import pytest
from hypothesis import settings

from tests.messages import MessageSnapshot
from tests.viewer.end_to_end.widget_coverage import WidgetCoverage

# the last one is Mesa's
for _threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "LP_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")  # with pytest-xdist there is a process for each core
_SLOW_TEST_NAMES = (
    "test_real_window",
    "test_default_parameters_match",
    "end_to_end/",
    "core/registration/",
    "test_far_matches",
    "test_attack",
)
"""Parts of the names of tests that take 10 seconds or more, the longest first."""
# no test is about time, and machines are busy; each run draws other examples
settings.register_profile("untimed", deadline=None, max_examples=50)
settings.load_profile("untimed")


def pytest_addoption(parser):
    parser.addoption(
        "--update-snapshots",
        action="store_true",
        help="rewrite the pictures and messages in tests/snapshots",
    )


def pytest_collection_modifyitems(items):
    # what takes longest is not begun last, when other processes have nothing left to do
    def rank(item):
        return next(
            (k for k, name in enumerate(_SLOW_TEST_NAMES) if name in item.nodeid),
            len(_SLOW_TEST_NAMES),
        )

    items.sort(key=rank)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Neither now nor later what thousands of tests are made of is looked through for garbage."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_configure(config):
    config.pluginmanager.register(WidgetCoverage(config), "widget coverage")
    config.pluginmanager.register(MessageSnapshot(config), "message snapshot")


def pytest_xdist_auto_num_workers():
    """Run one process more than there are cores, as tests wait for processes of their own."""
    return (os.cpu_count() or 1) + 1
