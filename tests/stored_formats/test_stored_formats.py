"""Files that releases wrote, which every later version must read."""

import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest

import abfm
from abfm_viewer.files.documents import read_document
from abfm_viewer.files.project import save_project
from tests.stored_formats.write import PROJECTS, RESULTS

_FOLDER = Path(__file__).parent
_RELEASES = sorted(path.name for path in _FOLDER.iterdir() if path.name[0].isdigit())
_LATEST = _FOLDER / _RELEASES[-1]


def _columns(path):
    """Return the type and the number of dimensions of each array in a file, by name."""
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        arrays = {}
        for name in names:
            if name.endswith(".npy"):
                with archive.open(name) as file:
                    array = np.lib.format.read_array(file)
                arrays[name] = array.dtype.kind, array.ndim
        return names, arrays


@pytest.mark.parametrize("release", _RELEASES)
@pytest.mark.parametrize("name", RESULTS)
def test_results_of_releases_are_read(release, name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = abfm.load(_FOLDER / release / f"{name}.npz")
    assert type(found) is RESULTS[name]


@pytest.mark.parametrize("release", _RELEASES)
@pytest.mark.parametrize("name", PROJECTS)
def test_projects_of_releases_are_read(release, name):
    document, _ = read_document(_FOLDER / release / f"{name}.abfm")
    result, _ = read_document(_FOLDER / release / f"{name}.npz")
    assert type(document) is type(result)
    assert document.result is not None


@pytest.mark.parametrize("name", RESULTS)
def test_format_of_results_is_that_of_the_latest_release(tmp_path, name):
    """A changed format needs a higher version, and files of the next release (``write.py``)."""
    stored, copy = _LATEST / f"{name}.npz", tmp_path / "copy.npz"
    abfm.load(stored).save(copy)
    assert _columns(copy) == _columns(stored)


@pytest.mark.parametrize("name", PROJECTS)
def test_format_of_projects_is_that_of_the_latest_release(tmp_path, name):
    stored, copy = _LATEST / f"{name}.abfm", tmp_path / "copy.abfm"
    save_project(copy, *read_document(stored))
    assert _columns(copy) == _columns(stored)
