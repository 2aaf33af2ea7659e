"""Examples in docstrings run."""

import doctest
from importlib import import_module

import pytest

MODULES = ["abfm.flow.flow", "abfm.matching.match", "abfm.matching.problem"]


@pytest.mark.parametrize("name", MODULES)
def test_examples_show_what_they_say(name):
    found = doctest.testmod(import_module(name))
    assert found.attempted > 0
    assert found.failed == 0
