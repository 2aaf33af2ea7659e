"""How the fields of a film compare."""

import numpy as np

import abfm


def fast_in(sequence: abfm.Sequence) -> float:
    """What counts as fast in a film: the root mean square over its intervals of what does in each,
    so that no single one makes arrows of all others short.
    """
    speeds = (np.linalg.norm(field, axis=1) for field in sequence.velocity)
    fast = [abfm.calculus.fast_speed(sequence.mesh, speed) for speed in speeds]
    return float(np.linalg.norm(fast) / np.sqrt(len(fast)))
