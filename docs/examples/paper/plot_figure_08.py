"""
Figure 8: optical flow
======================

In figure 8 of the paper, a function is advected along a known field. The field is then recovered
from the two functions alone. The recovered field is very close to the original one.
"""

import numpy as np
import trimesh

import abfm
from abfm.assets import asset_path
from abfm.calculus import averaging, face_areas, face_normals, gradient, to_ambient, unit_eigenbasis
from abfm.io.sheets import Panel, Sheet, Streaks, Values
from abfm.parameters import TABLE_1
from abfm_viewer.pictures import figure_picture

# %%
# Advect a function along a known field
# -------------------------------------
# The field is the gradient of two eigenfunctions, rotated by 90 degrees, so it has no divergence.
# It moves points by 0.15 sqrt(area) on average until tau = 10. The mesh is subdivided once.

coarse = abfm.load_mesh(asset_path("eight.off"))
shape = trimesh.Trimesh(coarse.vertices, coarse.faces, process=False).subdivide_loop(1)
mesh = abfm.TriangleMesh(shape.vertices, shape.faces)

parameters = TABLE_1[8].parameters(iterations=100)
basis = unit_eigenbasis(mesh, 8)[1]
slope = to_ambient(mesh, (gradient(mesh) @ (basis[:, 2] + 0.7 * basis[:, 5])).reshape(-1, 2))
original = np.cross(face_normals(mesh), slope)
areas = face_areas(mesh)


def root_mean_square(field):
    """Return the root mean square of a field over the surface."""
    return np.sqrt(areas @ (field**2).sum(axis=1) / areas.sum())


original *= 0.15 * mesh.length_scale / parameters.tau / root_mean_square(original)
source = abfm.function(mesh, "eigenfunction:7")
target = abfm.Flow(mesh, original, parameters.tau).push(source)

# %%
# Recover the field
# -----------------

match = abfm.match(mesh, source, target, parameters)
print(f"largest difference of the functions: {abs(match.advected[:, 0] - target).max():.4f}")
match

# %%
# Compare the fields
# ------------------
# The functions do not determine the complete field, because motion along the level lines of a
# function does not change it. Only the smoothness of the field determines this part.

found = match.velocity[0]
error = root_mean_square(found - original) / root_mean_square(original)
print(f"error of the field relative to the original: {error:.3f}")


def panels(field, name):
    """Return pictures of a field and of its speed."""
    speed = averaging(mesh) @ np.linalg.norm(field, axis=1)
    return Panel(mesh, Streaks(field), name), Panel(mesh, Values(speed, "speed"), f"{name}, speed")


figure_picture(Sheet(((*panels(original, "original"), *panels(found, "recovered")),)))
