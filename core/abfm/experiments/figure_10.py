"""Figure 10: as figure 9, one field whose flow is a rotation by 180 degrees, on a shape with
creases.
"""

import numpy as np

from abfm import TriangleMesh
from abfm.calculus import face_normals
from abfm.experiments import figure_09 as symmetry_flow
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage, affordable_iterations
from abfm.experiments.witnesses import map_measures, map_notes, maps_of_flow
from abfm.mesh.shapes import stepped_slab
from abfm.paper import TABLE_1
from abfm.sheets import Sheet

CLAIM = (
    "A smooth field generates a continuous symmetric mapping although the geometry contains "
    "creases."
)


def figure(stage: Stage) -> Script:
    """Match the places on a slab with a step and a rotation, or by the symmetry of a given mesh."""
    mesh, name = stage.surface("stepped slab", stepped_slab, 2 if stage.small else 6)
    iterations = 60 if stage.small else affordable_iterations(mesh, 300)
    symmetry = symmetry_flow.detected(mesh)
    parameters = TABLE_1[10].parameters(iterations=iterations)
    example = symmetry_flow.symmetric_example(mesh, name, symmetry, parameters)
    yield example

    found = stage.match(example.problem, shares=(0.0, 0.9))
    marks = symmetry_flow.marked(mesh, symmetry)
    maps = maps_of_flow(found, "the map", symmetry_flow.MEASURED)
    measures = (
        *symmetry_flow.measured(found, symmetry),
        Measure("edges with an angle of more than 45 degrees, share", crease_share(mesh)),
        *map_measures(maps),
    )
    rows = (symmetry_flow.function_row(found), symmetry_flow.map_row(found, marks))
    sheet = Sheet(rows, up="z", seen=symmetry_flow.seen(mesh, marks), notes=map_notes(maps))
    return Findings(measures, sheet, symmetry_flow.setting_of(example, symmetry))


def crease_share(mesh: TriangleMesh) -> float:
    """Return the share of the inner edges' number at which the surface turns by more than 45
    degrees.
    """
    sides = mesh.edge_faces[~mesh.is_boundary_edge]
    normals = face_normals(mesh)
    steep = (normals[sides[:, 0]] * normals[sides[:, 1]]).sum(axis=1) < np.cos(np.pi / 4)
    return float(steep.sum() / max(len(steep), 1))
