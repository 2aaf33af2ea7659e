"""Figure 10: as figure 9, one field whose flow is a rotation by 180 degrees, on a shape with creases."""

import numpy as np

from abfm.calculus.operators import face_normals
from abfm.experiments import symmetry_flow
from abfm.experiments.experiment import Experiment, Findings, Measure, Report, affordable_iterations
from abfm.experiments.meshes import stepped_slab
from abfm.experiments.sheet import Sheet
from abfm.experiments.symmetry_flow import SymmetrySetup
from abfm.experiments.table_1 import TABLE_1
from abfm.experiments.witnesses import all_measures, notes, of_flow
from abfm.mesh import TriangleMesh


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> SymmetrySetup:
    """A generated slab with a step and a rotation, or the symmetry that a given mesh has."""
    shape = mesh or stepped_slab(2 if small else 6)
    p = TABLE_1[10].parameters(iterations=60 if small else affordable_iterations(shape, 300))
    return symmetry_flow.set_up(shape, "mesh" if mesh else "stepped slab", symmetry_flow.detected(shape), p)


def run(setup: SymmetrySetup, report: Report) -> Findings:
    """Match, and look at the map."""
    found = symmetry_flow.solve(setup, report, "matching", (0.0, 0.9))
    rows = (symmetry_flow.function_row(found), symmetry_flow.map_row(found, setup.marks))
    maps = of_flow(found, "the map", symmetry_flow.MEASURED)
    creases = Measure("edges with an angle of more than 45 degrees, share", _crease_share(setup.mesh))
    measures = (*symmetry_flow.measures(found, setup.symmetry), creases, *all_measures(maps))
    sheet = Sheet(rows, up="z", seen=symmetry_flow.seen(setup), notes=notes(maps))
    return Findings(measures, sheet, symmetry_flow.setting(setup))


def _crease_share(mesh: TriangleMesh) -> float:
    """Share of the inner edges' number at which the surface turns by more than 45 degrees."""
    sides = mesh.edge_faces[~mesh.is_boundary_edge]
    normals = face_normals(mesh)
    steep = (normals[sides[:, 0]] * normals[sides[:, 1]]).sum(axis=1) < np.cos(np.pi / 4)
    return float(steep.sum() / max(len(steep), 1))


EXPERIMENT = Experiment(
    10, "A smooth field generates a continuous symmetric mapping although the geometry contains creases.", set_up, run
)
