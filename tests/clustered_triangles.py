"""A small model for placed images: clusters of triangles over a floor."""

import numpy as np

__all__ = ["clusters"]


def clusters(seed=3, count=9000):
    """Small triangles in clusters of different density on a floor of two large ones: positions, triangles."""
    rng = np.random.default_rng(seed)
    centres = rng.uniform([0.0, 0.0, 0.0], [60.0, 40.0, 8.0], size=(12, 3))
    middles = centres[rng.integers(12, size=count)] + rng.normal(size=(count, 3)) * rng.uniform(
        1.0, 6.0, size=(count, 1)
    )
    corners = middles[:, None] + rng.normal(scale=0.3, size=(count, 3, 3))
    floor = np.array([[-10.0, -10.0, -3.0], [70.0, -10.0, -3.0], [70.0, 50.0, -3.0], [-10.0, 50.0, -3.0]])
    positions = np.concatenate([corners.reshape(-1, 3), floor])
    triangles = np.arange(3 * count).reshape(-1, 3)
    return positions, np.concatenate([triangles, 3 * count + np.array([[0, 1, 2], [0, 2, 3]])])
