"""Walking along a field that is constant in each face, exactly, from edge to edge.

A walker is a face and barycentric weights; ``where`` holds the face and the corner opposite the edge that the walker
slides along (-1 inside the face). Where two faces push into their common edge the walker follows Filippov's solution:
the mean of the two vectors that lies along the edge. Where it meets a vertex it takes the first face that leads away,
or the first edge to slide along, counted around the vertex from the face that it came from.
"""

from __future__ import annotations

import numpy as np

from abfm.face_flow import FaceFlow
from abfm.kernels import FloatArray, IndexArray, kernel
from abfm.noise import noise_at
from abfm.texels import Canvas, FloatImage, clip, known_neighbours, weigh_texel

GOING, BOUNDARY, STAGNATION = 0, 1, 2
AT_VERTEX = 1.0 - 1e-12
"""A walker with so much weight on one corner is at the vertex."""
CROSSINGS = 64
"""Edges that a streamline may meet in one step before it counts as caught in a whirl."""


@kernel
def sliding_speed(flow: FaceFlow, f: int, c: int) -> float:
    """Speed from corner ``c + 1`` towards ``c + 2`` of a walker on an edge that both faces push into, in edges."""
    slot = flow.neighbours[f, c]
    g, k = slot // 3, slot % 3
    here, there = flow.rates[f, c], flow.rates[g, k] * (flow.areas[g] / flow.areas[f])
    share = there / (here + there)
    speed: float = share * flow.along[f, c] - (1.0 - share) * flow.along[g, k]
    return speed


@kernel
def cross_edge(flow: FaceFlow, where: IndexArray, b: FloatArray, c: int) -> int:
    """Step over the edge opposite corner ``c``, or begin to slide along it."""
    slot = flow.neighbours[where[0], c]
    if slot < 0:
        return BOUNDARY
    g, k = slot // 3, slot % 3
    if flow.rates[g, k] < 0.0:
        where[1] = c
        return GOING
    where[0] = g
    first, last = b[(c + 1) % 3], b[(c + 2) % 3]
    b[k] = 0.0
    b[(k + 1) % 3] = last
    b[(k + 2) % 3] = first
    return GOING


@kernel
def leave_vertex(flow: FaceFlow, where: IndexArray, b: FloatArray, corner: int) -> int:
    """Turn a walker at a corner of its face into a way that leads on."""
    b[:] = 0.0
    for turn in range(1, 3):
        f, j = where[0], corner
        while True:
            if flow.rates[f, j] < 0.0 and flow.rates[f, (j + 1) % 3] >= 0.0 and flow.rates[f, (j + 2) % 3] >= 0.0:
                where[0], where[1] = f, -1
                b[j] = 1.0
                return GOING
            c = (j + 3 - turn) % 3
            slot = flow.neighbours[f, c]
            if slot < 0:
                break
            g, k = slot // 3, slot % 3
            if flow.rates[f, c] < 0.0 and flow.rates[g, k] < 0.0:
                away = sliding_speed(flow, f, c)
                if (away if turn == 1 else -away) > 0.0:
                    where[0], where[1] = f, c
                    b[j] = 1.0
                    return GOING
            f, j = g, (k + 3 - turn) % 3
            if f == where[0]:
                b[corner] = 1.0
                where[1] = -1
                return STAGNATION
    b[corner] = 1.0
    where[1] = -1
    return BOUNDARY


@kernel
def motion(flow: FaceFlow, where: IndexArray, rates: FloatArray) -> bool:
    """How fast the walker's weights grow, into ``rates`` (3,). Whether it moves at all."""
    f, c = where[0], where[1]
    if c < 0:
        for i in range(3):
            rates[i] = flow.rates[f, i]
        return bool(rates[0] != 0.0 or rates[1] != 0.0 or rates[2] != 0.0)
    speed = sliding_speed(flow, f, c)
    rates[c] = 0.0
    rates[(c + 1) % 3] = -speed
    rates[(c + 2) % 3] = speed
    return speed != 0.0


@kernel
def advance(flow: FaceFlow, where: IndexArray, b: FloatArray, rates: FloatArray, time: float) -> tuple[float, int]:
    """Walk on, with the rates of `motion`, for a time, at most to the next edge or vertex.

    Returns the time that it took, and whether the way goes on.
    """
    leave, used = -1, time
    for i in range(3):
        if rates[i] < 0.0 and b[i] <= -rates[i] * used:
            leave, used = i, b[i] / -rates[i]
    total = 0.0
    for i in range(3):
        b[i] = 0.0 if i == leave else max(b[i] + used * rates[i], 0.0)
        total += b[i]
    for i in range(3):
        b[i] /= total
    if leave < 0:
        return used, GOING
    for i in range(3):
        if b[i] >= AT_VERTEX:
            return used, leave_vertex(flow, where, b, i)
    return used, cross_edge(flow, where, b, leave)


@kernel
def trace(
    flow: FaceFlow,
    where: IndexArray,
    b: FloatArray,
    start: float,
    end: float,
    times: FloatArray,
    faces: IndexArray,
    weights: FloatArray,
    count: int,
) -> tuple[int, int]:
    """Walk from a time to another, writing down every crossing after the first ``count`` entries of the last arrays.

    Returns how many entries there are then, and whether the way goes on.
    """
    rates = np.empty(3)
    now = start
    status = GOING
    while status == GOING and now < end and count < times.size:
        if not motion(flow, where, rates):
            return count, STAGNATION
        used, status = advance(flow, where, b, rates, end - now)
        now = end if used >= end - now else now + used
        times[count] = now
        faces[count] = where[0]
        weights[count] = b
        count += 1
    return count, status


@kernel
def follow(
    canvas: Canvas,
    flow: FaceFlow,
    where: IndexArray,
    b: FloatArray,
    stride: int,
    step: float,
    seed: int,
    noise: FloatArray,
    texels: IndexArray,
) -> None:
    """Noise and texels along the streamline of a flow of unit speed, from the middle of two arrays to one end.

    Where the streamline ends the noise goes straight on in space, so that there is as much of it everywhere.
    """
    middle = noise.size // 2
    size = canvas.size
    rates = np.empty(3)
    x, y, z, dx, dy, dz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    walked = 0.0
    j = 0 if stride > 0 else 1
    for _ in range(CROSSINGS * middle):
        f = where[0]
        moving = motion(flow, where, rates)
        x, y, z, column, row = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(3):
            vertex = canvas.faces[f, i]
            x += b[i] * canvas.vertices[vertex, 0]
            y += b[i] * canvas.vertices[vertex, 1]
            z += b[i] * canvas.vertices[vertex, 2]
            column += b[i] * canvas.corners[f, i, 0]
            row += b[i] * canvas.corners[f, i, 1]
        if not moving:
            break
        dx, dy, dz, right, up = 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(3):
            vertex = canvas.faces[f, i]
            dx += rates[i] * canvas.vertices[vertex, 0]
            dy += rates[i] * canvas.vertices[vertex, 1]
            dz += rates[i] * canvas.vertices[vertex, 2]
            right += rates[i] * canvas.corners[f, i, 0]
            up += rates[i] * canvas.corners[f, i, 1]
        left = step * middle - walked
        used, status = advance(flow, where, b, rates, left)
        while j <= middle and step * j <= walked + used:
            t = step * j - walked
            at = middle + stride * j
            noise[at] = noise_at(x + t * dx, y + t * dy, z + t * dz, seed)
            texels[at] = size * int(row + t * up) + int(column + t * right)
            j += 1
        walked += used
        x, y, z = x + used * dx, y + used * dy, z + used * dz
        if used >= left or status != GOING:
            break
    while j <= middle:
        t = step * j - walked
        at = middle + stride * j
        noise[at] = noise_at(x + t * dx, y + t * dy, z + t * dz, seed)
        texels[at] = -1
        j += 1


@kernel
def weighted_sum(weights: FloatArray, values: FloatArray) -> float:
    """Inner product in four lanes, which a processor adds up at once."""
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    whole = (weights.size // 4) * 4
    for k in range(0, whole, 4):
        a += weights[k] * values[k]
        b += weights[k + 1] * values[k + 1]
        c += weights[k + 2] * values[k + 2]
        d += weights[k + 3] * values[k + 3]
    for k in range(whole, weights.size):
        a += weights[k] * values[k]
    return a + b + c + d


@kernel
def convolve(
    canvas: Canvas,
    ahead: FaceFlow,
    back: FaceFlow,
    weights: FloatArray,
    reach: int,
    step: float,
    seed: int,
    done: IndexArray,
    images: FloatImage,
) -> None:
    """Convolve noise along streamlines of two opposite flows, with ``weights`` (P, K) into ``images`` (P, texels).

    Fills the texels whose centre is in their face, marked in ``done`` (texels,): each streamline all that it meets up
    to ``reach`` steps from where it began. Where three of four neighbours are known, no streamline is worth its time.
    """
    half = weights.shape[1] // 2
    noise = np.empty(2 * (half + reach) + 1)
    texels = np.empty(noise.size, dtype=np.int64)
    where = np.empty(2, dtype=np.int64)
    b, begin = np.empty(3), np.empty(3)
    for texel in range(done.size):
        f = canvas.owners[texel]
        if f < 0 or done[texel] or not weigh_texel(canvas, texel, begin):
            continue
        where[0], where[1] = f, -1
        if not motion(ahead, where, b):
            done[texel] = True
            continue
        if known_neighbours(canvas, done, texel) >= 3:
            continue
        clip(begin)
        for stride in (1, -1):
            where[0], where[1] = f, -1
            b[:] = begin
            follow(canvas, ahead if stride > 0 else back, where, b, stride, step, seed, noise, texels)
        texels[half + reach] = texel
        for i in range(2 * reach + 1):
            target = texels[half + i]
            if target < 0 or done[target]:
                continue
            done[target] = True
            for picture in range(weights.shape[0]):
                images[picture, target] = weighted_sum(weights[picture], noise[i : i + weights.shape[1]])
