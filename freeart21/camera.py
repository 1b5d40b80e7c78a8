"""The pinhole camera: x right, y down, z forward; pixel (column u, row v) has its centre at (u + 0.5, v + 0.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from freeart21.errors import FreeArtError
from freeart21.se3 import Array


@dataclass(frozen=True)
class Camera:
    """Intrinsics of an undistorted pinhole camera."""

    K: Array
    """(3, 3) intrinsic matrix, pixels; no skew."""
    width: int
    """Columns."""
    height: int
    """Rows."""

    def __post_init__(self) -> None:
        K = np.array(self.K, float)
        if K.shape != (3, 3) or not np.isfinite(K).all():
            raise FreeArtError(f"camera K has shape {K.shape}, expected a finite (3, 3) matrix")
        if K[0, 0] <= 0 or K[1, 1] <= 0 or np.abs(K[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] - [0, 0, 0, 0, 1]).max() > 1e-9:
            raise FreeArtError(
                f"camera K is {K.tolist()}, expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with fx, fy > 0"
            )
        if self.width < 1 or self.height < 1:
            raise FreeArtError(f"camera size is {self.width} x {self.height}, expected at least 1 x 1")
        K.flags.writeable = False
        object.__setattr__(self, "K", K)

    @classmethod
    def from_fov(cls, width: int, height: int, fov_y: float) -> Camera:
        """A camera with square pixels, a centred principal point and vertical field of view `fov_y`, radians."""
        f = 0.5 * height / np.tan(0.5 * fov_y)
        return cls(np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]]), width, height)

    def project(self, points_camera: ArrayLike) -> Array:
        """Image coordinates (..., 2) of points (..., 3), metres; (0.5, 0.5) is the centre of the first pixel.

        Points with z <= 0 are behind the camera; their result is NaN.
        """
        p = np.asarray(points_camera, float)
        z = np.where(p[..., 2] > 0, p[..., 2], np.nan)
        return np.stack([self.K[0, 0] * p[..., 0] / z + self.K[0, 2], self.K[1, 1] * p[..., 1] / z + self.K[1, 2]], -1)

    def rays(self) -> Array:
        """(height, width, 3) directions with z = 1 through all pixel centres."""
        u = (np.arange(self.width) + 0.5 - self.K[0, 2]) / self.K[0, 0]
        v = (np.arange(self.height) + 0.5 - self.K[1, 2]) / self.K[1, 1]
        uu, vv = np.meshgrid(u, v)
        return np.stack([uu, vv, np.ones_like(uu)], -1)

    def backproject(self, depth: ArrayLike) -> Array:
        """Camera-frame points (height, width, 3) of a z-depth map (height, width), metres; 0 where depth is 0."""
        depth = np.asarray(depth, float)
        if depth.shape != (self.height, self.width):
            raise FreeArtError(f"depth has shape {depth.shape}, expected {(self.height, self.width)}")
        return np.asarray(self.rays() * depth[..., None])
