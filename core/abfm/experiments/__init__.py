"""Scripts of the paper's figures, with measured numbers and a picture of each figure."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
