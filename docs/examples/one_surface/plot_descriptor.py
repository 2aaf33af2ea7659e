"""
Match a shape descriptor
========================

The heat kernel signature describes the shape around each point of a surface. This example advects
it along a known flow, recovers a flow from the two functions, and compares the two flows.
"""

import numpy as np

import abfm
from abfm.assets import asset_path
from abfm_viewer.pictures import match_picture

mesh = abfm.load_mesh(asset_path("human_A.off"))

# %%
# A descriptor, moved by a known flow
# -----------------------------------
#
# The signature is the heat that remains at a point after a diffusion time. It is large at the ends
# of the limbs. The known velocity is the tangential part of a constant vector that points upwards.
# ``truth`` maps each vertex to the point from which the flow brings its value.

source = abfm.function(mesh, "hks:time=0.02")
normals = abfm.calculus.face_normals(mesh)
upwards = np.array([0.0, 0.1, 0.0])
velocity = upwards - (normals @ upwards)[:, None] * normals
truth = abfm.Flow(mesh, velocity, 1.0).point_map()
target = truth.pull_back(source)

# %%
# The match
# ---------
#
# The match uses the two functions only. The residual is the root mean square of the difference
# between the advected source and the target, divided by the standard deviation of the target. The
# view below is live: drag to rotate it, and press the space bar to play the flow.

match = abfm.match(mesh, source, target)
print(match.facts.headline)
print(f"residual along flow lines: {match.verified_residual:.3f}")
match

# %%
# The same match as a picture: the source, the advected source at several times, and the target.

match_picture(match)

# %%
# The recovered map
# -----------------
#
# A function determines the motion across its level sets, but not along them. The recovered map is
# therefore close to the known map, but not equal. The mean distance between the images of a vertex
# by both maps is smaller than the mean displacement by the known flow. Distances are relative to
# the square root of the area.

recovered = match.point_map().positions
displacement = np.linalg.norm(mesh.vertices - truth.positions, axis=1).mean()
error = np.linalg.norm(recovered - truth.positions, axis=1).mean()
print(f"mean displacement by the known flow: {displacement / mesh.length_scale:.3f}")
print(f"mean error of the recovered map:     {error / mesh.length_scale:.3f}")
