from .advection import Discretisation as Discretisation
from .at_points import straightest_geodesics as straightest_geodesics
from .at_points import vectors_at as vectors_at
from .continuous_flow import ContinuousFlow as ContinuousFlow
from .flow import Flow as Flow
from .flow import advect as advect
from .flow_lines import FlowLine as FlowLine
from .flow_lines import flow_lines as flow_lines
