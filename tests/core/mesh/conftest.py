"""A folder for the examples of one test file."""

import pytest


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder for all tests of a module."""
    return tmp_path_factory.mktemp("meshes")
