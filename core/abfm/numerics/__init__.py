"""Numbers as given, compiled kernels, sparse factorisation, and minimisation: nothing here knows
of surfaces.
"""
