"""Films whose motion is known."""

import numpy as np

from abfm import TriangleMesh
from abfm.calculus.operators import face_areas, gradient
from tests.shapes import icosphere

SPHERE = icosphere(3)


def turning(mesh: TriangleMesh, angle: float, count: int, wave=None):
    """A pattern on the unit sphere that turns about z: frames, and the field of each interval."""
    wave = wave or (lambda p: np.sin(3 * p[:, 0]) * np.cos(2 * p[:, 2]) + p[:, 1] ** 2)
    frames = []
    for t in range(count):
        c, s = np.cos(angle * t), np.sin(angle * t)
        back = mesh.vertices @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        frames.append(wave(back))
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return np.array(frames), angle * np.cross([0.0, 0.0, 1.0], centres)


def off(mesh: TriangleMesh, found, wanted, f) -> float:
    """Median relative error of a field where the function is not flat."""
    areas = face_areas(mesh)
    slopes = np.linalg.norm((gradient(mesh) @ f).reshape(len(areas), -1), axis=1)
    told = slopes > 0.5 * np.sqrt(areas @ slopes**2 / areas.sum())
    apart = np.linalg.norm(found - wanted, axis=1) / np.linalg.norm(wanted, axis=1)
    return float(np.median(apart[told]))


def coordinates(p):
    """Three channels, which tell any motion of a sphere apart."""
    return p


def bumps(places, width=0.35, noise=0.05):
    """Frames of a bump at these angles on the equator, with noise; none where that is NaN."""
    x, y, _ = SPHERE.vertices.T
    frames = [np.exp(-0.5 * (np.hypot(x - np.cos(a), y - np.sin(a)) / width) ** 2) for a in places]
    scatter = np.random.default_rng(0).standard_normal((len(places), len(x)))
    return np.nan_to_num(frames) + noise * scatter
