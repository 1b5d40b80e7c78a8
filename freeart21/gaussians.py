"""An articulated object as 3D Gaussians: both parts in one canonical frame, each Gaussian with a part weight."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.se3 import Floats

LIGHT_TERMS = (1, 4, 9, 16, 25)
"""Numbers of spherical harmonics up to degrees 0 to 4."""
FAINT_COPY = 0.02
"""Opacity up to which a Gaussian's copy under the other part's motion is not drawn: five grey levels. Drawing all would
double the splats."""
TURNED_AWAY = -0.1
"""Cosine of the angle between normal and view from which a disc shows its back, and is not drawn."""

_WIDTHS = {"means": 3, "quaternions": 4, "scales": 3, "opacities": 0, "colours": 3, "part_weights": 0, "normals": 3}


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians in the canonical frame of an `Articulation`, joint state zero; arrays are float32.

    In a frame with joint motion J, a Gaussian of part weight w is drawn in place with its opacity times w, and moved by
    J with its opacity times 1 - w (paper, Blended Rendering). With `light` it is a disc that shows its outer face only;
    Gaussians without light, from other methods, are visible from all sides.
    """

    means: Floats
    """(N, 3) metres."""
    quaternions: Floats
    """(N, 4) unit, wxyz: canonical from Gaussian."""
    scales: Floats
    """(N, 3) standard deviations along the Gaussian's own axes, metres."""
    opacities: Floats
    """(N,) 0 to 1."""
    colours: Floats
    """(N, 3) sRGB, 0 to 1, in mean light."""
    part_weights: Floats
    """(N,) 0 to 1: 1 for the reference part, 0 for the moving part."""
    normals: Floats
    """(N, 3) unit, outward."""
    light: Floats | None = None
    """(L, 3) light by the direction of a normal in the recording camera's frame, in which the lamps are fixed:
    coefficients of real spherical harmonics, orthonormal, by degree l and order -l to l, of mean 1 over the video. An
    image shows colours times light. None for uniform light."""
    supposed: NDArray[np.bool_] | None = field(default=None, kw_only=True)
    """(N,) whether nobody saw the surface that a Gaussian lies on. None: all of it was seen, or nobody knows."""

    def __post_init__(self) -> None:
        n = len(self.means)
        for name, width in _WIDTHS.items():
            array = np.array(getattr(self, name), np.float32)
            expected = (n, width) if width else (n,)
            if array.shape != expected:
                raise FreeArtError(f"gaussians' {name} have shape {array.shape}, expected {expected}")
            if not np.isfinite(array).all():
                raise FreeArtError(f"gaussians' {name} are not all finite")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if self.light is not None:
            light = np.array(self.light, np.float32)
            if light.ndim != 2 or light.shape[0] not in LIGHT_TERMS or light.shape[1] != 3:
                terms = ", ".join(map(str, LIGHT_TERMS))
                raise FreeArtError(f"gaussians' light has shape {light.shape}, expected ({terms}; 3)")
            light.flags.writeable = False
            object.__setattr__(self, "light", light)
        if self.supposed is not None and self.supposed.shape != (n,):
            raise FreeArtError(f"gaussians' supposed have shape {self.supposed.shape}, expected ({n},)")

    def __len__(self) -> int:
        return len(self.means)

    def chosen(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Gaussians:
        """Some of the Gaussians, by flags (N,) or indices."""
        names = [*_WIDTHS, *(["supposed"] if self.supposed is not None else [])]
        return replace(self, **{name: getattr(self, name)[which] for name in names})

    def moved(self, T_new_old: ArrayLike) -> Gaussians:
        """The same in another canonical frame, `T_new_old` (4, 4)."""
        T = np.asarray(T_new_old, float)
        return replace(
            self,
            means=se3.transform(T, self.means).astype(np.float32),
            quaternions=multiply(se3.wxyz(T), self.quaternions).astype(np.float32),
            normals=(self.normals @ T[:3, :3].T).astype(np.float32),
        )


def face_along(normals: ArrayLike) -> NDArray[np.float64]:
    """(N, 4) unit quaternions, wxyz, of discs whose third axis is along unit `normals` (N, 3)."""
    z = np.asarray(normals, float)
    x = np.cross(np.where(np.abs(z[:, :1]) < 0.7, np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]])), z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return se3.wxyz(np.stack([x, np.cross(z, x), z], 2))


def multiply(a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
    """Quaternion product (..., 4), wxyz: rotation b, then a."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, float), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, float), -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )
