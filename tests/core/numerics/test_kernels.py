"""Rules that all kernels obey, so that cached code equals the source."""

import importlib
import inspect
import os
import pkgutil

import numba
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import abfm
from abfm.numerics import kernels
from abfm.workers.progress import reporting_steps
from tests.messages import check_names
from tests.processes import python


def all_kernels():
    for module in pkgutil.walk_packages(abfm.__path__, "abfm."):
        if not module.name.endswith("__main__"):
            for value in vars(importlib.import_module(module.name)).values():
                if isinstance(value, Dispatcher) and value.py_func.__module__ == module.name:
                    yield value.py_func


def test_no_kernel_is_a_generator():
    """No kernel is a generator: with one in the cache on disk, Numba cannot compile its caller."""
    found = list(all_kernels())
    assert len(found) > 50
    assert [k.__qualname__ for k in found if inspect.isgeneratorfunction(k)] == []


def test_changed_kernel_recompiles_callers_in_other_files(tmp_path):
    file = "from abfm.numerics.kernels import kernel\n{}@kernel\ndef {}(x):\n    return {}\n"
    for name, text in {
        "middle": file.format("from lower import f\n", "g", "f(x)"),
        "upper": file.format("from middle import g\n", "h", "g(x)"),
    }.items():
        (tmp_path / f"{name}.py").write_text(text)
    for sum_of in (1, 20):
        (tmp_path / "lower.py").write_text(file.format("", "f", f"x + {sum_of}"))
        done = python("import upper; print(upper.h(10))", cwd=tmp_path)
        assert done.stdout.split() == [str(10 + sum_of)], done.stderr
    assert len(list((tmp_path / "__pycache__").glob("upper.h_*.nbi"))) == 2


def test_damaged_cache_files_are_recompiled(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))

    def run():
        inner = kernels.kernel(kernels.inner.py_func)  # reads the cache like a new process
        return inner(np.ones(3), np.ones(3)), len(inner.stats.cache_hits)

    assert run() == (3.0, 0)
    for damage in (b"", b"junk", bytes(1000)):
        files = [*tmp_path.rglob("*.nb?")]
        assert len(files) == 2
        for file in files:
            file.write_bytes(damage)
        assert run() == (3.0, 0), damage
        assert damage not in [file.read_bytes() for file in files]
    assert run() == (3.0, 1)


@pytest.mark.parametrize("value", ["0", "many"])
def test_invalid_numba_settings_give_one_line(value):
    code = "import abfm\ntry: abfm.match\nexcept abfm.AbfmError as error: print(error)"
    done = python(code, env=os.environ | {"NUMBA_NUM_THREADS": value})
    assert done.stderr == ""
    check_names(done.stdout, "NUMBA_NUM_THREADS", value)
    assert done.stdout.count("\n") == 1


def test_compilation_is_reported_as_a_step():
    twice = numba.njit(lambda x: 2 * x)  # not cached on disk, so it is always compiled
    reported = []
    with reporting_steps(reported.append):
        for _ in range(2):
            assert twice(3) == 6
    assert [each and each.task for each in reported] == ["compiling, once on this machine", None]
