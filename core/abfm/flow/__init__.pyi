from .advection import advect as advect
from .continuous_flow import flow_map as flow_map
from .flow import Flow as Flow
from .flow_lines import FlowLine as FlowLine
from .flow_lines import flow_lines as flow_lines
