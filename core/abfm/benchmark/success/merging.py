"""Reports of parts put together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from abfm.errors import ParameterError


def merged(reports: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """One report of several reports of `run_success`: of other parts, or other meshes.

    Raises
    ------
    ParameterError
        If there is none, or they are of different versions or seeds.
    """
    if not reports:
        raise ParameterError("no reports to put together; give at least one")
    first = reports[0]
    for report in reports:
        for key in ("versions", "seed", "level"):
            if report["settings"][key] != first["settings"][key]:
                raise ParameterError(f"reports of different {key} cannot be put together")
    meshes = {name: size for report in reports for name, size in report["settings"]["meshes"].items()}
    return {
        "rows": [row for report in reports for row in report["rows"]],
        "interrupted": any(report["interrupted"] for report in reports),
        "settings": {**first["settings"], "meshes": meshes},
        "machine": first["machine"],
    }
