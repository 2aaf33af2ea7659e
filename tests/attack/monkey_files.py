"""Files that the monkey opens: good ones three times as often as broken ones."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np

import abfm
from abfm_viewer.document.document import Document, Surface
from abfm_viewer.files.project import save_project
from tests.mesh_writers import off_text
from tests.shapes import ellipsoid, icosphere


def monkey_files(folder: Path) -> list[Path]:
    """Write them into a folder; the good ones come three times."""
    chance = random.Random(0)
    sphere, egg = icosphere(1), ellipsoid(2, 1.0, 0.8, 0.6)
    corners = np.array([[x, y, 0.1 * x * y] for x in range(5) for y in range(5)], dtype=float)
    quads = [5 * x + y for x in range(4) for y in range(4)]
    patch = np.array([f for q in quads for f in ((q, q + 5, q + 1), (q + 1, q + 5, q + 6))])
    good = [
        folder / name
        for name in ("sphere.off", "egg.off", "patch.off", "result.npz", "project.abfm")
    ]
    surfaces = [(sphere.vertices, sphere.faces), (egg.vertices, egg.faces), (corners, patch)]
    for path, (vertices, faces) in zip(good[:3], surfaces, strict=True):
        path.write_text(off_text(vertices, faces))
    f, g = (abfm.function(sphere, f"gaussian:vertex={vertex},width=0.3") for vertex in (1, 8))
    match = abfm.match(sphere, f, g, abfm.Parameters(iterations=5))
    match.save(good[3])
    save_project(good[4], Document((Surface(sphere, "sphere.off"),), time=0.5), {})
    bad = []
    for path in good:
        content = path.read_bytes()
        flipped = bytearray(content)
        for place in (chance.randrange(len(content)) for _ in range(20)):
            flipped[place] ^= 1 << chance.randrange(8)
        for word, changed in (
            ("cut", content[: len(content) // 2]),
            ("flipped", bytes(flipped)),
            ("empty", b""),
        ):
            bad.append(path.with_stem(f"{path.stem}-{word}"))
            bad[-1].write_bytes(changed)
    two = (
        np.vstack([sphere.vertices, sphere.vertices + 5]),
        np.vstack([sphere.faces, sphere.faces + 42]),
    )
    bad += [folder / "two.off", folder / "nothing.off", folder / "text.txt", folder / "folder.off"]
    bad[-4].write_text(off_text(*two))
    bad[-2].write_text("a text")
    bad[-1].mkdir()
    return [*good, *good, *good, *bad]
