"""All files of the project with prose, read once for these tests."""

from itertools import chain

import pytest

from tests.english.texts import read
from tests.processes import ROOT

FOLDERS = ("core", "abfm_viewer", "benchmarks", "tests", "docs")
SUFFIXES = {".py", ".pyi", ".md", ".html", ".js"}
BUILT = {"_build", "gallery", "generated", "__pycache__", "english"}


@pytest.fixture(scope="package")
def sources():
    """Return the `Source` of each file by its path relative to the project.

    Built files are left out, and also these tests, which contain idioms.
    """
    paths = chain(ROOT.glob("*.md"), *((ROOT / folder).rglob("*") for folder in FOLDERS))
    places = {path: path.relative_to(ROOT) for path in paths if path.suffix in SUFFIXES}
    return {place: read(path) for path, place in places.items() if not BUILT & set(place.parts)}


@pytest.fixture(scope="package")
def modules(sources):
    """Return the `Source` of each module of the product by its path."""
    return {path: found for path, found in sources.items() if path.parts[0] in FOLDERS[:3]}
