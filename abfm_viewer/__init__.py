"""The desktop app, pictures and command line of abfm: they draw and listen, and leave the
mathematics to `abfm`.
"""

import os

# Small BLAS calls from several threads fight for the cores; this works only before NumPy loads.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
