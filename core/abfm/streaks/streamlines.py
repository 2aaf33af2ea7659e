"""Kernels that walk along a continuous field in equal steps and smear noise on the way."""

import math
from typing import NamedTuple

import numpy as np

from abfm.flow.continuous_flow import Face, SmoothFlow, Walker, midpoint, vector_at, walk_straight
from abfm.numerics.kernels import kernel
from abfm.streaks.texels import Canvas, FloatImage, between_known, weigh_texel
from abfm.types import FloatArray, IndexArray

# steps, beyond those convolved, by which a streamline grows, and how often at most
_CHUNK, _CHUNKS = 4, 12
_NEW = 255  # of texels that no streamline has met
_WORTH = 8  # it grows while one in so many texels is new


class Streamlines(NamedTuple):
    """A field to walk along in equal steps, and the texture in which texels are met."""

    flow: SmoothFlow
    canvas: Canvas
    # (F, 5, 3), where a place (x, y) of a face is, as ``a + b x + c y``: three coordinates in
    # space, column and row in texels
    charts: FloatArray
    step: float
    parts: int  # of a step, in which it is walked, and texels are served
    calm: float  # speed up to which there is no direction
    seed: int  # of the noise


class Track(NamedTuple):
    """What was met ahead and back from the middle of the arrays, in ``n`` steps of ``m`` parts."""

    noise: FloatArray  # (2 n,), on average over each step
    texels: IndexArray  # (2 n m + 1,), after each part of a step; -1 behind the end
    misses: IndexArray  # (2 n m + 1,) of uint8, how far from their centres: squared, from 1 to 201
    place: FloatArray  # (3,), where in space a walk is,
    onward: FloatArray  # (3,), and the last part of a step, by which noise goes on behind its end


@kernel
def direction(flow: SmoothFlow, walker: Walker, step: float, calm: float) -> Walker:
    """Turn a walker's way into its next step along the field by the midpoint rule, or back where
    ``step`` is negative; zero where the walk ends.

    It ends where the field is calm, and where it turns against the way before.
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
    """Go on with a walk from a step to another, ``ahead`` 1 or back -1, and keep its track.

    Starts from, and returns, a place and the way before. Where the walk ends, at a boundary or
    where the field has no direction, the noise goes straight on in space, so that there is as much
    of it everywhere.
    """
    flow, charts, size, parts = lines.flow, lines.charts, lines.canvas.size, lines.parts
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
            total += hashed(
                math.floor(place[0]), math.floor(place[1]), math.floor(place[2]), lines.seed
            )
        track.noise[middle + j if ahead > 0 else middle - 1 - j] = total / parts
    return walker


@kernel
def hashed(i: int, j: int, k: int, seed: int) -> float:
    """Return the random number from -1 to 1 that belongs to a point of the integer grid."""
    h = (np.uint64(seed) + np.uint64(1)) * np.uint64(0xD1B54A32D192ED03)
    h ^= h >> np.uint64(32)
    for value in (i, j, k):
        h = (h ^ np.uint64(value)) * np.uint64(0x9E3779B97F4A7C15)
        h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    return float(np.int64(h)) * 2.0**-63


@kernel
def put(charts: FloatArray, f: Face, x: float, y: float, place: FloatArray) -> None:
    """Set ``place`` (3,) to where a place of a face is in space."""
    for k in range(3):
        place[k] = charts[f, k, 0] + x * charts[f, k, 1] + y * charts[f, k, 2]


@kernel
def texel_place(canvas: Canvas, flow: SmoothFlow, texel: int, b: FloatArray) -> tuple[float, float]:
    """Return a texel's centre in the frame of its face; its weights are written into ``b`` (3,)."""
    f = canvas.owners[texel]
    weigh_texel(canvas, texel, b)
    g = flow.gradients
    area = g[f, 1, 0] * g[f, 2, 1] - g[f, 1, 1] * g[f, 2, 0]
    return (b[1] * g[f, 2, 1] - b[2] * g[f, 1, 1]) / area, (
        b[2] * g[f, 1, 0] - b[1] * g[f, 2, 0]
    ) / area


@kernel
def smeared(weights: FloatArray, picture: int, noise: FloatArray, start: int) -> float:
    """Return the product of a row of weights and the noise from a start, in four lanes."""
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
    """Convolve noise along streamlines of a field, with ``weights`` (P, K) into ``images`` (P,
    texels).

    Fills the texels whose centre is in their face, marked in ``done`` (texels,). Each streamline
    serves the texels that it meets, as far as enough of them are new, unless another one came
    nearer to their centres. No streamline is worth its time where texels on both sides are known.
    """
    half = weights.shape[1] // 2
    most = half + _CHUNK * _CHUNKS
    middle, nodes = most * lines.parts, 2 * most * lines.parts + 1
    track = Track(
        np.empty(2 * most),
        np.empty(nodes, dtype=np.int64),
        np.empty(nodes, dtype=np.uint8),
        np.empty(3),
        np.empty(3),
    )
    values, reach = np.empty((weights.shape[0], 2 * most + 1)), np.empty(2, dtype=np.int64)
    nearest = np.empty(done.size, dtype=np.uint8)
    mark_new(lines, nearest, done)
    b = np.empty(3)
    for texel in range(done.size):
        if nearest[texel] != _NEW or between_known(lines.canvas, nearest, texel):
            continue
        f = lines.canvas.owners[texel]
        x, y = texel_place(lines.canvas, lines.flow, texel, b)
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
        done[texel] = done[texel] or 0 < nearest[texel] < _NEW


@kernel
def mark_new(lines: Streamlines, nearest: IndexArray, done: IndexArray) -> None:
    """Mark texels whose centre is in their face as new, or as done where there is no field."""
    b = np.empty(3)
    for texel in range(done.size):
        f = lines.canvas.owners[texel]
        inside = f >= 0 and weigh_texel(lines.canvas, texel, b)
        done[texel] = inside and not lines.flow.vectors[f].any()
        nearest[texel] = _NEW if inside and not done[texel] else 0


@kernel
def grow(
    lines: Streamlines,
    walker: Walker,
    ahead: int,
    lengths: tuple[int, int],
    met: tuple[Track, IndexArray],
) -> int:
    """Walk to one side, ``half`` the window and so many steps more as find enough new texels,
    together ``most``; returns how many more.
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
            if texel >= 0 and nearest[texel] == _NEW:
                new += 1
        if known < most and _WORTH * new >= _CHUNK * lines.parts:
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
    """Give the texels of a track, from its first to its last node, their values where it came
    nearest, between the two steps of so many parts.
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
            images[picture, target] = (1.0 - share) * values[picture, before] + share * values[
                picture, after
            ]


@kernel
def sharpen(factor: float, images: FloatImage) -> None:
    """Map values (P, texels), after a factor, along half a wave of the sine, and clip them."""
    for picture in range(images.shape[0]):
        for texel in range(images.shape[1]):
            share = min(max(images[picture, texel] * factor, -0.5), 0.5)
            images[picture, texel] = 0.5 * math.sin(math.pi * share)


@kernel
def dim(canvas: Canvas, flow: SmoothFlow, factor: float, images: FloatImage) -> None:
    """Multiply the texels of ``images`` (P, texels) by a factor times the speed, at most 1."""
    b = np.empty(3)
    for texel in range(canvas.owners.size):
        f = canvas.owners[texel]
        if f >= 0:
            x, y = texel_place(canvas, flow, texel, b)
            u, v = vector_at(flow, f, x, y)
            share = min(factor * math.sqrt(u * u + v * v), 1.0)
            for picture in range(images.shape[0]):
                images[picture, texel] *= share
