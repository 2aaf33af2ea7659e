"""What a user would compare with: the linear blend, optimal transport, and the paper's algorithm as published."""

from abfm.baselines.linear_blend import linear_blend
from abfm.baselines.optimal_transport import HeatKernel, optimal_transport
from abfm.baselines.paper import PaperDescent, PaperEnergy, minimise

__all__ = ["HeatKernel", "PaperDescent", "PaperEnergy", "linear_blend", "minimise", "optimal_transport"]
