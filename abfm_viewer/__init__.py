"""The window, the pictures and the command line of abfm; the mathematics is in `abfm`."""

import os

# Small BLAS calls from several threads compete for the cores. This must be set before NumPy loads.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
