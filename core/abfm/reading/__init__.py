"""What comes in from files: plain, of a bounded size and as long as it says before anything is
made of it.
"""

from abfm.reading.door import LARGEST, inflated, most_inflated, open_plain, read_bytes
from abfm.reading.gifti import GiftiArray, gifti_arrays
from abfm.reading.json_text import from_json
from abfm.reading.npy import array_from

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
