from .arrays import FORMAT_VERSION as FORMAT_VERSION
from .atomic import write_atomically as write_atomically
from .exports import export_energy_csv as export_energy_csv
from .exports import export_ply as export_ply
from .exports import export_vtu as export_vtu
from .results import load_arrays as load_arrays
from .results import save_arrays as save_arrays
