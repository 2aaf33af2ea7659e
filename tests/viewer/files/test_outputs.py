"""Files that cannot be written are refused before anything is computed for them."""

from __future__ import annotations

from pathlib import Path

import pytest

from abfm import ResultError
from abfm_viewer.files import outputs


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("result.txt", r"must end in \.npz"),
        ("no folder/result.npz", "there is no folder"),
        ("folder.npz", "it is a folder"),
    ],
)
def test_paths_that_cannot_be_written_are_refused(tmp_path, name, words):
    (tmp_path / "folder.npz").mkdir()
    with pytest.raises(ResultError, match=words):
        outputs.check(tmp_path / name, [".npz"])


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a folder in which nobody may write")
def test_a_folder_that_takes_no_files_is_refused():
    with pytest.raises(ResultError, match=r"cannot write /proc/self/result\.npz: .*; choose a place that"):
        outputs.check(Path("/proc/self/result.npz"), [".npz"])


def test_nothing_is_left_by_the_check(tmp_path):
    outputs.check(tmp_path / "result.npz", [".npz"])
    assert list(tmp_path.iterdir()) == []
