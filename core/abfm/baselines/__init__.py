"""What a user would compare with: the linear blend, and the paper's algorithm as published."""

from abfm.baselines.linear_blend import linear_blend
from abfm.baselines.paper import PaperDescent, PaperEnergy, minimise

__all__ = ["PaperDescent", "PaperEnergy", "linear_blend", "minimise"]
