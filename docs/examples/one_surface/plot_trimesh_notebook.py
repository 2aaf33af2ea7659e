"""
Use a mesh of trimesh in a notebook
===================================

abfm accepts meshes of trimesh, PyVista, meshio, nilearn and nibabel, file names, and pairs of
arrays. This example matches and registers meshes of trimesh, and shows each result in its cell.
"""

import trimesh

import abfm
from abfm.assets import asset_path
from abfm_viewer.pictures import match_picture

# %%
# A mesh
# ------
#
# A mesh or a result at the end of a cell is shown as a live view. Drag to rotate it, turn the wheel
# to zoom, and press the space bar to play a flow. Download this page as a notebook to try it.

surface = trimesh.load_mesh(asset_path("eight.off"), process=False)
mesh = abfm.load_mesh(surface)
mesh

# %%
# Match two functions
# -------------------
#
# The flow of the resulting field advects the source to the target. The residual is the remaining
# difference, relative to the standard deviation of the target. It is measured in two ways: for the
# flow of the solver, and along flow lines, which do not depend on the solver.

source = abfm.function(mesh, "gaussian:vertex=10,width=0.25")
target = abfm.function(mesh, "gaussian:vertex=30,width=0.25")
match = abfm.match(surface, source, target)
print(f"residual {match.residual:.3f}, along flow lines {match.verified_residual:.3f}")
match

# %%
# The same match as a picture, for example for a paper.

match_picture(match)

# %%
# Register two surfaces
# ---------------------
#
# The initial map transfers the function of A to B. The flow of a field on B then advects it to the
# function of B.

a, b = (trimesh.load_mesh(asset_path(f"human_{pose}.off"), process=False) for pose in "AB")
spot = "gaussian:vertex=394,width=0.2"
registration = abfm.register(a, b, spot, spot)
print(f"residual {registration.residual:.3f}")
registration

# %%
# ``registration.show()`` opens the same view as a page in a browser, with more detail, and
# ``registration.show("registration.html")`` also saves the page.
