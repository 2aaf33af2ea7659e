"""Where texels lie in their faces."""

import numpy as np


def texel_weights(atlas, rows, columns):
    """Barycentric weights (n, 3) of the centres of texels that belong to a face, or hang over."""
    corners = np.moveaxis(atlas.corners[atlas.texel_faces[rows, columns]], 2, 1)
    matrices = np.concatenate([corners, np.ones((len(rows), 1, 3))], axis=1)
    centres = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    return np.linalg.solve(matrices, centres[:, :, None])[:, :, 0]


def filtered(image, places):
    """Bilinear filtering at places (n, 2), column and row, in texels, as graphics cards do it."""
    low = np.floor(places - 0.5).astype(int)
    u, v = (places - 0.5 - low).T
    total = np.zeros(len(places))
    for dx, dy in np.ndindex(2, 2):
        weight = (u if dx else 1 - u) * (v if dy else 1 - v)
        column, row = np.minimum(low + np.array([dx, dy]), len(image) - 1).T
        total += np.where(weight > 1e-9, weight * image[row, column], 0)
    return total
