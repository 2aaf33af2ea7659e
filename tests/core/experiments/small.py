"""The paper's figures, small; on their own meshes each runs once in a process, whatever tests look
at it.
"""

from __future__ import annotations

import math
from functools import cache

from abfm.experiments import Example, Findings, Stage, script
from abfm.mesh import TriangleMesh


def quiet(text: str, share: float) -> None:
    """A report that nobody reads, but for its promises."""
    assert text
    assert 0 <= share <= 1


def stated(figure: int, mesh: TriangleMesh | None = None) -> Example:
    """What a figure is about."""
    return next(script(figure, Stage(mesh, small=True)))


def run(figure: int, mesh: TriangleMesh | None = None) -> tuple[Example, Findings]:
    """What a figure is about and what it finds, all of it finite."""
    whole = script(figure, Stage(mesh, small=True, report=quiet))
    example = next(whole)
    try:
        next(whole)
    except StopIteration as end:
        findings: Findings = end.value
    assert all(math.isfinite(measure.to_dict()["value"]) for measure in findings.measures)
    return example, findings


ran = cache(run)


def values(findings: Findings) -> dict[str, float]:
    """Measured numbers by their names."""
    return {measure.name: measure.value for measure in findings.measures}
