"""How often matches succeed: random problems of many kinds, by several versions of the solver,
side by side.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
