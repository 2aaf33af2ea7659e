"""Figure 3: as figure 1, a large smooth Gaussian becomes two small ones."""

from abfm.experiments.figure_01 import far_ends, one_to_two
from abfm.experiments.vocabulary import Script, Stage
from abfm.mesh.shapes import three_arms
from abfm.parameters import TABLE_1

CLAIM = "The result matches the target, and values are displaced in space, as by optimal transport."


def figure(stage: Stage) -> Script:
    """Gaussians at far ends, by default of a body with one thick arm and two thin ones."""
    mesh, name, ends = stage.mesh, stage.name, None
    if mesh is None:
        (mesh, ends), name = three_arms(3 if stage.small else 5), "body with three arms"
    parameters = TABLE_1[3].parameters(iterations=60 if stage.small else 150)
    return one_to_two(stage, mesh, name, parameters, ends or far_ends(mesh))
