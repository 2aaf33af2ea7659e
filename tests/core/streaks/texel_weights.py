"""Barycentric weights of texels, and bilinear filtering."""

import numpy as np


def texel_weights(atlas, rows, columns):
    """Return barycentric weights (n, 3) of texel centres, also beyond the edge of their face."""
    corners = np.moveaxis(atlas.corners[atlas.texel_faces[rows, columns]], 2, 1)
    matrices = np.concatenate([corners, np.ones((len(rows), 1, 3))], axis=1)
    centres = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    return np.linalg.solve(matrices, centres[:, :, None])[:, :, 0]


def filtered(image, places):
    """Return bilinearly filtered values at places (n, 2), column and row in texels, as on GPUs."""
    low = np.floor(places - 0.5).astype(int)
    u, v = (places - 0.5 - low).T
    total = np.zeros(len(places))
    for dx, dy in np.ndindex(2, 2):
        weight = (u if dx else 1 - u) * (v if dy else 1 - v)
        column, row = np.minimum(low + np.array([dx, dy]), len(image) - 1).T
        total += np.where(weight > 1e-9, weight * image[row, column], 0)
    return total
