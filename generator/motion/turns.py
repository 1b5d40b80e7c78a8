"""Chooses views and interpolates rotations through them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from freeart21 import se3
from freeart21.se3 import Array
from freeart21.sphere import covered_cells
from generator.motion.body import UPRIGHT

DirectionScores = Callable[[float], tuple[Array, bool]]
"""Path length, radians, to the score (D,), 0 to 1, of each candidate direction at this point, and whether to stay near
rather than to go on to unseen directions."""


def upright_rotation(yaw: Array | float, pitch: Array | float) -> Array:
    """(..., 3, 3) camera from object, upright: turned by `yaw` about its upright axis, seen from `pitch` above."""
    yaw, pitch = np.asarray(yaw, float), np.asarray(pitch, float)
    return se3.exp_so3(pitch[..., None] * [1, 0, 0]) @ UPRIGHT @ se3.exp_so3(yaw[..., None] * [0, 0, 1])


def upright_looking_from(view: Array) -> Array:
    """(3, 3) camera from object, upright, that looks from direction `view` (3,)."""
    return upright_rotation(np.pi - np.arctan2(view[1], view[0]), np.arcsin(np.clip(view[2], -1, 1)))


def choose_views(
    start: Array,
    length: float,
    directions: Array,
    scores_at: DirectionScores,
    rng: np.random.Generator,
    step: tuple[float, float],
    even: bool,
) -> list[Array]:
    """A path of views from `start` (3,) of at least `length` radians, chosen from `directions` (D, 3).

    The next view is `step` (least, most) radians away; among these it maximises unseen directions plus score minus
    change of heading. With `even` every step counts as one of mean size, because it will take the same time, and a view
    may be repeated where the scores ask to stay.
    """
    views, way, heading = [start], 0.0, np.zeros(3)
    cells = covered_cells(directions)
    covered = covered_cells(start)
    while way < length:
        now = views[-1]
        cosine = np.clip(directions @ now, -1, 1)
        angle = np.arccos(cosine)
        least, most = step
        welcome, stay = scores_at(way + 0.5 * most)
        least = (0.0 if even else 0.5) if stay else least
        allowed = (angle >= least) & (angle <= most)
        if not allowed.any():
            allowed = angle > 1e-6
        if covered.mean() > 0.95:
            covered = covered_cells(now)
        halfway = covered_cells(_unit(directions + now))
        fresh = ((cells | halfway) & ~covered).sum(1) / 8
        tangent = _unit(directions - cosine[:, None] * now)
        bend = (1 - tangent @ heading) / 2 if heading.any() else 0.0
        score = (0.3 if stay else 1.0) * fresh + 3.0 * welcome - 0.6 * bend + rng.uniform(0, 0.5, len(directions))
        best = int(np.where(allowed, score, -np.inf).argmax())
        covered |= cells[best] | halfway[best]
        heading = _unit(directions[best] * cosine[best] - now)
        way += 0.5 * (step[0] + step[1]) if even else float(angle[best])
        views.append(directions[best])
    return views


def rotations_through(views: list[Array], roll: float, rng: np.random.Generator) -> Array:
    """(k, 3, 3) rotations that show `views`: the first upright, each next by the shortest turn and a roll of up to
    `roll` radians."""
    Rs = [upright_looking_from(views[0])]
    for view in views[1:]:
        there = Rs[-1] @ view  # in the camera's axes, to be turned to point at the camera
        axis, cosine = np.cross(there, [0.0, 0, -1]), -there[2]
        size = np.linalg.norm(axis)
        turn = axis / size * np.arctan2(size, cosine) if size > 1e-9 else np.array([0.0, 0 if cosine > 0 else np.pi, 0])
        Rs.append(se3.exp_so3(np.array([0, 0, rng.uniform(-roll, roll)])) @ se3.exp_so3(turn) @ Rs[-1])
    return np.stack(Rs)


def spline(Rs: Array, u: Array) -> Array:
    """(n, 3, 3) the cumulative cubic B-spline (Kim, Kim and Shin 1995) of `Rs` (k, 3, 3) at `u` (n,), 0 to k - 1.

    It starts at the first and ends at the last of `Rs`, passes near the others, and has two continuous derivatives; `u`
    beyond the ends is clipped.
    """
    u = np.clip(u, 0, len(Rs) - 1)
    first, last = Rs[0] @ Rs[1].T @ Rs[0], Rs[-1] @ Rs[-2].T @ Rs[-1]
    controls = np.concatenate([first[None], Rs, last[None]])
    steps = se3.log_so3(np.swapaxes(controls[:-1], 1, 2) @ controls[1:])
    k = np.clip(np.floor(u).astype(int), 0, len(Rs) - 2)
    f = np.clip(u - k, 0, 1)[:, None]
    return np.asarray(
        controls[k]
        @ se3.exp_so3((5 + 3 * f - 3 * f**2 + f**3) / 6 * steps[k])
        @ se3.exp_so3((1 + 3 * f + 3 * f**2 - 2 * f**3) / 6 * steps[k + 1])
        @ se3.exp_so3(f**3 / 6 * steps[k + 2])
    )


def steps_degrees(Rs: Array) -> Array:
    """(n - 1,) degrees from each of the rotations (n, 3, 3) to the next."""
    return np.degrees(se3.rotation_angle(Rs[1:] @ np.swapaxes(Rs[:-1], -1, -2)))


def _unit(v: Array) -> Array:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))
