"""Numba kernels that walk along a continuous field, in equal steps and straight over edges, and smear noise on the way.

Each step follows the midpoint rule; its two directions are compared in one frame because a walk carries its direction
over every edge into the next face's plane.
"""

import math
from typing import NamedTuple

import numpy as np

from abfm.flow.smooth_flow import SmoothFlow, vector_at, walk_straight
from abfm.numerics.kernels import kernel
from abfm.streaks.texels import Canvas, FloatImage, between_known, weigh_texel
from abfm.types import FloatArray, IndexArray

_CHUNK, _CHUNKS = 4, 12  # steps, beyond those convolved, by which a streamline grows, and how often at most
_NEW = 255  # of texels that no streamline has met
_WORTH = 8  # it grows while one in so many texels is new


class Track(NamedTuple):
    """What was met on the ways ahead and back from the middle of the arrays, of ``n`` steps in ``m`` parts each."""

    noise: FloatArray  # (2 n,), on average over each step
    texels: IndexArray  # (2 n m + 1,), after each part of a step; -1 behind the end
    misses: IndexArray  # (2 n m + 1,) of uint8, how far from their centres: squared, from 1 to 201
    parts: int


@kernel
def direction(
    flow: SmoothFlow, f: int, x: float, y: float, before_x: float, before_y: float, step: float, calm: float
) -> tuple[float, float]:
    """The next step along the field by the midpoint rule, or back where ``step`` is negative; zero where it ends.

    It ends where the field is calm, and where it turns against the way before.
    """
    u, v = vector_at(flow, f, x, y)
    speed = math.copysign(math.sqrt(u * u + v * v), step)
    if abs(speed) <= calm or (before_x * u + before_y * v) * speed < 0.0:
        return 0.0, 0.0
    length = abs(step) / speed
    u, v = u * length, v * length
    g, x, y, p, q = walk_straight(flow, f, x, y, u / 2, v / 2)
    if g < 0:
        return u, v
    r, s = vector_at(flow, g, x, y)
    speed = math.copysign(math.sqrt(r * r + s * s), step)
    if abs(speed) <= calm:
        return u, v
    norm = 2 / (speed * abs(step))  # p, q are as long as half the step
    cosine, sine = (p * r + q * s) * norm, (p * s - q * r) * norm
    if cosine <= 0.0:
        return 0.0, 0.0
    return cosine * u - sine * v, sine * u + cosine * v


@kernel
def follow(
    charts: FloatArray,
    size: int,
    flow: SmoothFlow,
    start: tuple[int, float, float, float, float],
    step: float,
    calm: float,
    seed: int,
    first: int,
    last: int,
    track: Track,
    place: FloatArray,
    onward: FloatArray,
) -> tuple[int, float, float, float, float]:
    """Go on with a walk from step ``first`` to step ``last``, back where the step is negative, and keep its track.

    Starts from, and returns, a place and the way before. Where the walk ends, at a boundary or where the field has no
    direction, the noise goes straight on in space, so that there is as much of it everywhere: ``place`` (3,) is where
    it is and ``onward`` (3,) the last part of a step. ``charts`` are as for `convolve`.
    """
    f, x, y, u, v = start
    stride = 1 if step > 0.0 else -1
    middle, parts = track.noise.size // 2, track.parts
    for j in range(first, last):
        if f >= 0:
            u, v = direction(flow, f, x, y, u, v, step, calm)
            u, v = u / parts, v / parts
            if u == 0.0 and v == 0.0:
                f = -1
            else:
                for k in range(3):
                    onward[k] = u * charts[f, k, 1] + v * charts[f, k, 2]
        at = middle * parts + stride * j * parts
        total = 0.0
        for _ in range(parts):
            at += stride
            if f >= 0:
                f, x, y, u, v = walk_straight(flow, f, x, y, u, v)
            if f >= 0:
                column = charts[f, 3, 0] + x * charts[f, 3, 1] + y * charts[f, 3, 2]
                row = charts[f, 4, 0] + x * charts[f, 4, 1] + y * charts[f, 4, 2]
                track.texels[at] = size * int(row) + int(column)
                off = (column - int(column) - 0.5) ** 2 + (row - int(row) - 0.5) ** 2
                track.misses[at] = np.uint8(1.0 + 400.0 * off)
                put(charts, f, x, y, place)
            else:
                track.texels[at] = -1
                for k in range(3):
                    place[k] += onward[k]
            total += hashed(math.floor(place[0]), math.floor(place[1]), math.floor(place[2]), seed)
        track.noise[middle + j if stride > 0 else middle - 1 - j] = total / parts
    return f, x, y, u, v


@kernel
def hashed(i: int, j: int, k: int, seed: int) -> float:
    """A random number from -1 to 1 that belongs to a point of the integer grid, whenever it is asked for."""
    h = (np.uint64(seed) + np.uint64(1)) * np.uint64(0xD1B54A32D192ED03)
    h ^= h >> np.uint64(32)
    for value in (i, j, k):
        h = (h ^ np.uint64(value)) * np.uint64(0x9E3779B97F4A7C15)
        h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    return float(np.int64(h)) * 2.0**-63


@kernel
def put(charts: FloatArray, f: int, x: float, y: float, place: FloatArray) -> None:
    """Where a place of a face is in space."""
    for k in range(3):
        place[k] = charts[f, k, 0] + x * charts[f, k, 1] + y * charts[f, k, 2]


@kernel
def texel_place(canvas: Canvas, flow: SmoothFlow, texel: int, b: FloatArray) -> tuple[float, float]:
    """Where a texel's centre lies in the frame of its face; its barycentric weights are written into ``b`` (3,)."""
    f = canvas.owners[texel]
    weigh_texel(canvas, texel, b)
    g = flow.gradients
    area = g[f, 1, 0] * g[f, 2, 1] - g[f, 1, 1] * g[f, 2, 0]
    return (b[1] * g[f, 2, 1] - b[2] * g[f, 1, 1]) / area, (b[2] * g[f, 1, 0] - b[1] * g[f, 2, 0]) / area


@kernel
def smeared(weights: FloatArray, picture: int, noise: FloatArray, start: int) -> float:
    """Inner product of a row of weights and the noise from a start, in four lanes for the processor."""
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
def count_new(track: Track, nearest: IndexArray, stride: int, first: int, last: int) -> int:
    """How many texels between two steps of a track are not done."""
    middle, count = (track.noise.size // 2) * track.parts, 0
    for part in range(first * track.parts + 1, last * track.parts + 1):
        texel = track.texels[middle + stride * part]
        if texel >= 0 and nearest[texel] == _NEW:
            count += 1
    return count


@kernel
def convolve(
    canvas: Canvas,
    charts: FloatArray,
    flow: SmoothFlow,
    weights: FloatArray,
    step: float,
    parts: int,
    calm: float,
    seed: int,
    done: IndexArray,
    images: FloatImage,
) -> None:
    """Convolve noise along streamlines of a field, with ``weights`` (P, K) into ``images`` (P, texels).

    Fills the texels whose centre is in their face, marked in ``done`` (texels,). Each streamline serves the texels that
    it meets, as far as enough of them are new, unless another one came nearer to their centres. No streamline is worth
    its time where texels on both sides are known. Steps are walked, and served, in ``parts``. ``charts`` (F, 5, 3) say
    where a place (x, y) of a face is, as ``a + b x + c y``: three coordinates in space, column and row in texels.
    """
    half = weights.shape[1] // 2
    most = half + _CHUNK * _CHUNKS
    middle, nodes = most * parts, 2 * most * parts + 1
    track = Track(np.empty(2 * most), np.empty(nodes, dtype=np.int64), np.empty(nodes, dtype=np.uint8), parts)
    values = np.empty((weights.shape[0], 2 * most + 1))
    nearest = np.empty(done.size, dtype=np.uint8)
    place, onward, b, reach = np.empty(3), np.empty(3), np.empty(3), np.empty(2, dtype=np.int64)
    for texel in range(done.size):
        f = canvas.owners[texel]
        inside = f >= 0 and weigh_texel(canvas, texel, b)
        done[texel] = inside and not flow.vectors[f].any()
        nearest[texel] = _NEW if inside and not done[texel] else 0
    for texel in range(done.size):
        if nearest[texel] != _NEW or between_known(canvas, nearest, texel):
            continue
        f = canvas.owners[texel]
        x, y = texel_place(canvas, flow, texel, b)
        u, v = vector_at(flow, f, x, y)
        if u * u + v * v <= calm * calm:
            nearest[texel], done[texel] = 0, True
            continue
        track.texels[middle], track.misses[middle] = texel, 1
        for side in range(2):
            along = step if side == 0 else -step
            put(charts, f, x, y, place)
            walk, known, steps = (f, x, y, 0.0, 0.0), 0, _CHUNK
            while known < half + steps:
                walk = follow(
                    charts, canvas.size, flow, walk, along, calm, seed, known, half + steps, track, place, onward
                )
                known = half + steps
                new = count_new(track, nearest, 1 if side == 0 else -1, steps - _CHUNK, steps)
                if known < most and _WORTH * new >= _CHUNK * parts:
                    steps += _CHUNK
            reach[side] = steps
        for i in range(most - reach[1], most + reach[0] + 1):
            for picture in range(weights.shape[0]):
                values[picture, i] = smeared(weights, picture, track.noise, i - half)
        for i in range(middle - reach[1] * parts, middle + reach[0] * parts + 1):
            target = track.texels[i]
            if target < 0 or track.misses[i] >= nearest[target]:
                continue
            nearest[target] = track.misses[i]
            before, share = i // parts, (i % parts) / parts
            after = before + (1 if share > 0.0 else 0)
            for picture in range(weights.shape[0]):
                images[picture, target] = (1.0 - share) * values[picture, before] + share * values[picture, after]
    for texel in range(done.size):
        done[texel] = done[texel] or 0 < nearest[texel] < _NEW


@kernel
def sharpen(factor: float, images: FloatImage) -> None:
    """Map values (P, texels) from -1/2 to 1/2, after a factor, along half a wave of the sine, and clip the others."""
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
