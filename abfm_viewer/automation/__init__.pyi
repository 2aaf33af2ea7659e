from .driver import Driver as Driver
from .driver import DriverError as DriverError
