"""Advection-based function matching on surfaces: find the tangent field whose flow carries one
function to another.

Names are imported when they are first used, here and in the rooms, so that a program that only
reads meshes starts without the solver. ``__init__.pyi`` beside each ``__init__.py`` lists them.

What is refused is an AbfmError, whatever asks for it: of the kind of what does not fit (a function,
a mesh, a parameter, a file, the length of a flow), saying what was given and what is expected.
"""

import pkgutil

import lazy_loader

__getattr__, __dir__, _names = lazy_loader.attach_stub(__name__, __file__)
_rooms = {module.name for module in pkgutil.iter_modules(__path__)}
# from abfm import * would take the name of Python's own io
__all__ = [name for name in _names if name not in _rooms]
