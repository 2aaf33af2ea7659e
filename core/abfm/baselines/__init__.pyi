from .horn_schunck import horn_schunck as horn_schunck
from .interpolation import HeatKernel as HeatKernel
from .interpolation import linear_blend as linear_blend
from .interpolation import optimal_transport as optimal_transport
