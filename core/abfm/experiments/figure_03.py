"""Figure 3: a large smooth Gaussian becomes two small ones, beside optimal transport and the linear blend."""

from abfm.experiments.experiment import Experiment
from abfm.experiments.meshes import three_arms
from abfm.experiments.one_to_two import OneToTwo, one_to_two, run
from abfm.experiments.table_1 import TABLE_1
from abfm.mesh import TriangleMesh


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> OneToTwo:
    """Gaussians at far ends of a surface, by default a body with one thick arm and two thin ones."""
    parameters = TABLE_1[3].parameters(iterations=60 if small else 150)
    if mesh is not None:
        return one_to_two(mesh, "mesh", parameters)
    body, tips = three_arms(3 if small else 5)
    return one_to_two(body, "body with three arms", parameters, tips)


EXPERIMENT = Experiment(
    3, "The result matches the target, and values are displaced in space, as by optimal transport.", set_up, run
)
