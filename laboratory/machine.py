"""Where something was measured."""

import os
import platform
import re
from importlib.metadata import version
from pathlib import Path

_LINUX = Path("/proc/cpuinfo")


def machine() -> dict[str, str | int]:
    """Return the processor, logical cores, system, and versions of what takes the time."""
    model = re.search(r"model name\s*: (.*)", _LINUX.read_text()) if _LINUX.exists() else None
    return {
        "processor": model[1] if model else platform.processor() or platform.machine(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{package: version(package) for package in ("numpy", "scipy", "numba")},
    }


def in_words(machine: dict[str, str | int]) -> str:
    """Return what `machine` gives, in a line."""
    packages = ", ".join(
        f"{name} {machine[name]}" for name in ("python", "numpy", "scipy", "numba")
    )
    return f"{machine['processor']}, {machine['cores']} cores, {machine['system']}; {packages}"
