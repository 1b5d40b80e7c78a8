"""A rasteriser of Gaussians to check others by: float64, a loop over pixels, every Gaussian asked at each of them.

It says what `reconstruct.gaussians.rasteriser` says and nothing of how: no boxes, no tiles, and derivatives are
differences.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import lpmv

from freeart21 import se3
from reconstruct.gaussians.rasteriser import DENSEST, DILATION, FAINTEST, NEAR, OPAQUE, THIN, Picture

ARRAYS = ("means", "quaternions", "scales", "opacities", "colours")
STEPS = {"means": 1e-7, "quaternions": 1e-6, "scales": 1e-8, "opacities": 1e-6, "colours": 1e-4}


@dataclass(frozen=True)
class Drawing:
    picture: Picture
    """In float64."""
    blended: tuple
    """All (pixel, Gaussian) that went into the picture, in order: while these stay, the picture is smooth."""
    margin: np.ndarray
    """(h, w) how near any decision at a pixel was to falling otherwise, relative: rounding flips those near 0."""


def draw(splats, poses, lens, nudges=None, clamp=False):
    """`splats` through `lens`, any float type. `nudges` (M, 2) move the projected means, pixels.

    `clamp` takes the projection's derivative, as gsplat does, no further than 15 % of the window out of it.
    """
    projected = [_project(g, splats, np.asarray(poses, float), lens, clamp) for g in range(len(splats))]
    if nudges is not None:
        projected = [p and (p[0] + nudges[g], *p[1:]) for g, p in enumerate(projected)]
    order = sorted((p[2], g) for g, p in enumerate(projected) if p is not None)
    h, w = lens.height, lens.width
    colour, depth, alpha, moving = np.zeros((h, w, 3)), np.zeros((h, w)), np.zeros((h, w)), np.zeros((h, w))
    margin, blended = np.full((h, w), np.inf), []
    colours = np.asarray(splats.colours, float)
    for y in range(h):
        for x in range(w):
            T = 1.0
            for _, g in order:
                (u, v), (a, b, c), _, plane = projected[g]
                dx, dy = x + 0.5 - u, y + 0.5 - v
                thick = float(splats.opacities[g]) * math.exp(-0.5 * (a * dx * dx + 2 * b * dx * dy + c * dy * dy))
                margin[y, x] = min(margin[y, x], abs(thick / FAINTEST - 1), abs(thick / DENSEST - 1))
                if thick < FAINTEST:
                    continue
                thick = min(thick, DENSEST)
                margin[y, x] = min(margin[y, x], abs(T * (1 - thick) / OPAQUE - 1))
                if T * (1 - thick) <= OPAQUE:
                    break
                colour[y, x] += T * thick * colours[g]
                depth[y, x] += T * thick * (plane @ (x + 0.5, y + 0.5, 1))
                alpha[y, x] += T * thick
                moving[y, x] += T * thick * int(splats.motion[g])
                T *= 1 - thick
                blended.append((y, x, g))
    return Drawing(Picture(colour, depth, alpha, moving), tuple(blended), margin)


def spherical_harmonics(directions, terms):
    """(n, terms) real ones of unit vectors (n, 3), orthonormal, by degree l and order -l to l."""
    x, y, z = np.asarray(directions, float).T
    longitude, found = np.arctan2(y, x), []
    for degree in range(math.isqrt(terms)):
        for order in range(-degree, degree + 1):
            m = abs(order)
            size = (2 * degree + 1) / (4 * np.pi) * math.factorial(degree - m) / math.factorial(degree + m)
            turned = np.cos(m * longitude) if order >= 0 else np.sin(m * longitude)
            found.append(np.sqrt((2 if m else 1) * size) * (-1) ** m * lpmv(m, degree, z) * turned)
    return np.stack(found, -1)


def _project(g, splats, poses, lens, clamp):
    """Mean in the picture, inverse covariance (xx, xy, yy) there, depth of the mean, and of what is at (x, y): a plane
    of (x, y, 1); None when it is too near."""
    T = poses[splats.motion[g]]
    x, y, z = T[:3, :3] @ np.asarray(splats.means[g], float) + T[:3, 3]
    if z < NEAR:
        return None
    w, i, j, k = np.asarray(splats.quaternions[g], float)
    R = T[:3, :3] @ Rotation.from_quat([i, j, k, w]).as_matrix()
    S = np.diag(np.asarray(splats.scales[g], float))
    p, q = x / z, y / z
    if clamp:
        outward = 0.15 * lens.width, 0.15 * lens.height
        p = min(max(p, (-outward[0] - lens.cx) / lens.fx), (lens.width + outward[0] - lens.cx) / lens.fx)
        q = min(max(q, (-outward[1] - lens.cy) / lens.fy), (lens.height + outward[1] - lens.cy) / lens.fy)
    place = np.array([lens.fx * x / z + lens.cx, lens.fy * y / z + lens.cy])
    whole = np.array([[lens.fx / z, 0, -lens.fx * x / z**2], [0, lens.fy / z, -lens.fy * y / z**2], [0, 0, 1]]) @ R @ S
    covariance = whole @ whole.T
    slopes = np.linalg.solve(covariance[:2, :2] + THIN * np.eye(2), covariance[:2, 2])
    plane = np.append(slopes, z - slopes @ place)
    J = np.array([[lens.fx / z, 0, -lens.fx * p / z], [0, lens.fy / z, -lens.fy * q / z]])
    M = J @ R @ S
    Q = np.linalg.inv(M @ M.T + DILATION * np.eye(2))
    return place, (Q[0, 0], Q[0, 1], Q[1, 1]), z, plane


def derivatives(splats, poses, lens, d_colour, d_depth, d_alpha, clamp=False):
    """By central differences, of the sum of `draw`'s pictures times what is given: arrays by name, 'twists' (2, 6) and
    'screen' (M,)."""
    splats = replace(splats, **{name: np.asarray(getattr(splats, name), float) for name in ARRAYS})
    poses = np.asarray(poses, float)

    def slope(change, step):
        drawn = [draw(*change(sign * step), clamp=clamp) for sign in (1, -1)]
        assert drawn[0].blended == drawn[1].blended, "a decision falls within the step: no derivative to compare with"
        up, down = (d.picture for d in drawn)
        difference = (
            ((up.colour - down.colour) * d_colour).sum()
            + ((up.depth - down.depth) * d_depth).sum()
            + ((up.alpha - down.alpha) * d_alpha).sum()
        )
        return difference / (2 * step)

    found = {}
    for name in ARRAYS:
        value = getattr(splats, name)
        found[name] = np.zeros_like(value)
        for at in np.ndindex(value.shape):

            def change(step, name=name, value=value, at=at):
                other = value.copy()
                other[at] += step
                return replace(splats, **{name: other}), poses, lens

            found[name][at] = slope(change, STEPS[name])
    found["twists"] = np.zeros((2, 6))
    for at in np.ndindex(2, 6):

        def turn(step, at=at):
            twists = np.zeros((2, 6))
            twists[at] = step
            return splats, se3.exp_se3(twists) @ poses, lens

        found["twists"][at] = slope(turn, 1e-7)
    found["screen"] = np.zeros(len(splats))
    for g in range(len(splats)):

        def shift(step, axis, g=g):
            nudges = np.zeros((len(splats), 2))
            nudges[g, axis] = step
            return splats, poses, lens, nudges

        found["screen"][g] = math.hypot(*(slope(lambda s, axis=axis: shift(s, axis), 1e-5) for axis in (0, 1)))
    return found
