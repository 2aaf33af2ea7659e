"""What all kernels keep to, so that compiled code from disk works and is the code that was written."""

import importlib
import inspect
import pkgutil

from numba.core.dispatcher import Dispatcher

import abfm


def all_kernels():
    for module in pkgutil.walk_packages(abfm.__path__, "abfm."):
        if not module.name.endswith("__main__"):
            for value in vars(importlib.import_module(module.name)).values():
                if isinstance(value, Dispatcher) and value.py_func.__module__ == module.name:
                    yield value.py_func


def test_no_kernel_is_a_generator():
    """Numba fails to compile the caller of a generator that another process, or an interrupted one, left on disk."""
    kernels = list(all_kernels())
    assert len(kernels) > 50
    assert [k.__qualname__ for k in kernels if inspect.isgeneratorfunction(k)] == []
