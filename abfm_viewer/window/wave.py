"""The sample of a film: a wave whose velocity is known."""

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
STEP = 0.04
"""How many there are, and seconds between them."""
# radians per second: about an axis, and of that about another one
_TURN = 2.2
_WANDER = 1.3
# of a spiral about the axis
_ARMS = 2
_TWIST = 2.5
_SIGMA = 0.1
_DRIFT = 0.8  # of sqrt(area) per second, on the mesh with handles


def turning_wave(places: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a spiral wave (T, V) at unit vectors (V, 3) of a sphere, which turns rigidly, and the
    vectors (T, 3) about which it does.
    """
    frames, axes = [], []
    x_axis, _, z_axis = np.eye(3)
    for time in times.tolist():
        wander, turn = rotation(z_axis, _WANDER * time), rotation(x_axis, _TURN * time)
        x, y, z = (places @ wander @ turn).T  # turned back
        across = np.hypot(y, z)
        frames.append(across * np.cos(_ARMS * np.arctan2(z, y) + _TWIST * x))
        axes.append([0, 0, _WANDER] + wander @ [_TURN, 0, 0])
    return np.array(frames), np.array(axes)


def drifting_wave(mesh: TriangleMesh, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a wave (T, V) that is carried around handles by a field without divergence and curl,
    and that field (F, 3).
    """
    areas = abfm.calculus.face_areas(mesh)
    given = np.cross([0.0, 1.0, 0.0], mesh.vertices[mesh.faces].mean(axis=1))
    harmonic = abfm.calculus.helmholtz_hodge(mesh, given)[2]
    usual = np.sqrt(areas @ (harmonic**2).sum(axis=1) / areas.sum())
    field = harmonic * (_DRIFT * mesh.length_scale / usual)
    x = mesh.vertices[:, 0] / mesh.length_scale
    return abfm.Flow(mesh, field, float(times[-1])).push(np.sin(9 * x), times), field


def fsaverage5() -> Path | None:
    """Return the folder of the surfaces that nilearn brings; None without it."""
    found = find_spec("nilearn")
    if found is None or found.origin is None:
        return None
    return Path(found.origin).parent / "datasets" / "data" / "fsaverage5"


def wave_document(view: View) -> SequenceDocument:
    """Return a wave on the left cortex of fsaverage5, where nilearn brings it, else on a bundled
    mesh.
    """
    times = STEP * np.arange(float(FRAMES))
    if (folder := fsaverage5()) is not None:
        mesh, sphere = (load_mesh(folder / f"{name}_left.gii.gz") for name in ("infl", "sphere"))
        places = sphere.vertices / np.linalg.norm(sphere.vertices, axis=1)[:, None]
        surface, frames = Surface(mesh, "left cortex"), turning_wave(places, times)[0]
    else:
        surface = Surface(load_mesh(asset_path("eight.off")), "eight.off")
        frames = drifting_wave(surface.mesh, times)[0]
    from abfm.sequences.frames import check_frames  # with all that it loads

    sequence = FrameSequence("wave", check_frames(surface.mesh, frames, times, None, None))
    # met at once: a choice by held-out data takes some ten seconds
    settings = SequenceSettings(alpha=1.0, sigma=_SIGMA, order=1)
    return SequenceDocument(
        (surface,), sequence, settings=settings, time=float(times[0]), view=view
    )
