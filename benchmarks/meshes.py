"""Meshes of the benchmarks: bundled, generated, and from given files."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from abfm import MeshError, ParameterError, TriangleMesh, load_mesh
from abfm.assets import asset_names, asset_path
from abfm.mesh.files import MESH_ENDINGS
from abfm.mesh.shapes import even_sphere, five_limbs, grid, torus
from benchmarks.common import Log

_BUMPS = 9


def given_meshes(paths: Sequence[Path], log: Log) -> dict[str, TriangleMesh]:
    """Read the given files, and all meshes of the given folders; return the meshes by name.

    The name is that of the file; in a folder, it is ``folder/name``. A refused mesh is read again
    with the options that the error suggests. Files that cannot be used are skipped. `log` prints
    the skipped files and all repairs.

    Raises
    ------
    ParameterError
        If two meshes have the same name, which identifies their problems.
    """
    found: dict[str, TriangleMesh] = {}
    for name, path in (each for given in paths for each in _files(given)):
        if name in found:
            raise ParameterError(
                f"two meshes have the name {name}, which identifies their problems; rename one"
            )
        try:
            found[name] = _repaired(path)
        except MeshError as error:
            log(f"skipped: {error}")
            continue
        for message in found[name].messages:
            log(f"{name}: {message}")
    return found


def _repaired(path: Path) -> TriangleMesh:
    try:
        return load_mesh(path)
    except MeshError as error:
        if not error.remedies:
            raise
        return load_mesh(path, **error.remedies[0].options)


def _files(given: Path) -> list[tuple[str, Path]]:
    if not os.path.isdir(given):  # Path.is_dir refuses some names
        return [(given.name, given)]
    files = sorted(path for path in given.iterdir() if path.name.lower().endswith(MESH_ENDINGS))
    return [(f"{given.resolve().name}/{path.name}", path) for path in files]


def bundled_meshes() -> dict[str, TriangleMesh]:
    """Return bundled and generated surfaces by name, closed and open, of 300 to 12,300 vertices."""
    ball, rough = even_sphere(5_000), even_sphere(8_000)
    rng = np.random.default_rng(_BUMPS)
    places = rng.normal(size=(_BUMPS, 3))
    places /= np.linalg.norm(places, axis=1)[:, None]
    heights = rng.uniform(-0.25, 0.5, _BUMPS)
    radius = 1 + np.exp(12 * (rough.vertices @ places.T - 1)) @ heights
    return {
        "sphere": even_sphere(12_000),
        "ellipsoid": TriangleMesh(ball.vertices * [1, 0.7, 0.45], ball.faces),
        "bumpy": TriangleMesh(rough.vertices * radius[:, None], rough.faces),
        "limbs": five_limbs(5_000),
        "torus": torus(120, 50, r=0.4),
        "square": _square(60),
        **{name: load_mesh(asset_path(name)) for name in asset_names() if name.endswith(".off")},
    }


def three_meshes() -> dict[str, TriangleMesh]:
    """Return three surfaces, round, bumpy and with limbs, of 5,000 to 8,000 vertices."""
    meshes = bundled_meshes()
    return {name: meshes[name] for name in ("ellipsoid", "bumpy", "limbs")}


def _square(n: int) -> TriangleMesh:
    """Return a unit square, which has a boundary, with n x n cells of smoothly varying size."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    x, y = (
        x + 0.08 * np.sin(np.pi * x) * np.cos(2 * y + 0.3),
        y + 0.06 * np.sin(np.pi * y) * np.sin(3 * x + 0.5),
    )
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    return TriangleMesh(vertices, grid(n, n, around=False)[0])
