from .linear_blend import linear_blend as linear_blend
from .optimal_transport import HeatKernel as HeatKernel
from .optimal_transport import optimal_transport as optimal_transport
