"""What a file holds of a film."""

from typing import Any, NamedTuple

from numpy.typing import NDArray

from abfm.types import FloatArray


class FramesFile(NamedTuple):
    """Frames (T, V) or (T, V, C) of a mesh or of its file, their times (T,) in seconds where the
    file says them, and what a user should know.
    """

    values: NDArray[Any]
    times: FloatArray | None = None
    notes: tuple[str, ...] = ()
