"""Options of all tests."""

from __future__ import annotations


def pytest_addoption(parser):
    parser.addoption("--update-snapshots", action="store_true", help="write the pictures of tests/snapshots anew")
