"""The bundled meshes; small pictures of all samples in one image, and their vertices' number."""

import json
from functools import cache
from pathlib import Path

MESHES = {
    "human_A.off": "A human, coarse",
    "human_B.off": "The same human, vertex by vertex, in another pose",
    "human_fine_A.off": "The first human with more triangles",
    "eight.off": "Two holes, and fields that go around them",
    "fandisk.off": "A mechanical part with sharp edges",
}
"""The bundled meshes, and a few words for each."""
PAIR = "human_A.off to human_B.off"
CORTEX = "Cortex, left to right"
PAIRS = {
    PAIR: "A pair of shapes: one pose is registered to the other",
    CORTEX: "A pair of cortices as spheres: sulcal depth of fsaverage5, with nilearn",
}
"""Surfaces A and B in one document, and a few words for each."""
WAVE = "A wave"
SEQUENCES = {WAVE: "A film of a spiral wave over a cortex, with nilearn"}
"""Frames on a surface, and a few words for each."""
POPULATION = "A population"
POPULATIONS = {POPULATION: "Eight subjects made from a human by known flows, and an odd one"}
"""Subjects on a template, as a table, and a few words for each."""
PICTURE_SOURCES = {POPULATION: "human_A.off"}
"""Samples that have the picture of another one."""
PICTURES = Path(__file__).with_name("samples.png")
"""Squares of `SIDE` pixels, `COLUMNS` in a row, in the order of the table."""
TABLE = Path(__file__).with_name("samples.json")
"""Vertices by the samples' names."""
SIDE = 96
COLUMNS = 6


@cache
def vertices() -> dict[str, int]:
    """Return how many vertices each sample has, by its name."""
    table: dict[str, int] = json.loads(TABLE.read_text(encoding="utf-8"))
    return table


def part(name: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return where a sample's picture is: its left upper and right lower corner, 0 to 1."""
    number, rows = list(vertices()).index(name), -(-len(vertices()) // COLUMNS)
    column, row = number % COLUMNS, number // COLUMNS
    return (column / COLUMNS, row / rows), ((column + 1) / COLUMNS, (row + 1) / rows)
