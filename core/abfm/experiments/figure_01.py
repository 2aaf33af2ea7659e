"""Figure 1: a single field carries one Gaussian to two at the other end of a body; the way between, beside others."""

from abfm.experiments.experiment import Experiment
from abfm.experiments.meshes import bundled, smoothed
from abfm.experiments.one_to_two import OneToTwo, one_to_two, run
from abfm.experiments.table_1 import TABLE_1
from abfm.mesh import TriangleMesh


def set_up(mesh: TriangleMesh | None = None, small: bool = False) -> OneToTwo:
    """Gaussians at far ends of a body, by default a human's hand and feet."""
    parameters = TABLE_1[1].parameters(iterations=100 if small else 300)
    if mesh is not None:
        return one_to_two(mesh, "mesh", parameters)
    body = "human_A.off"
    chosen = (bundled(body), body) if small else (smoothed(body, 1), f"{body} after a Loop subdivision")
    return one_to_two(*chosen, parameters)


EXPERIMENT = Experiment(
    1,
    "A single vector field advects the source to a function that matches the target, and interpolates smoothly.",
    set_up,
    run,
)
