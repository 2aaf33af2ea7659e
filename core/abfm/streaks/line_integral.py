"""Line integral convolution: noise smeared along a field shows its flow lines on a surface.

The method is that of Cabral and Leedom, Imaging Vector Fields Using Line Integral Convolution,
SIGGRAPH 1993. Each streamline provides the values of all texels that it meets, as in Stalling and
Hege, Fast and Resolution Independent Line Integral Convolution, SIGGRAPH 1995. Here streamlines are
traced on the surface itself, along the field made continuous. The noise is a function of the
position in space.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from abfm.calculus.operators import face_areas
from abfm.calculus.vector_fields import check_field, to_ambient, to_frame
from abfm.errors import ParameterError, one_line
from abfm.flow.continuous_flow import (
    Face,
    SmoothFlow,
    Walker,
    midpoint,
    smooth_flow,
    vector_at,
    walk_straight,
)
from abfm.mesh import TriangleMesh
from abfm.numerics.kernels import kernel
from abfm.numerics.real_numbers import real_numbers
from abfm.streaks.texture_atlas import TextureAtlas, texture_atlas
from abfm.types import FloatArray, IndexArray

FloatImage = NDArray[np.float32]
GREY = 0.5
_STEP = 1.5  # step of a streamline, in grains (widths of a noise cell)
# largest distance, in texels, between points of a streamline at which a texel gets its value
_STRIDE = 1.2
_RIPPLES = 2
_PARTS_MIN = 3  # least number of parts of a step; noise is read at each
_CONTRAST = (2, 98)  # percentiles that become black and white
_SPEED_SHARE_MIN = 1e-9  # below this share of the largest speed, a field has no direction
# share of the area that is slower than the speed of full contrast, if the contrast fades
_SLOW_AREA_SHARE = 0.98
_GRAIN_TEXELS_MIN = 1.5
_CONTRAST_STRIDE = 7  # texels between the samples that determine the contrast
_ROUNDING = 1e-9
# number of steps by which a streamline grows at once, and how often it may grow
_CHUNK = 4
_CHUNKS = 12
_NEW_TEXEL = 255  # marks texels that no streamline has met
_NEW_TEXEL_PERIOD = 8  # a streamline grows while one in so many texels is new
_TILT = np.linalg.qr(np.array([[3.0, 1.0, 2.0], [-1.0, 4.0, 1.0], [1.0, -2.0, 5.0]]))[0]
_SHIFT = np.array([0.317, 0.541, 0.733])  # keeps boundaries of noise cells off planes of the mesh


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
    """Return a grey texture of ``size`` texels a side with streaks along a field.

    Parameters
    ----------
    velocity : (F, 3) array
        Tangent vectors. Only their directions matter, unless ``fade`` is true.
    length : float
        Length over which noise is smeared, in units of the square root of the area.
    width : float
        Width of the streaks, in the same units, but at least about two texels.
    fade : bool
        Whether the contrast is proportional to the speed. The contrast is full where the speed is
        among the highest 2% of the area.
    phase : float or (P,) array, optional
        Images at phases rising from 0 to 1, where they repeat, show streaks that move along the
        field. Computing P images at once is much faster than one by one.

    Returns
    -------
    atlas : TextureAtlas
    image : (size, size) or (P, size, size) array of float32
        Values from 0 to 1 with row 0 at the bottom; grey (0.5) where there is no field or triangle.
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
        raise ParameterError(f"seed is {seed!r}; expected an integer")
    atlas = texture_atlas(mesh, size)
    speeds = np.linalg.norm(field, axis=1)
    images = np.zeros((phases.size, size * size), dtype=np.float32)
    if speeds.any():
        owners, scale = atlas.texel_faces.ravel(), mesh.length_scale
        spacing = scale / float(np.sqrt((owners >= 0).sum()))  # mean distance of texels
        grain = max(width * scale, _GRAIN_TEXELS_MIN * spacing)
        flow, areas = smooth_flow(mesh, field, grain), face_areas(mesh) / grain**2
        places = mesh.vertices @ _TILT / grain + _SHIFT
        # positions in space and texture as functions ``a + b x + c y`` of (x, y) in frames of faces
        corners = np.concatenate([places[mesh.faces], atlas.corners], axis=2)
        slopes = np.einsum("fiq,fik->fqk", corners, flow.gradients)
        charts = np.concatenate([corners[:, 0, :, None], slopes], axis=2)
        weights = _window(
            length * scale / (_STEP * grain), None if phase is None else phases.ravel()
        )
        parts = max(int(np.ceil(_STEP * grain / (_STRIDE * spacing))), _PARTS_MIN)
        speed_min, done = _SPEED_SHARE_MIN * float(speeds.max()), np.zeros(len(owners), dtype=bool)
        canvas = flow, charts, atlas.corners, owners, size
        lines = Streamlines(*canvas, _STEP, parts, speed_min, int(seed) % 2**63)
        convolve(lines, weights, done, images)
        fill_gaps(lines, done, images)
        dark, bright = np.percentile(images[0, done][::_CONTRAST_STRIDE], _CONTRAST)
        fill_margins(lines, done, images)
        sharpen(1 / max(bright - dark, 1e-12), images)
        if fade:
            fast = np.quantile(speeds, _SLOW_AREA_SHARE, weights=areas, method="inverted_cdf")
            dim(lines, 1 / float(fast), images)
    images = images.reshape(*phases.shape, size, size)
    images += np.float32(GREY)
    return atlas, images


def _window(steps: float, phases: FloatArray | None) -> FloatArray:
    """Return weights (P, K) of the convolution, one row of norm 1 for each phase.

    They are Hann's window or, if there are phases, ripples that move under this window.
    """
    half = max(round(steps / 2), 1)
    along = np.pi * (np.arange(-half, half) + 0.5) / half
    weights = (1 + np.cos(along))[None]
    if phases is not None:
        weights = weights * (1 + np.cos(_RIPPLES * along + 2 * np.pi * phases[:, None]))
    return np.asarray(weights / np.linalg.norm(weights, axis=1, keepdims=True))


class Streamlines(NamedTuple):
    """The data of all streamlines: a field, the step along it, and the texture of the surface."""

    flow: SmoothFlow
    # (F, 5, 3), coefficients ``a + b x + c y`` of a place (x, y) of a face: three coordinates in
    # space, column and row in texels
    charts: FloatArray
    corners: FloatArray  # (F, 3, 2), column and row of the corners of each face, in texels
    owners: IndexArray  # (texels,), face of each texel, row by row, or -1
    size: int  # texels in a row
    step: float
    parts: int  # parts of a step, after each of which a texel gets a value
    calm: float  # largest speed without a direction
    seed: int  # seed of the noise


class Track(NamedTuple):
    """The record of one streamline: noise and texels along it.

    It has ``n`` steps of ``m`` parts in each direction. The arrays begin at the backward end of the
    streamline; its start is in their middle.
    """

    noise: FloatArray  # (2 n,), mean noise over each step
    texels: IndexArray  # (2 n m + 1,), after each part of a step; -1 beyond the end
    misses: IndexArray  # (2 n m + 1,) of uint8, squared distances from texel centres, 1 to 201
    place: FloatArray  # (3,), current position in space
    onward: FloatArray  # (3,), last part of a step, which continues the noise beyond the end


@kernel
def direction(flow: SmoothFlow, walker: Walker, step: float, calm: float) -> Walker:
    """Set a walker's vector to its next step along the field.

    The vector becomes zero where the speed is at most ``calm`` or the field turns back.
    """
    f, x, y, before_x, before_y = walker
    u, v = vector_at(flow, f, x, y)
    speed = math.copysign(math.sqrt(u * u + v * v), step)
    if abs(speed) <= calm or (before_x * u + before_y * v) * speed < 0.0:
        return Walker(f, x, y, 0.0, 0.0)
    length = abs(step) / speed
    first = Walker(f, x, y, u * length, v * length)
    g, _, _, r, s = midpoint(flow, first, 1.0, False)
    speed = math.sqrt(r * r + s * s)
    if g < 0 or speed <= calm:
        return first
    length = step / speed
    if (first.u * r + first.v * s) * length <= 0.0:
        return Walker(f, x, y, 0.0, 0.0)
    return Walker(f, x, y, r * length, s * length)


@kernel
def follow(
    lines: Streamlines, walker: Walker, ahead: int, steps: tuple[int, int], track: Track
) -> Walker:
    """Follow a streamline for some steps, ahead (1) or back (-1), and record them in ``track``.

    Beyond its end the noise continues straight in space, so that all streamlines have equally much.
    """
    flow, charts, size, parts = lines.flow, lines.charts, lines.size, lines.parts
    place, step, calm = track.place, ahead * lines.step, lines.calm
    middle = track.noise.size // 2
    for j in range(steps[0], steps[1]):
        if walker.face >= 0:
            f, x, y, u, v = direction(flow, walker, step, calm)
            u, v = u / parts, v / parts
            if u == 0.0 and v == 0.0:
                walker = Walker(-1, x, y, u, v)
            else:
                walker = Walker(f, x, y, u, v)
                for k in range(3):
                    track.onward[k] = u * charts[f, k, 1] + v * charts[f, k, 2]
        at = (middle + ahead * j) * parts
        total = 0.0
        for _ in range(parts):
            at += ahead
            if walker.face >= 0:
                walker = walk_straight(flow, walker)
            if walker.face >= 0:
                f, x, y, _, _ = walker
                column = charts[f, 3, 0] + x * charts[f, 3, 1] + y * charts[f, 3, 2]
                row = charts[f, 4, 0] + x * charts[f, 4, 1] + y * charts[f, 4, 2]
                track.texels[at] = size * int(row) + int(column)
                off = (column - int(column) - 0.5) ** 2 + (row - int(row) - 0.5) ** 2
                track.misses[at] = np.uint8(1.0 + 400.0 * off)
                put(charts, f, x, y, place)
            else:
                track.texels[at] = -1
                for k in range(3):
                    place[k] += track.onward[k]
            total += hashed(place, lines.seed)
        track.noise[middle + j if ahead > 0 else middle - 1 - j] = total / parts
    return walker


@kernel
def hashed(place: FloatArray, seed: int) -> float:
    """Return the noise at a position (3,) in space, a random number from -1 to 1.

    It is constant in each cube of side 1.
    """
    h = (np.uint64(seed) + np.uint64(1)) * np.uint64(0xD1B54A32D192ED03)
    h ^= h >> np.uint64(32)
    for k in range(3):
        h = (h ^ np.uint64(math.floor(place[k]))) * np.uint64(0x9E3779B97F4A7C15)
        h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    return float(np.int64(h)) * 2.0**-63


@kernel
def put(charts: FloatArray, f: Face, x: float, y: float, place: FloatArray) -> None:
    """Write to ``place`` (3,) the position in space of a point (x, y) in a face's local frame."""
    for k in range(3):
        place[k] = charts[f, k, 0] + x * charts[f, k, 1] + y * charts[f, k, 2]


@kernel
def place_of(lines: Streamlines, f: Face, b: FloatArray) -> tuple[float, float]:
    """Return the coordinates in the local frame of face ``f`` of a point with weights ``b``."""
    g = lines.flow.gradients
    area = g[f, 1, 0] * g[f, 2, 1] - g[f, 1, 1] * g[f, 2, 0]
    x, y = b[1] * g[f, 2, 1] - b[2] * g[f, 1, 1], b[2] * g[f, 1, 0] - b[1] * g[f, 2, 0]
    return x / area, y / area


@kernel
def smeared(weights: FloatArray, picture: int, noise: FloatArray, start: int) -> float:
    """Return the sum of noise from index ``start`` on, times the weights of one image."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    count = weights.shape[1]
    whole = (count // 4) * 4
    for k in range(0, whole, 4):
        a += weights[picture, k] * noise[start + k]
        b += weights[picture, k + 1] * noise[start + k + 1]
        c += weights[picture, k + 2] * noise[start + k + 2]
        d += weights[picture, k + 3] * noise[start + k + 3]
    for k in range(whole, count):
        a += weights[picture, k] * noise[start + k]
    return a + b + c + d


@kernel
def convolve(lines: Streamlines, weights: FloatArray, done: IndexArray, images: FloatImage) -> None:
    """Convolve noise along streamlines, with ``weights`` (P, K), into ``images`` (P, texels).

    The convolution fills the texels with the centre in their face, and sets ``done`` (texels,) for
    them. A texel gets the value of the streamline nearest to its centre. A streamline grows while
    enough of the texels that it meets are new.
    """
    half = weights.shape[1] // 2
    most = half + _CHUNK * _CHUNKS
    middle, nodes = most * lines.parts, 2 * most * lines.parts + 1
    texels, misses = np.empty(nodes, dtype=np.int64), np.empty(nodes, dtype=np.uint8)
    track = Track(np.empty(2 * most), texels, misses, np.empty(3), np.empty(3))
    values, reach = np.empty((weights.shape[0], 2 * most + 1)), np.empty(2, dtype=np.int64)
    nearest, b = np.empty(done.size, dtype=np.uint8), np.empty(3)
    for texel in range(done.size):
        f = lines.owners[texel]
        inside = f >= 0 and weigh_texel(lines, texel, b)
        done[texel] = inside and not lines.flow.vectors[f].any()  # there is no field here
        nearest[texel] = _NEW_TEXEL if inside and not done[texel] else 0
    for texel in range(done.size):
        if nearest[texel] != _NEW_TEXEL or between_known(lines, nearest, texel):
            continue
        f = lines.owners[texel]
        weigh_texel(lines, texel, b)
        x, y = place_of(lines, f, b)
        u, v = vector_at(lines.flow, f, x, y)
        if u * u + v * v <= lines.calm * lines.calm:
            nearest[texel], done[texel] = 0, True
            continue
        track.texels[middle], track.misses[middle] = texel, 1
        for side in range(2):
            put(lines.charts, f, x, y, track.place)
            start = Walker(np.int64(f), x, y, 0.0, 0.0)
            reach[side] = grow(lines, start, 1 - 2 * side, (half, most), (track, nearest))
        for i in range(most - reach[1], most + reach[0] + 1):
            for picture in range(weights.shape[0]):
                values[picture, i] = smeared(weights, picture, track.noise, i - half)
        first, last = middle - reach[1] * lines.parts, middle + reach[0] * lines.parts
        serve((first, last, lines.parts), track, nearest, values, images)
    for texel in range(done.size):
        done[texel] = done[texel] or 0 < nearest[texel] < _NEW_TEXEL


@kernel
def grow(
    lines: Streamlines,
    walker: Walker,
    ahead: int,
    lengths: tuple[int, int],
    met: tuple[Track, IndexArray],
) -> int:
    """Extend a streamline to one side by half the window, and further while it meets new texels.

    Return the number of steps at which the complete window has noise.
    """
    half, most = lengths
    track, nearest = met
    known, steps = 0, _CHUNK
    while known < half + steps:
        walker = follow(lines, walker, ahead, (known, half + steps), track)
        known = half + steps
        middle, new = (track.noise.size // 2) * lines.parts, 0
        for part in range((steps - _CHUNK) * lines.parts + 1, steps * lines.parts + 1):
            texel = track.texels[middle + ahead * part]
            if texel >= 0 and nearest[texel] == _NEW_TEXEL:
                new += 1
        if known < most and _NEW_TEXEL_PERIOD * new >= _CHUNK * lines.parts:
            steps += _CHUNK
    return steps


@kernel
def serve(
    nodes: tuple[int, int, int],
    track: Track,
    nearest: IndexArray,
    values: FloatArray,
    images: FloatImage,
) -> None:
    """Write the values along a streamline to the texels to which it is the nearest so far.

    ``nodes`` has the first and the last node of its track, and the number of parts of a step.
    """
    first, last, parts = nodes
    for i in range(first, last + 1):
        target = track.texels[i]
        if target < 0 or track.misses[i] >= nearest[target]:
            continue
        nearest[target] = track.misses[i]
        before, share = i // parts, (i % parts) / parts
        after = before + (1 if share > 0.0 else 0)
        for picture in range(values.shape[0]):
            low, high = values[picture, before], values[picture, after]
            images[picture, target] = (1.0 - share) * low + share * high


@kernel
def sharpen(factor: float, images: FloatImage) -> None:
    """Multiply images (P, texels) by ``factor``, clip, and apply a sine: -0.5 to 0.5."""
    for picture in range(images.shape[0]):
        for texel in range(images.shape[1]):
            share = min(max(images[picture, texel] * factor, -0.5), 0.5)
            images[picture, texel] = 0.5 * math.sin(math.pi * share)


@kernel
def dim(lines: Streamlines, factor: float, images: FloatImage) -> None:
    """Multiply the texels of ``images`` (P, texels) by ``factor`` times the speed, at most by 1."""
    b = np.empty(3)
    for texel in range(lines.owners.size):
        f = lines.owners[texel]
        if f >= 0:
            weigh_texel(lines, texel, b)
            x, y = place_of(lines, f, b)
            u, v = vector_at(lines.flow, f, x, y)
            share = min(factor * math.sqrt(u * u + v * v), 1.0)
            for picture in range(images.shape[0]):
                images[picture, texel] *= share


@kernel
def weigh_texel(lines: Streamlines, texel: int, b: FloatArray) -> bool:
    """Compute the barycentric weights ``b`` (3,) of a texel's centre in the texel's face.

    Return whether the centre is inside the face.
    """
    f = lines.owners[texel]
    corners = lines.corners[f]
    u0, u1 = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1]
    v0, v1 = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1]
    p0, p1 = texel % lines.size + 0.5 - corners[0, 0], texel // lines.size + 0.5 - corners[0, 1]
    area = u0 * v1 - u1 * v0
    b[1] = (p0 * v1 - p1 * v0) / area
    b[2] = (u0 * p1 - u1 * p0) / area
    b[0] = 1.0 - b[1] - b[2]
    inside: bool = min(b[0], b[1], b[2]) >= -_ROUNDING
    return inside


@kernel
def between_known(lines: Streamlines, nearest: IndexArray, texel: int) -> bool:
    """Return whether two opposite neighbours of a texel have values and belong to its face."""
    for away in (1, lines.size):
        count = 0
        for i in (texel - away, texel + away):
            if 0 <= i < nearest.size and lines.owners[i] == lines.owners[texel]:
                count += 0 < nearest[i] < _NEW_TEXEL
        if count == 2:
            return True
    return False


@kernel
def unfold(lines: Streamlines, f: int, b: FloatArray) -> int:
    """Return the face of a point near face ``f``, and update its barycentric weights ``b`` (3,).

    A point beyond an edge moves into the face behind it or, at a boundary, to the edge.
    """
    c, flow = 0, lines.flow
    for i in range(1, 3):
        if b[i] < b[c]:
            c = i
    slot = flow.neighbours[f, c]
    if b[c] < 0.0 and slot >= 0:
        (p, q), motion = place_of(lines, f, b), flow.unfolding[f, c]
        f = slot // 3
        x, y = motion[0] * p - motion[1] * q + motion[2], motion[1] * p + motion[0] * q + motion[3]
        for i in range(3):
            b[i] = flow.gradients[f, i, 0] * x + flow.gradients[f, i, 1] * y
        b[0] += 1.0
    total = 0.0
    for i in range(3):
        b[i] = max(b[i], 0.0)
        total += b[i]
    for i in range(3):
        b[i] /= total
    return f


@kernel
def fill_gaps(lines: Streamlines, done: IndexArray, images: FloatImage) -> None:
    """Give texels inside triangles that are not ``done`` the mean of their neighbours."""
    b = np.empty(3)
    for texel in range(done.size):
        if lines.owners[texel] < 0 or done[texel] or not weigh_texel(lines, texel, b):
            continue
        size, f = lines.size, lines.owners[texel]
        around = (texel - 1, texel + 1, texel - size, texel + size)
        inside = [i for i in around if 0 <= i < done.size and lines.owners[i] == f]
        known = [i for i in inside if done[i]]
        for other in known:
            for picture in range(images.shape[0]):
                images[picture, texel] += images[picture, other] / len(known)
        done[texel] = True


@kernel
def fill_margins(lines: Streamlines, done: IndexArray, images: FloatImage) -> None:
    """Give texels around each triangle values from the face behind the adjacent edge.

    The values are interpolated between texels that are ``done``.
    """
    b = np.empty(3)
    for texel in range(done.size):
        if lines.owners[texel] < 0 or done[texel]:
            continue
        weigh_texel(lines, texel, b)
        g = unfold(lines, lines.owners[texel], b)
        x, y = -0.5, -0.5
        for i in range(3):
            x += b[i] * lines.corners[g, i, 0]
            y += b[i] * lines.corners[g, i, 1]
        column, row = math.floor(x), math.floor(y)
        total = 0.0
        for corner in range(4):
            i, j = column + corner % 2, row + corner // 2
            other = j * lines.size + i
            if i < lines.size and other < done.size and lines.owners[other] == g and done[other]:
                weight = max(1.0 - abs(x - i), _ROUNDING) * max(1.0 - abs(y - j), _ROUNDING)
                total += weight
                for picture in range(images.shape[0]):
                    images[picture, texel] += weight * images[picture, other]
        if total > 0.0:
            for picture in range(images.shape[0]):
                images[picture, texel] /= total
