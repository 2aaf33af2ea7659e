"""Whether two pictures show the same, though another version of Mesa may draw edges a little
differently.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from abfm_viewer.widgets.widget_record import Rect

_BLOCK = 40  # pixels
_MEAN, _WORST_BLOCK = 1.5, 12.0  # mean absolute differences of 0 to 255


def difference(actual: Path, expected: Path, masked: Sequence[Rect] = ()) -> str:
    """What is different; empty if nothing that matters. The difference is written beside the actual
    picture.

    A block catches what is small: a word that is missing, or a button.
    """
    pictures = [
        np.asarray(Image.open(path).convert("RGB"), dtype=float) for path in (actual, expected)
    ]
    if pictures[0].shape != pictures[1].shape:
        return f"{actual} has shape {pictures[0].shape}, expected {pictures[1].shape} as {expected}"
    apart = np.abs(pictures[0] - pictures[1]).mean(axis=2)
    for left, top, right, bottom in masked:
        apart[int(top) : int(bottom) + 1, int(left) : int(right) + 1] = 0
    height, width = (size // _BLOCK * _BLOCK for size in apart.shape)
    blocks = apart[:height, :width].reshape(height // _BLOCK, _BLOCK, -1, _BLOCK).mean(axis=(1, 3))
    row, column = np.unravel_index(np.argmax(blocks), blocks.shape)
    if apart.mean() <= _MEAN and blocks.max() <= _WORST_BLOCK:
        return ""
    where = actual.with_name(f"{actual.stem}-difference.png")
    Image.fromarray(np.clip(4 * apart, 0, 255).astype(np.uint8)).save(where)
    return (
        f"{actual} differs from {expected}: by {apart.mean():.2f} on average (at most {_MEAN}), "
        "and by "
        f"{blocks.max():.1f} around x={column * _BLOCK}, y={row * _BLOCK} (at most "
        f"{_WORST_BLOCK}); see {where}. "
        "If it is better so: pytest --update-snapshots"
    )
