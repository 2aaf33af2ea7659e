from .inputs import Input as Input
from .inputs import renamed_spec as renamed_spec
from .monitor import Monitor as Monitor
from .task import Export as Export
from .task import Table as Table
from .task import Task as Task
from .task import TaskInputs as TaskInputs
