"""Advection-based function matching on surfaces.

`match` finds the tangent vector field whose flow transports one function to another. `register`,
`sequence` and `register_population` build on it.

Names and packages are imported when they are first used, so that a program that only reads meshes
starts without the solver. Each ``__init__.pyi`` lists the names of its package.

Invalid input raises a subclass of `AbfmError`, for example `FunctionError`, `MeshError` or
`ParameterError`. An `AdvectionError` reports a flow that is too long. The message reports the value
and the expected input.
"""

import pkgutil

import lazy_loader

__getattr__, _, _names = lazy_loader.attach_stub(__name__, __file__)
_modules = {module.name for module in pkgutil.iter_modules(__path__)}
_INTERNAL_MODULES = {"loading"}
# without modules: from abfm import * would hide Python's own io
__all__ = [name for name in _names if name not in _modules]


def __dir__() -> list[str]:
    return [name for name in _names if name not in _INTERNAL_MODULES]
