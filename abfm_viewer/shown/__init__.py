"""Data for drawing a document: advected functions, fields, arrows, streaks and comparisons.

A slot is one of the pictures side by side. Each shows a surface, such as "source", "advected" or
"target". The shown time is that of the time bar.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
