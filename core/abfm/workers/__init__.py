"""Long computations: progress, pause and cancel, and the subprocesses that they run in."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
