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
from abfm.texels import Canvas, clip, texel_weights

GOING, BOUNDARY, STAGNATION = 0, 1, 2
AT_VERTEX = 1.0 - 1e-12
"""A walker with so much weight on one corner is at the vertex."""
CROSSINGS = 64
"""Edges that a streamline may meet in one texel length before it counts as caught in a whirl."""


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
def advance(flow: FaceFlow, where: IndexArray, b: FloatArray, time: float) -> tuple[float, int]:
    """Walk on for a time, at most to the next edge or vertex. Returns the time it took, and whether the way goes on."""
    f, c = where[0], where[1]
    if c >= 0:
        speed = sliding_speed(flow, f, c)
        goal = (c + 2) % 3 if speed > 0.0 else (c + 1) % 3
        origin = 3 - c - goal
        if speed == 0.0:
            return 0.0, STAGNATION
        used = b[origin] / abs(speed)
        if used > time:
            b[origin] -= time * abs(speed)
            b[goal] = 1.0 - b[origin]
            return time, GOING
        return used, leave_vertex(flow, where, b, goal)
    leave, used, moving = -1, time, False
    for i in range(3):
        rate = flow.rates[f, i]
        moving = moving or rate != 0.0
        if rate < 0.0 and b[i] <= -rate * used:
            leave, used = i, b[i] / -rate
    if not moving:
        return 0.0, STAGNATION
    total = 0.0
    for i in range(3):
        b[i] = 0.0 if i == leave else max(b[i] + used * flow.rates[f, i], 0.0)
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
    now = start
    status = GOING
    while status == GOING and now < end and count < times.size:
        used, status = advance(flow, where, b, end - now)
        if status == STAGNATION and used == 0.0:
            break
        now = end if used >= end - now else now + used
        times[count] = now
        faces[count] = where[0]
        weights[count] = b
        count += 1
    return count, status


@kernel
def noise_at(x: float, y: float, z: float, seed: int) -> float:
    """White noise in [-0.5, 0.5), one number per unit cube of space."""
    h = np.uint64(seed)
    for value in (x, y, z):
        h = (h ^ np.uint64(np.int64(np.floor(value)))) * np.uint64(0x9E3779B97F4A7C15)
        h ^= h >> np.uint64(29)
    h *= np.uint64(0xBF58476D1CE4E5B9)
    h ^= h >> np.uint64(32)
    return np.float64(h >> np.uint64(11)) * 2.0**-53 - 0.5


@kernel
def follow(
    canvas: Canvas,
    flow: FaceFlow,
    heading: FloatArray,
    where: IndexArray,
    b: FloatArray,
    stride: int,
    seed: int,
    noise: FloatArray,
    texels: IndexArray,
) -> None:
    """Noise and texels along the streamline of a flow of unit speed, from the middle of two arrays to one end.

    Where the streamline ends the noise goes straight on in space, so that there is as much of it everywhere.
    """
    middle = noise.size // 2
    x, y, z = 0.0, 0.0, 0.0
    last = where[0]
    going = True
    for j in range(middle + 1):
        left = 1.0 if j else 0.0
        if going:
            for _ in range(CROSSINGS):
                if left <= 0.0 or not going:
                    break
                if heading[where[0], 0] != 0.0 or heading[where[0], 1] != 0.0 or heading[where[0], 2] != 0.0:
                    last = where[0]
                used, status = advance(flow, where, b, left)
                left -= used
                going = status == GOING
            going = going and left <= 0.0
            x, y, z = 0.0, 0.0, 0.0
            column, row = 0.0, 0.0
            f = where[0]
            for i in range(3):
                vertex = canvas.faces[f, i]
                x += b[i] * canvas.vertices[vertex, 0]
                y += b[i] * canvas.vertices[vertex, 1]
                z += b[i] * canvas.vertices[vertex, 2]
                column += b[i] * canvas.corners[f, i, 0]
                row += b[i] * canvas.corners[f, i, 1]
        at = middle + stride * j
        texels[at] = np.int64(row) * canvas.owners.shape[1] + np.int64(column) if going else -1
        if not going:
            x += stride * left * heading[last, 0]
            y += stride * left * heading[last, 1]
            z += stride * left * heading[last, 2]
        noise[at] = noise_at(x, y, z, seed)


@kernel
def convolve(
    canvas: Canvas,
    ahead: FaceFlow,
    back: FaceFlow,
    heading: FloatArray,
    weights: FloatArray,
    reach: int,
    seed: int,
    done: IndexArray,
    images: FloatArray,
) -> None:
    """Convolve noise along streamlines, with ``weights`` (P, K) into ``images`` (P, texels), where a texel's centre is
    in its face; marks in ``done`` (texels,) what it has filled.

    Each streamline also fills the texels that it meets up to ``reach`` texel lengths from where it began.
    """
    taps = weights.shape[1]
    noise = np.empty(taps + 2 * reach)
    texels = np.empty(noise.size, dtype=np.int64)
    where = np.empty(2, dtype=np.int64)
    b = np.empty(3)
    size = canvas.owners.shape[1]
    for texel in range(done.size):
        row, column = texel // size, texel % size
        f = canvas.owners[row, column]
        if f < 0 or done[texel]:
            continue
        texel_weights(canvas.corners, f, column + 0.5, row + 0.5, b)
        if min(b[0], b[1], b[2]) < -1e-9:
            continue
        if heading[f, 0] == 0.0 and heading[f, 1] == 0.0 and heading[f, 2] == 0.0:
            done[texel] = True
            continue
        for stride in (1, -1):
            where[0], where[1] = f, -1
            texel_weights(canvas.corners, f, column + 0.5, row + 0.5, b)
            clip(b)
            follow(canvas, ahead if stride > 0 else back, heading, where, b, stride, seed, noise, texels)
        texels[noise.size // 2] = texel
        for i in range(2 * reach + 1):
            target = texels[i + taps // 2]
            if target < 0 or done[target]:
                continue
            done[target] = True
            for phase in range(weights.shape[0]):
                total = 0.0
                for k in range(taps):
                    total += weights[phase, k] * noise[i + k]
                images[phase, target] = total
