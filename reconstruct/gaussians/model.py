"""The articulated model: canonical Gaussians of both parts with soft part weights, and light.

Paper, Blended Rendering: G_i = w (G o I) u (1 - w)(G o J_i). Light is added: lamps stand still while the object turns,
so a Gaussian's colour is multiplied by the irradiance of its orientation, which all Gaussians share (spherical
harmonics: Ramamoorthi and Hanrahan 2001).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.gaussians import FAINT_COPY, TURNED_AWAY, Gaussians
from freeart21.se3 import Array, Floats, Ints
from reconstruct.gaussians.rasteriser import SplatGradients, Splats
from reconstruct.kernels import run_in_threads

_F = np.float32
DARKEST = 0.02
"""Smallest light, relative to the mean."""


@dataclass
class Parameters:
    """The optimised parameters, float32; or their gradient."""

    means: Floats
    """(N, 3) metres."""
    quaternions: Floats
    """(N, 4) wxyz, not normalised; the third axis is the outward normal."""
    log_scales: Floats
    """(N, 3)."""
    opacity_logits: Floats
    """(N,)."""
    colours: Floats
    """(N, 3) sRGB in mean light; may leave 0 to 1 during optimisation."""
    weight_logits: Floats
    """(N,) of the part weights."""
    light: Floats
    """(L, 3) as `Gaussians.light`."""

    def __len__(self) -> int:
        return len(self.means)

    def select(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Parameters:
        """The Gaussians `which` alone."""
        own = {name: values[which] for name, values in self.arrays().items() if name != "light"}
        return Parameters(**own, light=self.light)

    def zeros(self) -> Parameters:
        """Zeros of the same shapes."""
        return Parameters(*(np.zeros_like(getattr(self, f.name)) for f in fields(self)))

    def arrays(self) -> dict[str, Floats]:
        """Name to array."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def gaussians(self, blended: bool = True) -> Gaussians:
        """As `Gaussians`; without `blended` the part weights are rounded to 0 or 1."""
        q, scales, colours, normals = (np.empty((len(self), k), np.float32) for k in (4, 3, 3, 3))
        opacities, weights = np.empty(len(self), np.float32), np.empty(len(self), np.float32)
        own = (self.quaternions, self.log_scales, self.opacity_logits, self.colours, self.weight_logits)
        shaped = (*own, q, scales, opacities, colours, weights, normals)
        run_in_threads(lambda begin, end: _activate(begin, end, *shaped), len(self), 2000)
        return Gaussians(
            self.means, q, scales, opacities, colours, weights if blended else np.round(weights), normals, self.light
        )


def sigmoid(x: Floats) -> Floats:
    """1 / (1 + exp(-x))."""
    return np.asarray(1 / (1 + np.exp(-x)), np.float32)


@njit(nogil=True, cache=True, error_model="numpy")
def _activate(
    begin: int, end: int, quaternions: Floats, log_scales: Floats, opacity_logits: Floats, raw_colours: Floats,
    weight_logits: Floats, q: Floats, scales: Floats, opacities: Floats, colours: Floats, weights: Floats,
    normals: Floats,
) -> None:  # pragma: no cover  # fmt: skip
    """`Gaussians` from the `Parameters` begin to end."""
    one, two = _F(1), _F(2)
    for g in range(begin, end):
        w, x, y, z = quaternions[g, 0], quaternions[g, 1], quaternions[g, 2], quaternions[g, 3]
        over = one / math.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w * over, x * over, y * over, z * over
        q[g, 0], q[g, 1], q[g, 2], q[g, 3] = w, x, y, z
        normals[g, 0], normals[g, 1] = two * (x * z + w * y), two * (y * z - w * x)
        normals[g, 2] = one - two * (x * x + y * y)
        for k in range(3):
            scales[g, k] = math.exp(log_scales[g, k])
            colours[g, k] = min(one, max(_F(0), raw_colours[g, k]))
        opacities[g] = one / (one + math.exp(-opacity_logits[g]))
        weights[g] = one / (one + math.exp(-weight_logits[g]))


def logit(p: Floats) -> Floats:
    """The inverse of `sigmoid`, of p cut to 1e-4 from 0 and 1."""
    p = np.clip(p, 1e-4, 1 - 1e-4)
    return np.asarray(np.log(p / (1 - p)), np.float32)


SplatBackward = Callable[[SplatGradients], dict[str, Floats]]


def make_splats(gaussians: Gaussians, Ts: Array, lit: Array | None = None) -> tuple[Splats, SplatBackward]:
    """The splats to draw in a frame with poses Ts (2, 4, 4) of the two parts, and the backward pass.

    `lit` (2, 4, 4) are the parts' poses in the recording camera's frame, which determine the light; Ts when None. Discs
    that face away and copies too faint to matter are left out. The backward pass gives derivatives by means,
    quaternions, scales, opacities, colours, part_weights and light, with the normals that determine light held fixed,
    and `screen` and `drawn` of `SplatGradients`, summed over a Gaussian's copies.
    """
    poses = np.ascontiguousarray(Ts, np.float32)
    opacities, weights = gaussians.opacities, gaussians.part_weights
    index, motion = _select(gaussians.means, gaussians.normals, opacities, weights, poses)
    light = np.full((1, 3), 1 / 0.28209479, np.float32) if gaussians.light is None else gaussians.light
    m = len(index)
    colours, shades = np.empty((m, 3), np.float32), np.empty((m, 3), np.float32)
    harmonics = np.empty((m, len(light)), np.float32)
    turned = poses if lit is None else np.ascontiguousarray(lit, np.float32)
    shading = (index, motion, gaussians.normals, gaussians.colours, turned, light, harmonics, shades, colours)
    run_in_threads(lambda a, b: _light(a, b, *shading), m, 2000)
    share = np.where(motion == 0, weights[index], 1 - weights[index])
    shape = (gaussians.means[index], gaussians.quaternions[index], gaussians.scales[index], opacities[index] * share)
    splats = Splats(*shape, colours, motion)

    def back(d: SplatGradients) -> dict[str, Floats]:
        n = len(gaussians)
        widths = {"means": 3, "quaternions": 4, "scales": 3, "opacities": 0, "colours": 3, "part_weights": 0}
        widths |= {"screen": 0, "drawn": 0}
        found = {name: np.zeros((n, width) if width else n, np.float32) for name, width in widths.items()}
        by_shade = np.empty((m, 3), np.float32)
        given = (d.means, d.quaternions, d.scales, d.opacities, d.colours, d.screen, d.drawn)
        own = (gaussians.colours, opacities, weights, shades)
        _sum_copies(index, motion, *given, *own, by_shade, *found.values())
        return {**found, "light": harmonics.T @ by_shade}

    return splats, back


@njit(nogil=True, cache=True)
def _select(
    means: Floats, normals: Floats, opacities: Floats, weights: Floats, poses: Floats,
) -> tuple[Ints, NDArray[np.uint8]]:  # pragma: no cover  # fmt: skip
    """(m,) indices of the Gaussians to draw, and (m,) their motions; those under motion 0 first."""
    index, motion = np.empty(2 * len(means), np.int64), np.empty(2 * len(means), np.uint8)
    m = 0
    for k in range(2):
        T = poses[k]
        # camera position in the canonical frame
        c0 = -(T[0, 0] * T[0, 3] + T[1, 0] * T[1, 3] + T[2, 0] * T[2, 3])
        c1 = -(T[0, 1] * T[0, 3] + T[1, 1] * T[1, 3] + T[2, 1] * T[2, 3])
        c2 = -(T[0, 2] * T[0, 3] + T[1, 2] * T[1, 3] + T[2, 2] * T[2, 3])
        for g in range(means.shape[0]):
            if opacities[g] * (weights[g] if k == 0 else 1 - weights[g]) <= FAINT_COPY:
                continue
            x, y, z = c0 - means[g, 0], c1 - means[g, 1], c2 - means[g, 2]
            facing = normals[g, 0] * x + normals[g, 1] * y + normals[g, 2] * z
            if facing < TURNED_AWAY * math.sqrt(x * x + y * y + z * z):
                continue
            index[m], motion[m] = g, k
            m += 1
    return index[:m].copy(), motion[:m].copy()


@njit(nogil=True, cache=True)
def _sum_copies(
    index: Ints, motion: NDArray[np.uint8], d_means: Floats, d_quaternions: Floats, d_scales: Floats,
    d_opacities: Floats, d_colours: Floats, d_screen: Floats, d_drawn: NDArray[np.bool_], colours: Floats,
    opacities: Floats, weights: Floats, shades: Floats, by_shade: Floats, means: Floats, quaternions: Floats,
    scales: Floats, by_opacity: Floats, by_colour: Floats, by_weight: Floats, screen: Floats, drawn: Floats,
) -> None:  # pragma: no cover  # fmt: skip
    """Derivatives by the Gaussians from those by their copies `index`; and by the copies' light."""
    for e in range(index.shape[0]):
        g = index[e]
        for k in range(3):
            means[g, k] += d_means[e, k]
            scales[g, k] += d_scales[e, k]
            by_colour[g, k] += d_colours[e, k] * shades[e, k]
            by_shade[e, k] = d_colours[e, k] * colours[g, k] if shades[e, k] > _F(DARKEST) else _F(0)
        for k in range(4):
            quaternions[g, k] += d_quaternions[e, k]
        if motion[e] == 0:
            by_opacity[g] += d_opacities[e] * weights[g]
            by_weight[g] += d_opacities[e] * opacities[g]
        else:
            by_opacity[g] += d_opacities[e] * (_F(1) - weights[g])
            by_weight[g] -= d_opacities[e] * opacities[g]
        screen[g] += d_screen[e]
        drawn[g] += _F(d_drawn[e])


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _harmonics(x: float, y: float, z: float, found: Floats) -> None:  # pragma: no cover
    """Real spherical harmonics of one direction by degree l and order -l to l, as many as `found` has room for."""
    terms = found.shape[0]
    found[0] = _F(0.28209479)
    if terms > 1:
        found[1], found[2], found[3] = _F(0.48860251) * y, _F(0.48860251) * z, _F(0.48860251) * x
    if terms > 4:
        found[4], found[5] = _F(1.09254843) * x * y, _F(1.09254843) * y * z
        found[6], found[7] = _F(0.31539157) * (_F(3) * z * z - _F(1)), _F(1.09254843) * x * z
        found[8] = _F(0.54627422) * (x * x - y * y)
    if terms > 9:
        found[9] = _F(0.59004359) * y * (_F(3) * x * x - y * y)
        found[10] = _F(2.89061144) * x * y * z
        found[11] = _F(0.45704580) * y * (_F(5) * z * z - _F(1))
        found[12] = _F(0.37317633) * z * (_F(5) * z * z - _F(3))
        found[13] = _F(0.45704580) * x * (_F(5) * z * z - _F(1))
        found[14] = _F(1.44530572) * z * (x * x - y * y)
        found[15] = _F(0.59004359) * x * (x * x - _F(3) * y * y)
    if terms > 16:
        found[16] = _F(2.50334294) * x * y * (x * x - y * y)
        found[17] = _F(1.77013077) * y * z * (_F(3) * x * x - y * y)
        found[18] = _F(0.94617470) * x * y * (_F(7) * z * z - _F(1))
        found[19] = _F(0.66904654) * y * z * (_F(7) * z * z - _F(3))
        found[20] = _F(0.10578555) * (z * z * (_F(35) * z * z - _F(30)) + _F(3))
        found[21] = _F(0.66904654) * x * z * (_F(7) * z * z - _F(3))
        found[22] = _F(0.47308735) * (x * x - y * y) * (_F(7) * z * z - _F(1))
        found[23] = _F(1.77013077) * x * z * (x * x - _F(3) * y * y)
        found[24] = _F(0.62583574) * (x * x * (x * x - _F(3) * y * y) - y * y * (_F(3) * x * x - y * y))


@njit(nogil=True, cache=True, error_model="numpy", fastmath=True)
def _light(
    begin: int, end: int, index: Ints, motion: NDArray[np.uint8], normals: Floats, colours: Floats, poses: Floats,
    light: Floats, harmonics: Floats, shades: Floats, lit: Floats,
) -> None:  # pragma: no cover  # fmt: skip
    """Spherical harmonics of the normals in the camera's frame, the light there, and the lit colours."""
    for k in range(begin, end):
        g, M = index[k], poses[motion[k]]
        a, b, c = normals[g, 0], normals[g, 1], normals[g, 2]
        _harmonics(
            M[0, 0] * a + M[0, 1] * b + M[0, 2] * c,
            M[1, 0] * a + M[1, 1] * b + M[1, 2] * c,
            M[2, 0] * a + M[2, 1] * b + M[2, 2] * c,
            harmonics[k],
        )
        for d in range(3):
            shade = _F(0)
            for t in range(light.shape[0]):
                shade += harmonics[k, t] * light[t, d]
            shades[k, d] = max(_F(DARKEST), shade)
            lit[k, d] = colours[g, d] * shades[k, d]
