"""Compiled kernels, sparse factorisation, and minimisation: nothing here knows of surfaces."""
