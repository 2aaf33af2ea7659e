"""Checked numbers, compiled kernels, sparse factorisation and minimisation, without geometry."""
