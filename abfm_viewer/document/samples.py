"""What the app brings along: meshes, and the paper's figures."""

from typing import NamedTuple

from abfm.parameters import FIGURES, TITLES
from abfm_viewer.document.verdict_words import capital

MESHES = {
    "human_A.off": "A human, coarse",
    "human_B.off": "The same human, vertex by vertex, in another pose",
    "human_fine_A.off": "The first human with more triangles",
    "eight.off": "Two holes, and fields that go around them",
    "fandisk.off": "A mechanical part with sharp edges",
}
"""The bundled meshes, and a few words for each."""


class Sample(NamedTuple):
    """A mesh, or a figure (0 for none), by its name in the menu."""

    name: str
    about: str
    figure: int = 0


SAMPLES = tuple(Sample(name, about) for name, about in MESHES.items())
FIGURE_SAMPLES = tuple(Sample(f"Figure {n}", capital(TITLES[n]), n) for n in FIGURES)
