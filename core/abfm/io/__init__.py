"""Files that come out: results that reload, and exports for other programs. A crash never leaves half a file."""

from abfm.io.arrays import FORMAT_VERSION
from abfm.io.atomic import write_atomically
from abfm.io.exports import export_energy_csv, export_ply, export_vtu
from abfm.io.results import load_arrays, save_arrays

__all__ = [
    "FORMAT_VERSION",
    "export_energy_csv",
    "export_ply",
    "export_vtu",
    "load_arrays",
    "save_arrays",
    "write_atomically",
]
