"""
Register a population and find an outlier
=========================================

Functions of several subjects are registered to a template, and their mean becomes the next target.
In this example, five subjects are made by known flows from one pattern. A sixth subject, the
outlier, has the wrong sign.
"""

import tempfile
from pathlib import Path

import numpy as np
import trimesh

import abfm
from abfm.io.sheets import Panel, Sheet, Values
from abfm.population import Channel, Cohort, Settings, Subject
from abfm_viewer.pictures import figure_picture

# %%
# The subjects
# ------------
#
# Each subject is the pattern, moved by a random smooth flow, with noise. The values of each subject
# are in a file, as they would be for measured data.

mesh = abfm.load_mesh(trimesh.creation.icosphere(subdivisions=3))
x, y, z = mesh.vertices.T
pattern = np.sin(4 * y + 1) + 0.7 * np.sin(5 * x) + 0.5 * np.cos(4 * z)
centres = mesh.vertices[mesh.faces].mean(axis=1)
random = np.random.default_rng(1)
folder = tempfile.TemporaryDirectory()


def subject(name: str, sign: float = 1) -> Subject:
    """Write the values of a subject, and return its description."""
    axes = random.normal(scale=0.2, size=(2, 3))
    velocity = np.cross(axes[0] + np.sin(2 * centres) * axes[1], centres)
    values = sign * abfm.Flow(mesh, velocity, 1.0).point_map().pull_back(pattern)
    path = Path(folder.name, f"{name}.npy")
    np.save(path, values + random.normal(scale=0.05, size=len(values)))
    return Subject(name, (f"file:{path}",))


subjects = [subject(f"subject {number}") for number in range(1, 6)]
subjects.append(subject("subject 6", sign=-1))

# %%
# Registration
# ------------
#
# The first target is the pattern on the template. One round is enough here. The options of the
# registrations make them fast: few iterations, a given sigma, and no finer meshes.

np.save(Path(folder.name, "pattern.npy"), pattern)
settings = Settings(
    functions={"pattern": f"file:{folder.name}/pattern.npy"},
    options={"refine": 0, "iterations": 30, "sigma": 0.1},
    rounds=1,
)
cohort = Cohort((Channel("pattern"),), tuple(subjects))
population = abfm.register_population(cohort, mesh, Path(folder.name, "results"), settings)
print(population.facts.headline)
for name, fits, reason in zip(population.names, population.fits, population.reasons, strict=True):
    print(f"{name}: {'fits' if fits else reason}")
population

# %%
# Registration removes differences of position. The mean of the registered subjects is therefore
# sharper than the plain mean, and their standard deviation is smaller.

fitting = population.fits
before = population.before[fitting, :, 0].std(axis=0, ddof=1)
print(f"mean standard deviation before registration: {before.mean():.3f}")
print(f"mean standard deviation after registration:  {population.deviation().mean():.3f}")
functions = {
    "pattern": pattern,
    "plain mean": population.plain_mean(),
    "registered mean": population.mean(),
}
panels = [Panel(mesh, Values(each, "pattern"), label) for label, each in functions.items()]
folder.cleanup()
figure_picture(Sheet((tuple(panels),)))
