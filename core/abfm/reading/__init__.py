"""What comes in from files: plain, bounded, and as long as it says before it is used."""

from abfm.reading.door import (
    LARGEST,
    array_from,
    from_json,
    inflated,
    most_inflated,
    open_plain,
    read_bytes,
)
from abfm.reading.gifti import GiftiArray, gifti_arrays

__all__ = [
    "LARGEST",
    "GiftiArray",
    "array_from",
    "from_json",
    "gifti_arrays",
    "inflated",
    "most_inflated",
    "open_plain",
    "read_bytes",
]
