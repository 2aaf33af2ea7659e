"""What a task is: its inputs, how it is solved, and what its result offers to every view."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
