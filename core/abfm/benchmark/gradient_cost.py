"""What the exact gradient costs, in forward advections."""

from time import perf_counter

import numpy as np

from abfm.benchmark.problem import PARAMETERS, Problem
from abfm.calculus.vector_fields import to_frame
from abfm.matching.energy.energy import MatchingEnergy
from abfm.types import FloatArray


def gradient_cost(problem: Problem, velocity: FloatArray, repeats: int) -> tuple[float, float]:
    """Median seconds of one forward advection and of one energy with exact gradient, both by the same scheme.

    Measured in turn at a field (F, 3) in the mesh's units.
    """
    energy = MatchingEnergy(problem.mesh, problem.source, problem.target, PARAMETERS)
    fields = to_frame(energy.mesh, velocity[None] / energy.length_scale)
    seconds = []
    for _ in range(repeats + 1):
        start = perf_counter()
        energy.flow(fields).forward(energy.source[0])
        middle = perf_counter()
        _ = energy.evaluate(fields, PARAMETERS.sigma).gradient
        seconds.append((middle - start, perf_counter() - middle))
    advection, gradient = np.median(seconds[1:], axis=0)  # the first one sets up the mesh
    return float(advection), float(gradient)
