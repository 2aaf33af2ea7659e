"""The samples of the menu: names, descriptions, thumbnails and numbers of vertices."""

import json
from functools import cache
from pathlib import Path

MESHES = {
    "human_A.off": "A human, coarse",
    "human_B.off": "The same vertices in another pose",
    "human_fine_A.off": "The first human with more triangles",
    "eight.off": "Two holes, and fields that go around them",
    "fandisk.off": "A mechanical part with sharp edges",
}
"""Bundled meshes and their descriptions."""
PAIR = "human_A.off to human_B.off"
CORTEX = "Cortex, left to right"
PAIRS = {
    PAIR: "Two surfaces: register one pose to the other",
    CORTEX: "Two surfaces: sulcal depth on spheres (nilearn)",
}
"""Pairs of surfaces A and B and their descriptions."""
WAVE = "A wave"
SEQUENCES = {WAVE: "Frames of a spiral wave over a cortex (nilearn)"}
"""Sequences of frames on a surface and their descriptions."""
POPULATION = "A population"
POPULATIONS = {POPULATION: "A table: eight subjects and an outlier"}
"""Populations registered to a template, opened as a table, and their descriptions."""
PICTURE_SOURCES = {POPULATION: "human_A.off"}
"""Samples without a thumbnail, and the sample whose thumbnail they use."""
PICTURES = Path(__file__).with_name("samples.png")
"""Thumbnails of `SIDE` by `SIDE` pixels, `COLUMNS` in each row, in the order of the table."""
TABLE = Path(__file__).with_name("samples.json")
"""JSON object that maps the name of a sample to its number of vertices."""
SIDE = 96
COLUMNS = 6


@cache
def vertices() -> dict[str, int]:
    table: dict[str, int] = json.loads(TABLE.read_text(encoding="utf-8"))
    return table


def thumbnail_corners(name: str) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the top left and bottom right of a thumbnail, as fractions of the image `PICTURES`."""
    number, rows = list(vertices()).index(name), -(-len(vertices()) // COLUMNS)
    column, row = number % COLUMNS, number // COLUMNS
    return (column / COLUMNS, row / rows), ((column + 1) / COLUMNS, (row + 1) / rows)
