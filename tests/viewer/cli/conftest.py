"""Fixtures that run the command line in this process."""

from contextlib import nullcontext

import pytest

from abfm.assets import asset_path
from abfm_viewer.cli import main
from tests.processes import argv, refused_soon, words_of
from tests.spare_processes import reused_processes

MESHES = {name: asset_path(f"{name}.off") for name in ("eight", "human_A", "human_B")}


@pytest.fixture(scope="module", autouse=True)
def _batches_reuse_one_process():
    with reused_processes():
        yield


@pytest.fixture
def abfm(capsys, tmp_path):
    """Run a command, check its exit status, and return its output.

    Names of paths are in braces: ``{t}`` is the temporary folder, and ``{eight}``, ``{human_A}``
    and ``{human_B}`` are meshes. Further arguments are appended unchanged.
    """

    def run(line, *words, status=0, **places):
        line = words_of(line, **({"t": tmp_path} | MESHES | places))
        with refused_soon() if status == 2 else nullcontext():
            assert main([*line, *argv(*words)]) == status
        output = capsys.readouterr()
        if status == 2:
            assert output.err.startswith("abfm: ")
            assert output.err.count("\n") == 1
        return output

    return run
