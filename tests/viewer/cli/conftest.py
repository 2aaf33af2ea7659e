"""The command line, run in this process."""

from contextlib import nullcontext

import pytest

from abfm_viewer.cli import main
from tests.processes import argv, refused_soon
from tests.spare_processes import spared


@pytest.fixture(scope="module", autouse=True)
def _one_process_for_one_batch_after_the_other():
    with spared():
        yield


@pytest.fixture
def abfm(capsys):
    """Run a command by its words with this exit status and return what it printed."""

    def run(*words, status=0):
        with refused_soon() if status == 2 else nullcontext():
            assert main(argv(*words)) == status
        told = capsys.readouterr()
        if status == 2:
            assert told.err.startswith("abfm: ")
            assert told.err.count("\n") == 1
        return told

    return run
