"""The command line, run in this process."""

import pytest

from abfm_viewer.cli import main
from tests.processes import argv
from tests.spare_processes import spared


@pytest.fixture(scope="module", autouse=True)
def _one_process_for_one_batch_after_the_other():
    with spared():
        yield


@pytest.fixture
def abfm(capsys):
    """Run a line of words with this exit status; gives what it said, an error as one line."""

    def run(words, *more, status=0):
        assert main([*argv(words), *map(str, more)]) == status
        told = capsys.readouterr()
        if status == 2:
            assert told.err.startswith("abfm: ")
            assert told.err.count("\n") == 1
        return told

    return run
