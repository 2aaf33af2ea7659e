"""Figure 7: eigenfunction 7 of the Laplace-Beltrami operator becomes eigenfunction 8, by linearised steps."""

from __future__ import annotations

import numpy as np

from abfm.experiments.experiment import Experiment, Findings, Measure, Report, Setup
from abfm.experiments.meshes import bundled
from abfm.experiments.sheet import Panel, Sheet, Values
from abfm.experiments.table_1 import TABLE_1
from abfm.matching import match
from abfm.mesh import TriangleMesh

_SHOWN = (0.25, 0.5, 0.75)  # of tau


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> Setup:
    """Eigenfunctions 7 and 8, the constant being number 0."""
    name = "mesh" if mesh else "human_A.off"
    return Setup(
        mesh=mesh or bundled(name),
        name=name,
        sources=("eigenfunction:7",),
        targets=("eigenfunction:8",),
        parameters=TABLE_1[7].parameters(iterations=30 if small else 150),
    )


def run(setup: Setup, report: Report) -> Findings:
    """Match, and look at the way between."""
    p = setup.parameters
    found = match(
        setup.mesh,
        setup.source[:, 0],
        setup.target[:, 0],
        p,
        on_iteration=lambda now: report("matching", now.iteration / p.iterations),
    )
    shown = found.advect(np.array([*_SHOWN, 1]) * p.tau)
    panels = [
        Panel(setup.mesh, Values(found.source[:, 0]), "eigenfunction 7", "source"),
        *(Panel(setup.mesh, Values(f), f"t = {s:g} τ") for s, f in zip(_SHOWN, shown, strict=False)),
        Panel(setup.mesh, Values(shown[-1]), "matched", "result"),
        Panel(setup.mesh, Values(found.target[:, 0]), "eigenfunction 8", "target"),
    ]
    measures = (Measure("mismatch", found.mismatch, 0.1, "our result highly matches the target", True),)
    return Findings(measures, Sheet((tuple(panels),)), f"{setup.name}, {len(setup.mesh.vertices):,} vertices")


EXPERIMENT = Experiment(
    7,
    "eigenfunction 7 becomes eigenfunction 8",
    "The result highly matches the target, and the interpolation path is smooth.",
    set_up,
    run,
)
