"""What comes in from files: plain, of a bounded size and as long as it says before anything is made of it."""

from abfm.reading.door import LARGEST, inflated, open_plain, read_bytes

__all__ = ["LARGEST", "inflated", "open_plain", "read_bytes"]
