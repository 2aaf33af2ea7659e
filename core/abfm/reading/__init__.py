"""What comes in from files: plain, bounded, and as long as it says before it is used."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
