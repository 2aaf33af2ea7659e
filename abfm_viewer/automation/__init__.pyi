from . import window_benchmark as window_benchmark
from .driver import Driver as Driver
from .driver import DriverError as DriverError
