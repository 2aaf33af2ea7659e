"""Verification of derivatives and of orders of convergence."""

import numpy as np


def taylor_order(evaluate, x, direction):
    """Return the smallest order of ``|E(x + e d) - E(x) - e <g, d>|`` for e = 1, 1/2, 1/4, 1/8."""
    value, gradient = evaluate(x)
    slope = float((gradient * direction).sum())
    lengths = 0.5 ** np.arange(4)
    remainders = [abs(evaluate(x + e * direction)[0] - value - e * slope) for e in lengths]
    return float(observed_orders(lengths, remainders).min())


def observed_orders(sizes, errors):
    """Return exponents p in ``error ~ size^p`` between successive sizes."""
    return np.asarray(np.diff(np.log(errors)) / np.diff(np.log(sizes)))


def near(found, expected, within):
    np.testing.assert_allclose(found, expected, rtol=0, atol=within)
