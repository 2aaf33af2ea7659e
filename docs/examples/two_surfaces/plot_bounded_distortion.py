"""
Limit the distortion of a map
=============================

A close match of functions may stretch a surface more than is plausible. This example registers two
surfaces with and without a bound of the distortion. It compares the residuals, the remaining
differences of the functions relative to their standard deviation.
"""

import trimesh

import abfm
from abfm.io.sheets import Checker, Panel, Sheet
from abfm_viewer.pictures import figure_picture

# %%
# Two surfaces
# ------------
#
# A is a sphere and B is an ellipsoid with the same faces. The function of A has two bumps. On B the
# bumps are further apart.

a = abfm.load_mesh(trimesh.creation.icosphere(subdivisions=3))
b = abfm.TriangleMesh(a.vertices * [1.1, 1.0, 0.9], a.faces)
bumps = "gaussian:x={0},y={1},z={2},width=0.15+gaussian:x=-{0},y={1},z={2},width=0.15"
f = abfm.function(a, bumps.format(0.4, 0.3, 0.9))
g = abfm.function(b, bumps.format(0.55, 0.2, 0.8))

# %%
# Two registrations
# -----------------
#
# With a bound of 1, areas and aspect ratios change by at most a factor of 2 on 99% of the faces.
# In addition, no face is folded. For each face, the distortion is the larger one of
# :math:`|\log_2 J|` and :math:`|\log_2 R|`. J is the change of area of the face and R the change of
# its aspect ratio. For each map, the example prints the bound that 99% of the faces satisfy.

parameters = abfm.Parameters(refine=0)
free, bounded = (
    abfm.register(a, b, f, g, initial="connectivity", parameters=parameters, max_distortion=bound)
    for bound in (None, 1.0)
)
for name, registration in {"without a bound": free, "bound of 1     ": bounded}.items():
    distortion = registration.distortion()
    print(
        f"{name}: residual {registration.residual:.3f}, "
        f"99% of the faces within {distortion.bound_of(0.99):.2f}, {distortion.folded} folded"
    )

# %%
# This is the registration with the bound, as a live view.

bounded

# %%
# The picture shows a checkerboard on A, and transferred to B by both maps.

board = 3 * a.vertices[:, :2]
panels = (
    Panel(a, Checker(board), "A"),
    Panel(b, Checker(free.transfer(board)), "B, without a bound"),
    Panel(b, Checker(bounded.transfer(board)), "B, bound of 1"),
)
figure_picture(Sheet((panels,), view_functions=(f,), one_view=True))
