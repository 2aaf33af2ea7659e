"""Figure 10: as figure 9, a rotation by 180 degrees, on a shape with creases."""

import numpy as np

from abfm.calculus import face_normals
from abfm.experiments import vocabulary as words
from abfm.experiments.figure_09 import MEASURED, Symmetric, detected, function_row
from abfm.experiments.vocabulary import Findings, Measure, Script, Stage
from abfm.io.sheets import Sheet
from abfm.mesh.shapes import stepped_slab
from abfm.parameters import TABLE_1

CLAIM = (
    "A smooth field generates a continuous symmetric mapping although the geometry contains "
    "creases."
)


def figure(stage: Stage) -> Script:
    """Match the places on a slab with a step and a rotation, or by the symmetry of a given mesh."""
    mesh, name = stage.surface("stepped slab", stepped_slab, 2 if stage.small else 6)
    iterations = 60 if stage.small else words.affordable_iterations(mesh, 300)
    scene = Symmetric(mesh, name, detected(mesh))
    example = scene.example(TABLE_1[10].parameters(iterations=iterations))
    yield example

    found = stage.match(example.problem, shares=(0.0, 0.9))
    of_maps, notes = words.map_findings(words.maps_of_flow(found, "the map", MEASURED))
    sides, normals = mesh.edge_faces[~mesh.is_boundary_edge], face_normals(mesh)
    steep = (normals[sides[:, 0]] * normals[sides[:, 1]]).sum(axis=1) < np.cos(np.pi / 4)
    creases = "edges with an angle of more than 45 degrees, share"
    share = float(steep.sum() / max(len(steep), 1))
    measures = (*scene.measured(found), Measure(creases, share), *of_maps)
    rows = (function_row(found), scene.map_row(found))
    return Findings(measures, Sheet(rows, "z", scene.seen(), notes=notes), scene.words())
