"""
Figure 5: the smoothest commuting field
=======================================

Two vector fields commute if their Lie bracket is zero. The paper shows a field v, and the smoothest
one of the many fields that commute with v. A sparse eigenvalue problem determines this field.
"""

import numpy as np

import abfm
from abfm.calculus import commuting_fields, relative_bracket, to_ambient, to_frame
from abfm.io.sheets import Panel, Sheet, Streaks
from abfm.mesh.shapes import torus
from abfm_viewer.pictures import figure_picture

# %%
# Find the field
# --------------
# On a torus this field is known. The field v rotates the torus about its axis. The smoothest other
# field that commutes with v moves around the tube.

mesh = torus(48, 24)
x, y, z = mesh.vertices[mesh.faces].mean(axis=1).T
v = np.stack([z, 0 * y, -x], axis=1)
[u] = commuting_fields(mesh, v)

# %%
# Check that it commutes
# ----------------------
# On a mesh, the Lie bracket of u and v is not exactly zero, but proportional to the edge length.
# This bracket is much smaller than the brackets of v with other smooth fields.

others = commuting_fields(mesh, v, 8, weight=0)
print(f"bracket with v: {relative_bracket(mesh, v, u):.2f}")
brackets = [relative_bracket(mesh, v, w) for w in others]
print(f"median bracket of v with other smooth fields: {np.median(brackets):.2f}")

# %%
# If fields commute, points arrive at the same place along both flows in either order.

along_v, along_u = abfm.Flow(mesh, v, tau=0.3), abfm.Flow(mesh, u, tau=0.3)
first_v = along_u.push(along_v.push(mesh.vertices))
first_u = along_v.push(along_u.push(mesh.vertices))
distance = np.linalg.norm(first_v - first_u) / np.linalg.norm(first_v - mesh.vertices)
print(f"distance of the end points relative to the displacement: {distance:.4f}")

# %%
# Compare with the exact field
# ----------------------------
# On the torus, the exact field u is harmonic. Its speed is inversely proportional to the distance
# from the axis.

ring = np.hypot(x, z)
exact = np.stack([-y * x / ring, ring - 1, -y * z / ring], axis=1)
exact /= np.linalg.norm(exact, axis=1)[:, None] * ring[:, None]
exact = to_ambient(mesh, to_frame(mesh, exact))
cosine = abs((u * exact).sum()) / np.linalg.norm(u) / np.linalg.norm(exact)
print(f"cosine of the angle between u and the exact field: {cosine:.4f}")

figure_picture(
    Sheet(((Panel(mesh, Streaks(v), "v"), Panel(mesh, Streaks(u), "u, commutes with v")),))
)

# %%
# Move a function along the field
# -------------------------------
# The view shows a function that the flow of u moves around the tube of the torus.

f = abfm.function(mesh, "gaussian:vertex=0,width=0.15")
abfm.match(
    mesh, f, along_u.push(f), abfm.Parameters(tau=0.3, sigma=0.05, refine=0), start=along_u.velocity
)
