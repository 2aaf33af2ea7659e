"""What all kernels keep to, so that compiled code from disk works and is the code that was written."""

import importlib
import inspect
import pkgutil
import subprocess
import sys

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


def test_a_kernel_that_changes_reaches_those_that_call_it_from_another_file(tmp_path):
    (tmp_path / "middle.py").write_text(
        "from abfm.numerics.kernels import kernel\nfrom lower import f\n@kernel\ndef g(x):\n    return f(x)\n"
    )
    (tmp_path / "upper.py").write_text(
        "from abfm.numerics.kernels import kernel\nfrom middle import g\n@kernel\ndef h(x):\n    return g(x)\n"
    )
    for sum_of in (1, 20):
        (tmp_path / "lower.py").write_text(
            f"from abfm.numerics.kernels import kernel\n@kernel\ndef f(x):\n    return x + {sum_of}\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", "import upper; print(upper.h(10))"], cwd=tmp_path, capture_output=True, text=True
        )
        assert done.stdout.split() == [str(10 + sum_of)], done.stderr
    assert len(list((tmp_path / "__pycache__").glob("upper.h_*.nbi"))) == 2
