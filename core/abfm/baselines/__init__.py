"""What a user would compare with: the linear blend, and the paper's algorithm as published."""

from abfm.baselines.linear_blend import linear_blend
from abfm.baselines.paper import PaperDescent, PaperEnergy, PaperEvaluation, minimise

__all__ = ["PaperDescent", "PaperEnergy", "PaperEvaluation", "linear_blend", "minimise"]
