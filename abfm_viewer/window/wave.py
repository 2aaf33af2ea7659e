"""The sample of a sequence of frames: a wave with known velocity."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np

import abfm
from abfm import TriangleMesh, load_mesh
from abfm.assets import asset_path
from abfm.types import FloatArray
from abfm_viewer.document.document import Surface, View
from abfm_viewer.document.frame_sequence import FrameSequence, SequenceSettings
from abfm_viewer.document.kinds import SequenceDocument
from abfm_viewer.scene.slots import rotation

FRAMES = 24
STEP = 0.04  # seconds between two frames
_TURN = 2.2  # rotation about the axis of the spiral, in radians per second
_WANDER = 1.3  # rotation of this axis about another one, in radians per second
# shape of the spiral: number of arms, twist, and sigma of the match
_ARMS = 2
_TWIST = 2.5
_SIGMA = 0.1
_DRIFT = 0.8  # of sqrt(area) per second, on the mesh with handles


def turning_wave(places: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a rigidly rotating spiral wave (T, V) and its angular velocities (T, 3).

    ``places`` (V, 3) are points of the unit sphere.
    """
    frames, axes = [], []
    x_axis, _, z_axis = np.eye(3)
    for time in times.tolist():
        wander, turn = rotation(z_axis, _WANDER * time), rotation(x_axis, _TURN * time)
        x, y, z = (places @ wander @ turn).T  # inverse rotation
        across = np.hypot(y, z)
        frames.append(across * np.cos(_ARMS * np.arctan2(z, y) + _TWIST * x))
        axes.append([0, 0, _WANDER] + wander @ [_TURN, 0, 0])
    return np.array(frames), np.array(axes)


def drifting_wave(mesh: TriangleMesh, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a wave (T, V) advected around handles by a harmonic field, and that field (F, 3)."""
    areas = abfm.calculus.face_areas(mesh)
    rotation_field = np.cross([0.0, 1.0, 0.0], mesh.vertices[mesh.faces].mean(axis=1))
    harmonic = abfm.calculus.helmholtz_hodge(mesh, rotation_field)[2]
    rms = np.sqrt(areas @ (harmonic**2).sum(axis=1) / areas.sum())
    field = harmonic * (_DRIFT * mesh.length_scale / rms)
    x = mesh.vertices[:, 0] / mesh.length_scale
    return abfm.Flow(mesh, field, float(times[-1])).push(np.sin(9 * x), times), field


def fsaverage5() -> Path | None:
    found = find_spec("nilearn")
    if found is None or found.origin is None:
        return None
    return Path(found.origin).parent / "datasets" / "data" / "fsaverage5"


def wave_document(view: View) -> SequenceDocument:
    """Return a wave on the left cortex of fsaverage5; without nilearn, on a bundled mesh."""
    times = STEP * np.arange(float(FRAMES))
    if (folder := fsaverage5()) is not None:
        mesh, sphere = (load_mesh(folder / f"{name}_left.gii.gz") for name in ("infl", "sphere"))
        places = sphere.vertices / np.linalg.norm(sphere.vertices, axis=1)[:, None]
        surface, frames = Surface(mesh, "left cortex"), turning_wave(places, times)[0]
    else:
        surface = Surface(load_mesh(asset_path("eight.off")), "eight.off")
        frames = drifting_wave(surface.mesh, times)[0]
    from abfm.sequences.frames import check_frames  # imported late: it loads slowly

    sequence = FrameSequence("wave", check_frames(surface.mesh, frames, times, None, None))
    # fixed settings, because choosing them by held-out data takes about ten seconds
    settings = SequenceSettings(alpha=1.0, sigma=_SIGMA, order=1)
    return SequenceDocument(
        (surface,), sequence, settings=settings, time=float(times[0]), view=view
    )
