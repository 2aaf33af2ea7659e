"""Many matches and registrations: tables of them, a ledger of what is done, and who does it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
