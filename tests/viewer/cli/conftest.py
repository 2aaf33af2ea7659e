"""The command line, run in this process."""

from contextlib import nullcontext

import pytest

from abfm.assets import asset_path
from abfm_viewer.cli import main
from tests.processes import argv, refused_soon, words_of
from tests.spare_processes import reused_processes

MESHES = {name: asset_path(f"{name}.off") for name in ("eight", "human_A", "human_B")}


@pytest.fixture(scope="module", autouse=True)
def _one_process_for_one_batch_after_the_other():
    with reused_processes():
        yield


@pytest.fixture
def abfm(capsys, tmp_path):
    """Run a command with this exit status and return what it printed.

    The line has names of places in braces: ``{t}`` is the temporary folder, and ``{eight}``,
    ``{human_A}`` and ``{human_B}`` are meshes. Other words follow as they are.
    """

    def run(line, *words, status=0, **places):
        line = words_of(line, **({"t": tmp_path} | MESHES | places))
        with refused_soon() if status == 2 else nullcontext():
            assert main([*line, *argv(*words)]) == status
        told = capsys.readouterr()
        if status == 2:
            assert told.err.startswith("abfm: ")
            assert told.err.count("\n") == 1
        return told

    return run
