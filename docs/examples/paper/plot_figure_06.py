"""
Figure 6: a field transported along another field
=================================================

The paper transports a field u along the flow of another field v with the operator exponential of
the Lie bracket (Eq. 12).
"""

import numpy as np

import abfm
from abfm.calculus import averaging, face_areas, pushforward, to_ambient, to_frame
from abfm.io.sheets import Panel, Sheet, Streaks
from abfm.mesh.shapes import geodesic_sphere
from abfm_viewer.pictures import figure_picture

# %%
# Two fields on a sphere
# ----------------------
# The field v rotates the sphere about the y axis by half a turn in one unit of time. The field u
# is a vortex, so the exact result is the same vortex at the rotated centre.

mesh = geodesic_sphere(12)
points = mesh.vertices[mesh.faces].mean(axis=1)
v = to_ambient(mesh, to_frame(mesh, np.pi * np.cross([0, 1, 0], points)))


def vortex(time):
    """Return the vortex that has moved with v for some time, (F, 3)."""
    angle = np.pi * time - 0.6
    centre = np.array([np.sin(angle), 0, np.cos(angle)])
    field = np.cross(centre, points) * np.exp((points @ centre - 1) / 0.16)[:, None]
    return to_ambient(mesh, to_frame(mesh, field))


# %%
# Transport the field
# -------------------
# The operator ad_v is the Lie bracket with v. With the bracket of Eq. 10, exp(-t ad_v) u is the
# pushforward, the field u transported along v. The paper prints exp(t ad_v) u, which transports u
# in the opposite direction.

areas = face_areas(mesh)[:, None]
times = (0.125, 0.25)
pushed = [pushforward(mesh, v, vortex(0), time) for time in times]


def error(field, time):
    """Return the error of a field in L2, relative to the exact field."""
    exact = vortex(time)
    return np.sqrt((areas * (field - exact) ** 2).sum() / (areas * exact**2).sum())


for time, field in zip(times, pushed, strict=True):
    printed = error(pushforward(mesh, v, vortex(0), -time), time)
    print(f"t = {time}: error {error(field, time):.3f}, with the printed sign {printed:.2f}")


def panel(field, name):
    """Return a picture of the flow lines of a field, coloured by its speed."""
    speed = averaging(mesh) @ np.linalg.norm(field, axis=1)
    return Panel(mesh, Streaks(field, speed, "speed"), name)


names = [f"u at t = {time}" for time in times]
moved = [panel(field, name) for field, name in zip(pushed, names, strict=True)]
figure_picture(Sheet(((panel(vortex(0), "u"), *moved),)))

# %%
# Move a function along the field
# -------------------------------
# A function moves with the flow of v. The view shows a Gaussian at the centre of the vortex.

f = np.exp((mesh.vertices @ [np.sin(-0.6), 0, np.cos(-0.6)] - 1) / 0.16)
flow = abfm.Flow(mesh, v, tau=0.25)
abfm.match(
    mesh, f, flow.push(f), abfm.Parameters(tau=0.25, sigma=0.05, refine=0), start=flow.velocity
)
