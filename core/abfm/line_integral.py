"""Line integral convolution: noise smeared along a field, which shows its lines all over a surface.

Cabral and Leedom, Imaging Vector Fields Using Line Integral Convolution, SIGGRAPH 1993; streamlines serve all texels
that they meet, as in Stalling and Hege, Fast and Resolution Independent Line Integral Convolution, SIGGRAPH 1995. Here
they are walked on the surface itself, and the noise belongs to places in space, so that streaks know nothing of the
texture's pieces.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from abfm import tracing
from abfm.errors import ParameterError
from abfm.face_flow import FaceFlow, face_flow
from abfm.mesh import FloatArray, TriangleMesh
from abfm.operators import averaging
from abfm.texels import Canvas, FloatImage, fill_gaps, fill_margins
from abfm.texture_atlas import TextureAtlas, texture_atlas
from abfm.vector_fields import check_field, to_ambient, to_frame

GREY = 0.5
_GRAIN = 1.5  # size of the noise in texels
_STEP = 0.75  # between places where it is read, in grains; at most
_STRIDE = 1.4  # and at most in texels, which are finer than texel_length where triangles are tiny
_REACH = 45  # grains to each side at which a streamline serves other texels
_CONTRAST = (2, 98)  # percentiles that become black and white
_CALM = 1e-9  # of the largest speed: below, there is no direction


def line_integral_convolution(
    mesh: TriangleMesh,
    velocity: ArrayLike,
    *,
    size: int = 2048,
    length: float = 0.08,
    seed: int = 0,
    fade: bool = False,
    phase: ArrayLike = 0.0,
) -> tuple[TextureAtlas, FloatImage]:
    """A grey texture with streaks along a field.

    Parameters
    ----------
    velocity : (F, 3) array
        Tangent vectors; only their directions matter, unless the contrast is to fade. A normal part is dropped.
    size : int
        Texels along a side of the texture: streaks are one to two texels wide.
    length : float
        How far noise is smeared, in units of the square root of the area.
    seed : int
        Of the noise.
    fade : bool
        Whether the contrast falls with the speed, to nothing where the field is zero.
    phase : float or (P,) array
        Pictures at phases rising from 0 to 1, where they start again, show streaks that move along the field.
        Computing P of them at once is much faster than one by one.

    Returns
    -------
    atlas : TextureAtlas
    image : (size, size) or (P, size, size) array of float32
        From 0 to 1, row 0 at the bottom; grey (0.5) where there is no field and outside the triangles.

    Raises
    ------
    ParameterError
        If the field does not fit the mesh or is not finite, or a number is out of range.
    """
    field = check_field(mesh, velocity, "velocity")
    field = to_ambient(mesh, to_frame(mesh, field / (np.abs(field).max() or 1.0)))
    phases = np.asarray(phase, dtype=np.float64)
    if phases.ndim > 1 or not phases.size or not np.isfinite(phases).all():
        raise ParameterError(f"phase is {phase!r}; expected a finite number or a list of them")
    if not (np.isfinite(length) and 0 < length <= 1):
        raise ParameterError(f"length is {length}; expected more than 0 and at most 1")
    if not isinstance(seed, int | np.integer):
        raise ParameterError(f"seed is {seed!r}; expected a whole number")
    atlas = texture_atlas(mesh, size)
    speeds = np.linalg.norm(field, axis=1)
    images = np.zeros((phases.size, size * size), dtype=np.float32)
    if speeds.any():
        moving = speeds > _CALM * speeds.max()
        headings = np.where(moving, 1 / np.where(moving, speeds, 1), 0)[:, None] * field
        _convolve(mesh, atlas, headings, length * mesh.length_scale, phases.ravel(), int(seed) % 2**63, images)
    images = images.reshape(*phases.shape, size, size)
    if fade and speeds.any():
        images *= atlas.image(averaging(mesh) @ (speeds / speeds.max()))
    images += np.float32(GREY)
    return atlas, np.clip(images, 0, 1, out=images)


def _convolve(
    mesh: TriangleMesh,
    atlas: TextureAtlas,
    headings: FloatArray,
    length: float,
    phases: FloatArray,
    seed: int,
    images: FloatImage,
) -> None:
    """Fill images (P, texels) with contrast from about -0.5 to 0.5."""
    owners = atlas.texel_faces.ravel()
    grain = _GRAIN * atlas.texel_length
    spacing = mesh.length_scale / float(np.sqrt((owners >= 0).sum()))
    step = min(_STEP, _STRIDE * spacing / grain)
    weights = _periodic_kernel(length / (grain * step), phases)
    ahead = face_flow(mesh, grain * headings)
    back = FaceFlow(-ahead.rates, -ahead.along, ahead.areas, ahead.neighbours)
    canvas = Canvas(mesh.vertices / grain, mesh.faces, ahead.areas, ahead.neighbours, atlas.corners, owners, atlas.size)
    done = np.zeros(len(owners), dtype=bool)
    tracing.convolve(canvas, ahead, back, weights, round(_REACH / step), step, seed, done, images)
    fill_gaps(canvas, done, images)
    dark, bright = np.percentile(images[0, done], _CONTRAST)
    fill_margins(canvas, done, images)
    images /= max(bright - dark, 1e-12)


def _periodic_kernel(steps: float, phases: FloatArray) -> FloatArray:
    """Weights (P, K) along a streamline: Hann's ripple moving under Hann's window, of equal norm at all phases."""
    half = max(round(steps / 2), 1)
    along = np.arange(-half, half + 1) / (half + 1)
    window = 1 + np.cos(np.pi * along)
    ripple = 1 + np.cos(np.pi * along + 2 * np.pi * phases[:, None])
    weights = window * ripple
    normalized: FloatArray = weights / np.linalg.norm(weights, axis=1, keepdims=True)
    return normalized
