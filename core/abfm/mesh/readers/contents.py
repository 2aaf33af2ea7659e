"""What every reader returns, and what the formats make necessary to get there."""

from array import array
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from abfm.errors import brief
from abfm.types import FloatArray, IntArray


class FileContents(NamedTuple):
    """Vertices (V, 3) in the file's order and count, triangles (F, 3), and what was changed on
    the way.
    """

    vertices: FloatArray
    faces: IntArray
    messages: tuple[str, ...] = ()


class PointList:
    """Vertices as a text file gives them one by one; 24 bytes each."""

    def __init__(self) -> None:
        self._numbers = array("d")

    def __len__(self) -> int:
        return len(self._numbers) // 3

    def append(self, words: Sequence[str]) -> None:
        """Add a vertex from the words of its line.

        Raises
        ------
        ValueError
            If there are fewer than three, or one is no number.
        """
        if len(words) < 3:
            raise ValueError(
                f"vertex {len(self)}, counting from 0, has {len(words)} coordinates instead of 3"
            )
        self._numbers.extend(map(number, words[:3]))

    def array(self) -> FloatArray:
        """Return all of them, (V, 3)."""
        return np.frombuffer(self._numbers, dtype=np.float64).reshape(-1, 3)


class PolygonList:
    """Faces as a text file gives them one by one; 8 bytes for each and for each of its corners."""

    def __init__(self) -> None:
        self._sizes, self._corners = array("q"), array("q")

    def append(self, corners: Sequence[int]) -> None:
        """Add a face from the indices of its vertices.

        Raises
        ------
        ValueError
            If there are fewer than three, or one has more digits than any file has vertices.
        """
        if len(corners) < 3:
            raise few_corners(len(self._sizes), len(corners))
        try:
            self._corners.extend(corners)
        except OverflowError:
            raise ValueError(
                f"face {len(self._sizes)}, counting from 0, names a vertex beyond all numbers"
            ) from None
        self._sizes.append(len(corners))

    def arrays(self) -> tuple[IntArray, IntArray]:
        """Return the number of corners of every face, (P,), and the corners of all, one face after
        the other.
        """
        return np.frombuffer(self._sizes, dtype=np.int64), np.frombuffer(
            self._corners, dtype=np.int64
        )


def few_corners(face: int, count: int) -> ValueError:
    """Return what is said of a face with fewer than three corners."""
    return ValueError(f"face {face}, counting from 0, has {count} corners instead of 3 or more")


def number(word: str | bytes) -> float:
    """Return the number that a word of a text file is.

    Raises
    ------
    ValueError
        If it is none; so does `whole_number`.
    """
    try:
        return float(word)
    except ValueError:
        raise _no_number(word, "a number") from None


def whole_number(word: str | bytes) -> int:
    """Return the same for numbers of vertices, corners and faces."""
    try:
        return int(word)
    except ValueError:
        raise _no_number(
            word, "a number of fewer digits" if word.isdigit() else "a whole number"
        ) from None


def _no_number(word: str | bytes, expected: str) -> ValueError:
    given = word if isinstance(word, str) else word.decode("utf-8", "replace")
    return ValueError(f"it has {brief(given)} where {expected} is expected")


def text(data: bytes) -> str:
    """Return the text of a file, whose lines end with line feeds; signs that cannot be read are
    replaced.
    """
    return data.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")


def merge_by_position(vertices: FloatArray, faces: IntArray) -> FileContents:
    """Return the contents with vertices at exactly the same position made one, numbered in order of
    first appearance.
    """
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.argsort(order)
    message = (
        f"{len(vertices)} vertices were merged to {len(first)} by position, "
        "and are counted in order of first appearance"
    )
    return FileContents(vertices[first[order]], rank[inverse.reshape(-1)][faces], (message,))
