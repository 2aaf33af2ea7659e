"""
Figure 9: a symmetry as a flow
==============================

In figure 9 of the paper, the flow of one field is a symmetry of the surface, here a rotation by 180
degrees. After twice the time, every point returns to its start, up to a small distance, the drift.
"""

import abfm
from abfm.io.sheets import Coordinates, Panel, Sheet, Values
from abfm.maps import detect_symmetry, map_accuracy
from abfm.mesh.shapes import two_armed
from abfm.parameters import TABLE_1
from abfm_viewer.pictures import figure_picture

# %%
# Find the symmetry
# -----------------
# A rotation by 180 degrees exchanges the two arms of this generated surface. ``vertex_map`` has
# the number of the image of each vertex.

mesh = two_armed(3)
symmetry = detect_symmetry(mesh, "rotation")

# %%
# Match the coordinates with their symmetric images
# -------------------------------------------------
# The target is the source, composed with the symmetry. One function does not determine a map, so
# the flow matches all three coordinates together. Sigma, the allowed difference of the functions,
# decreases in three stages. Without them, parts of the surface can turn in opposite directions.

source = mesh.normalized().vertices
target = source[symmetry.vertex_map]
parameters = TABLE_1[9].parameters(cooling_stages=3, iterations=100)
match = abfm.match(mesh, source, target, parameters)
print(f"mismatch relative to the target: {match.mismatch:.3f}")
match

# %%
# Measure the map
# ---------------
# The error of the map is the distance between the end of the flow and the symmetric point. Errors
# are geodesic distances in units of the square root of the area.

error = map_accuracy(match.flow.coordinate_map(), symmetry.vertex_map, count_max=150)
drift = map_accuracy(match.flow.coordinate_map(2.0), count_max=150)
print(f"mean error of the map at tau: {error.mean:.4f}")
print(f"mean drift at 2 tau: {drift.mean:.4f}")

# %%
# Show the coordinates as colours
# -------------------------------
# The red, green and blue of a point are its coordinates x, y and z at time 0.

times = {"t = 0": 0.0, "t = 0.5 tau": 0.5, "t = tau": 1.0, "t = 2 tau": 2.0}
colors = [
    Panel(mesh, Coordinates(match.push(mesh.vertices, time)), name) for name, time in times.items()
]
figure_picture(Sheet((tuple(colors),), view_functions=(abs(source).sum(axis=1),)))

# %%
# Match one function only
# -----------------------
# A single Gaussian is matched well, but its flow is not the symmetry on the rest of the surface.

bump = abfm.function(mesh, f"gaussian:vertex={source[:, 0].argmax()},width=0.2")
alone = abfm.match(mesh, bump, bump[symmetry.vertex_map], parameters)
error = map_accuracy(alone.flow.coordinate_map(), symmetry.vertex_map, count_max=150)
print(f"one function: mismatch {alone.mismatch:.3f}, mean error of the map {error.mean:.2f}")

functions = {"source": alone.source, "matched": alone.advected, "target": alone.target}
pictures = [Panel(mesh, Values(values[:, 0]), name) for name, values in functions.items()]
figure_picture(Sheet((tuple(pictures),)))
