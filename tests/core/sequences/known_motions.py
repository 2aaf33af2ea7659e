"""Frames with a known motion."""

import numpy as np

from abfm import TriangleMesh
from abfm.calculus.operators import face_areas, gradient
from tests.shapes import icosphere

SPHERE = icosphere(3)


def rotating_pattern(mesh: TriangleMesh, angle: float, count: int, wave=None):
    """Return frames of a pattern that rotates about z on the unit sphere, and the exact field."""
    wave = wave or (lambda p: np.sin(3 * p[:, 0]) * np.cos(2 * p[:, 2]) + p[:, 1] ** 2)
    frames = []
    for t in range(count):
        c, s = np.cos(angle * t), np.sin(angle * t)
        back = mesh.vertices @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        frames.append(wave(back))
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return np.array(frames), angle * np.cross([0.0, 0.0, 1.0], centres)


def relative_field_error(mesh: TriangleMesh, found, expected, f) -> float:
    """Return the median relative error of a field over the faces where the function f is steep."""
    areas = face_areas(mesh)
    slopes = np.linalg.norm((gradient(mesh) @ f).reshape(len(areas), -1), axis=1)
    steep = slopes > 0.5 * np.sqrt(areas @ slopes**2 / areas.sum())
    errors = np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)
    return float(np.median(errors[steep]))


def coordinates(p):
    """Return three channels, which distinguish all motions of a sphere."""
    return p


def bumps(places, width=0.35, noise=0.05):
    """Return frames of a bump at angles on the equator, with noise; no bump if an angle is NaN."""
    x, y, _ = SPHERE.vertices.T
    frames = [np.exp(-0.5 * (np.hypot(x - np.cos(a), y - np.sin(a)) / width) ** 2) for a in places]
    scatter = np.random.default_rng(0).standard_normal((len(places), len(x)))
    return np.nan_to_num(frames) + noise * scatter
