"""
Register two poses by landmarks and functions
=============================================

Landmarks are pairs of points that must correspond, and functions guide the rest of the map. This
example registers two poses of a body whose features have moved along the skin by a known flow.
"""

import numpy as np

import abfm
from abfm.assets import asset_path
from abfm.display import ViewSpec
from abfm.io.sheets import Checker, Panel, Sheet
from abfm.maps import SurfacePoints, vertex_points
from abfm_viewer.pictures import figure_picture

a = abfm.load_mesh(asset_path("human_A.off"))
b = abfm.load_mesh(asset_path("human_B.off"))

# %%
# Features with a known map
# -------------------------
#
# Both meshes have the same faces, so each point of B has a partner on A. The true map has two
# parts. A point of B is first moved along a known flow on B, and then mapped to its partner on A.
# The functions of B are those of A, transferred by the true map.

normals = abfm.calculus.face_normals(b)
upwards = np.array([0.0, 0.1, 0.0])
velocity = upwards - (normals @ upwards)[:, None] * normals
true_points = abfm.Flow(b, velocity, 1.0).point_map().points
truth = SurfacePoints(a, true_points.faces, true_points.barycentric)

x, y, _ = a.vertices.T
f = np.stack([np.sin(6 * x), np.sin(6 * y)], axis=1)
g = truth.pull_back(f)


def report(name: str, registration: abfm.Correspondence) -> None:
    """Print the mean error of a map, relative to the square root of the area."""
    error = np.linalg.norm(registration.points.positions - truth.positions, axis=1).mean()
    print(f"{name}: mean error {error / a.length_scale:.4f}")


# %%
# Registration
# ------------
#
# The landmarks are twelve vertices of B and the corresponding points of A. The initial map maps
# each vertex of B to the vertex of A with the same number. Landmarks improve this map. Functions
# improve the map further between the landmarks.

vertices = np.arange(50, 1229, 100)
landmarks = (truth[vertices], vertex_points(b, vertices))
by_landmarks = abfm.register(a, b, landmarks=landmarks, initial="connectivity")
by_both = abfm.register(a, b, f, g, landmarks=landmarks, initial="connectivity")
report("initial map            ", by_both.initial)
report("landmarks              ", by_landmarks)
report("landmarks and functions", by_both)
print(f"largest error of a landmark: {by_both.landmark_errors.max():.5f}")

# %%
# The view is live: drag to rotate both surfaces, and press the space bar to play the flow.

by_both

# %%
# The picture shows a checkerboard on A, transferred to B by each map, and the landmarks as points.

board = 6 * a.vertices[:, :2]
panels = [Panel(a, Checker(board), "A", points=landmarks[0].positions)]
for label, shown in (("initial map", by_both.initial), ("registered", by_both)):
    paint = Checker(shown.transfer(board))
    panels.append(Panel(b, paint, label, points=landmarks[1].positions))
figure_picture(Sheet((tuple(panels),), view=ViewSpec(up="y")))
