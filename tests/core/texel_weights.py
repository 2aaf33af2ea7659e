"""Where texels lie in their faces."""

import numpy as np


def texel_weights(atlas, rows, columns):
    """Barycentric weights (n, 3) of the centres of texels that belong to a face, or hang over."""
    corners = np.moveaxis(atlas.corners[atlas.texel_faces[rows, columns]], 2, 1)
    matrices = np.concatenate([corners, np.ones((len(rows), 1, 3))], axis=1)
    centres = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    return np.linalg.solve(matrices, centres[:, :, None])[:, :, 0]
