"""
Transfer labels and a texture
=============================

A registration transfers any data from one surface to the other. This example transfers labels of
body parts and a texture to a second pose, and measures how exactly both are transferred.
"""

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

import abfm
from abfm.assets import asset_path
from abfm.display import ViewSpec
from abfm.io.sheets import Checker, Panel, Sheet, Values
from abfm.registration import Texture, transfer_texture
from abfm_viewer.pictures import figure_picture, write_texture

a = abfm.load_mesh(asset_path("human_A.off"))
b = abfm.load_mesh(asset_path("human_B.off"))

# %%
# A registration
# --------------
#
# The initial map is computed from eigenfunctions of both shapes. The flow then moves five landmarks
# to their targets. The meshes have the same faces, so that vertex i of A is the true partner of
# vertex i of B. Only the measurements below use these true partners.

vertices = np.array([895, 276, 100, 1173, 583])  # hands, head and feet
registration = abfm.register(
    a, b, landmarks=np.stack([vertices, vertices], axis=1), initial="spectral"
)
print(registration.facts.headline)
registration

# %%
# Labels
# ------
#
# Labels are never averaged: each vertex of B gets the label with the largest weight at its point
# of A. The Dice coefficient measures the overlap of the transferred region and the true region. It
# is 1 if both regions are equal.

x, y, _ = a.vertices.T
labels = np.digitize(y, np.quantile(y, [0.2, 0.4, 0.6, 0.8]))
transferred = registration.transfer_labels(labels)
for label in range(5):
    one, other = labels == label, transferred == label
    print(f"label {label}: Dice {2 * (one & other).sum() / (one.sum() + other.sum()):.3f}")

# %%
# A texture
# ---------
#
# The texture of A is an image of a checkerboard. Its coordinates project the image from the front.
# The texture of B is a new image, in which each pixel has the colour of its point of A.

rows, columns = np.indices((1024, 1024)) // 64 % 2
blue, white = np.array([60, 90, 170, 255]), np.array([235, 235, 235, 255])
pixels = np.where((rows == columns)[..., None], blue, white).astype(np.uint8)
coordinates = (np.stack([x, y], axis=1) + 1) / 2
texture = Texture(a, coordinates[a.faces], [pixels])
on_b = transfer_texture(registration, texture, size=512)

exact = texture.at(registration.points.points)
difference = np.abs(on_b.at(abfm.maps.vertex_points(b, np.arange(len(b.vertices)))) - exact)
print(f"mean difference at the vertices: {difference.mean():.1f} of 255")

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder, "pose.glb")
    write_texture(path, on_b)
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB, any 3D viewer opens it")

# %%
# The picture shows labels and texture on A, and transferred to B.

figure_picture(
    Sheet(
        (
            (
                Panel(a, Values(labels.astype(float), "label"), "labels of A"),
                Panel(b, Values(transferred.astype(float), "label"), "transferred to B"),
                Panel(a, Checker(8 * coordinates), "texture of A"),
                Panel(b, Checker(8 * registration.transfer(coordinates)), "transferred to B"),
            ),
        ),
        view=ViewSpec(up="y"),
    )
)

# %%
# The texture image of B has a new layout. Faces that are neighbours on B may be far apart in it.

Image.fromarray(on_b.images[0])
