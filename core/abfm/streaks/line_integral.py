"""Line integral convolution: noise smeared along a field, which shows its lines all over a surface.

Cabral and Leedom, Imaging Vector Fields Using Line Integral Convolution, SIGGRAPH 1993; streamlines
serve all texels that they meet, as in Stalling and Hege, Fast and Resolution Independent Line
Integral Convolution, SIGGRAPH 1995. Here they are walked on the surface itself, along the field
made continuous, and the noise belongs to places in space, so that streaks know nothing of the
texture's pieces nor of the mesh's.
"""

import numpy as np
from numpy.typing import ArrayLike

from abfm.calculus.operators import face_areas
from abfm.calculus.vector_fields import check_field, to_ambient, to_frame
from abfm.errors import ParameterError, one_line
from abfm.flow.continuous_flow import SmoothFlow, smooth_flow
from abfm.mesh import TriangleMesh
from abfm.numerics.real_numbers import real_numbers
from abfm.streaks import streamlines
from abfm.streaks.texels import Canvas, FloatImage, fill_gaps, fill_margins
from abfm.streaks.texture_atlas import TextureAtlas, texture_atlas
from abfm.types import FloatArray

GREY = 0.5
_STEP = 1.5  # of a walk, in grains
_STRIDE = 1.2  # between places where noise is read and texels are served, in texels; at most
_RIPPLES = 2
_LEAST_PARTS = 3  # of a step, at which noise is read
_CONTRAST = (2, 98)  # percentiles that become black and white
_CALM = 1e-9  # of the largest speed: below, there is no direction
_SLOWER = 0.98  # part of the area that is slower than where the contrast is full, if it fades
_LEAST_TEXELS = 1.5  # in a grain
_SAMPLE = 7  # every so many texels tell the contrast
_TILT = np.linalg.qr(np.array([[3.0, 1.0, 2.0], [-1.0, 4.0, 1.0], [1.0, -2.0, 5.0]]))[0]
_SHIFT = np.array([0.317, 0.541, 0.733])  # so that no plane of a mesh is one between cells of noise


def line_integral_convolution(
    mesh: TriangleMesh,
    velocity: ArrayLike,
    *,
    size: int = 2048,
    length: float = 0.1,
    width: float = 1 / 400,
    seed: int = 0,
    fade: bool = False,
    phase: ArrayLike | None = None,
) -> tuple[TextureAtlas, FloatImage]:
    """Return a grey texture with streaks along a field.

    Parameters
    ----------
    velocity : (F, 3) array
        Tangent vectors; only their directions matter, unless the contrast is to fade. A normal part
        is dropped.
    size : int
        Texels along a side of the texture.
    length : float
        How far noise is smeared, in units of the square root of the area.
    width : float
        Of the streaks, in the same units, but at least about two texels.
    seed : int
        Of the noise.
    fade : bool
        Whether the contrast is proportional to the speed of the continuous field: none where it is
        zero, and full from the speed on that is exceeded on a fiftieth of the area.
    phase : float or (P,) array, optional
        Pictures at phases rising from 0 to 1, where they start again, show streaks that move along
        the field, which are shorter than those of a single picture. Computing P of them at once is
        much faster than one by one.

    Returns
    -------
    atlas : TextureAtlas
    image : (size, size) or (P, size, size) array of float32
        From 0 to 1, row 0 at the bottom; grey (0.5) where there is no field and outside the
        triangles.

    Raises
    ------
    ParameterError
        If the field does not fit the mesh or is not finite, or a number is out of range.
    """
    field = check_field(mesh, velocity, "velocity")
    field = to_ambient(mesh, to_frame(mesh, field / (np.abs(field).max() or 1.0)))
    phases = real_numbers(0.0 if phase is None else phase, "phase")
    if phases.ndim > 1 or not phases.size or not np.isfinite(phases).all():
        raise ParameterError(
            f"phase is {one_line(phase, 60)}; expected a finite number or a list of them"
        )
    for name, value in (("length", length), ("width", width)):
        if not 0 < value <= 1:
            raise ParameterError(f"{name} is {value}; expected more than 0 and at most 1")
    if not isinstance(seed, int | np.integer):
        raise ParameterError(f"seed is {seed!r}; expected a whole number")
    atlas = texture_atlas(mesh, size)
    speeds = np.linalg.norm(field, axis=1)
    images = np.zeros((phases.size, size * size), dtype=np.float32)
    if speeds.any():
        owners = atlas.texel_faces.ravel()
        # of texels; some are finer
        spacing = mesh.length_scale / float(np.sqrt((owners >= 0).sum()))
        grain = max(width * mesh.length_scale, _LEAST_TEXELS * spacing)
        flow = smooth_flow(mesh, field, grain)
        places = mesh.vertices @ _TILT / grain + _SHIFT
        areas = face_areas(mesh) / grain**2
        canvas = Canvas(
            places, mesh.faces, areas, flow.neighbours, atlas.corners, owners, atlas.size
        )
        charts = _charts(places[mesh.faces], atlas.corners, flow)
        weights = _kernels(
            length * mesh.length_scale / (_STEP * grain), None if phase is None else phases.ravel()
        )
        parts = max(int(np.ceil(_STEP * grain / (_STRIDE * spacing))), _LEAST_PARTS)
        calm, done = _CALM * float(speeds.max()), np.zeros(len(owners), dtype=bool)
        lines = streamlines.Streamlines(flow, canvas, charts, _STEP, parts, calm, int(seed) % 2**63)
        streamlines.convolve(lines, weights, done, images)
        fill_gaps(canvas, done, images)
        dark, bright = np.percentile(images[0, done][::_SAMPLE], _CONTRAST)
        fill_margins(canvas, done, images)
        streamlines.sharpen(1 / max(bright - dark, 1e-12), images)
        if fade:
            fast = np.quantile(speeds, _SLOWER, weights=areas, method="inverted_cdf")
            streamlines.dim(canvas, flow, 1 / float(fast), images)
    images = images.reshape(*phases.shape, size, size)
    images += np.float32(GREY)
    return atlas, images


def _charts(places: FloatArray, texels: FloatArray, flow: SmoothFlow) -> FloatArray:
    """Return places in space and texture as ``a + b x + c y`` of those in frames, (F, 5, 3)."""
    corners = np.concatenate([places, texels], axis=2)
    return np.concatenate(
        [corners[:, 0, :, None], np.einsum("fiq,fik->fqk", corners, flow.gradients)], axis=2
    )


def _kernels(steps: float, phases: FloatArray | None) -> FloatArray:
    """Return weights (P, K) along a streamline, of equal norm: Hann's window, or Hann's ripples
    that move under it.

    With two ripples all phases are about as different from the next.
    """
    half = max(round(steps / 2), 1)
    along = np.pi * (np.arange(-half, half) + 0.5) / half
    weights = (1 + np.cos(along))[None]
    if phases is not None:
        weights = weights * (1 + np.cos(_RIPPLES * along + 2 * np.pi * phases[:, None]))
    return np.asarray(weights / np.linalg.norm(weights, axis=1, keepdims=True))
