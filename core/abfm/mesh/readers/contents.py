"""What every reader returns, and what the formats make necessary to get there."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from abfm.types import FloatArray, IntArray


class FileContents(NamedTuple):
    """Vertices (V, 3) in the file's order and count, triangles (F, 3), and what was changed on the way."""

    vertices: FloatArray
    faces: IntArray
    messages: tuple[str, ...] = ()


def coordinates(rows: Sequence[Sequence[str]]) -> FloatArray:
    """Vertices (V, 3) from the words of their lines.

    Raises
    ------
    ValueError
        If a line has fewer than three words, or one is no number.
    """
    short = next((row for row, words in enumerate(rows) if len(words) < 3), None)
    if short is not None:
        raise ValueError(f"vertex {short}, counting from 0, has {len(rows[short])} coordinates instead of 3")
    return np.array([words[:3] for words in rows], dtype=np.float64)


def split_polygons(vertices: FloatArray, polygons: Sequence[Sequence[int]]) -> FileContents:
    """Contents with every polygon of more than three corners split into a fan around its first corner.

    Raises
    ------
    ValueError
        If a polygon has fewer than three corners.
    """
    sizes = np.array([len(polygon) for polygon in polygons])
    if np.all(sizes == 3):
        return FileContents(vertices, np.array(polygons, dtype=np.int64).reshape(-1, 3))
    if sizes.min() < 3:
        raise ValueError(f"face {np.argmin(sizes)}, counting from 0, has {sizes.min()} corners instead of 3 or more")
    triangles = [(polygon[0], polygon[k], polygon[k + 1]) for polygon in polygons for k in range(1, len(polygon) - 1)]
    message = f"polygons with more than three corners were split into triangles: {np.sum(sizes > 3)}"
    return FileContents(vertices, np.array(triangles, dtype=np.int64), (message,))


def merge_by_position(vertices: FloatArray, faces: IntArray) -> FileContents:
    """Contents with vertices at exactly the same position made one, numbered in order of first appearance."""
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.argsort(order)
    message = (
        f"{len(vertices)} vertices were merged to {len(first)} by position, "
        "and are counted in order of first appearance"
    )
    return FileContents(vertices[first[order]], rank[inverse.reshape(-1)][faces], (message,))
