"""Visibility of each side by view direction and joint state, computed once as a table.

The visible share depends on three numbers, the direction of view and the joint state: a rotation about the line of
sight changes nothing. A coarse table over them tells for any motion where the smaller side is hidden.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.se3 import Array
from freeart21.sphere import fibonacci_sphere
from generator.motion.body import Body
from generator.rays import Caster

_GRID = 28
_SPREAD = np.radians(7.0)
_STEP = 0.01  # shares are rounded to it: single rays differ between processors


class Atlas:
    """The smaller side's share of the object's pixels, by direction and state."""

    def __init__(self, body: Body, distance: float, directions: int = 162, states: int = 6) -> None:
        """`distance` of the camera from the body's centre, metres."""
        self._body, self._caster = body, Caster(body.meshes)
        self.directions = fibonacci_sphere(directions)
        """(D, 3) unit vectors from the object to the camera, object frame."""
        self.states = np.linspace(body.lower, body.upper, states)
        """(Q,) rad or m."""
        eyes = np.repeat(body.centre + distance * self.directions, states, axis=0)
        counts = self._counts(eyes, np.tile(self.states, directions)).reshape(directions, states, 2)
        self.small = int(counts[..., 1].sum() < counts[..., 0].sum())
        """The side, 0 or 1, that shows less over all directions and states."""
        self.share = np.round(_share(counts, self.small) / _STEP) * _STEP
        """(D, Q)."""
        self.gone = counts[..., self.small] == 0
        """(D, Q) whether no ray met the smaller side."""

    def at_state(self, q: float) -> Array:
        """(D,) share of the smaller side at a state."""
        x = (q - self.states[0]) / max(self.states[-1] - self.states[0], 1e-12) * (len(self.states) - 1)
        k = int(np.clip(np.floor(x), 0, len(self.states) - 2))
        return np.asarray(self.share[:, k] + np.clip(x - k, 0, 1) * (self.share[:, k + 1] - self.share[:, k]))

    def shares(self, views: Array, states: Array) -> Array:
        """(n,) share of the smaller side from unit vectors `views` (n, 3) at `states` (n,), interpolated."""
        cosine = np.clip(views @ self.directions.T, -1, 1)
        weights = np.exp(-0.5 * (np.arccos(cosine) / _SPREAD) ** 2)
        by_state = (weights / weights.sum(1, keepdims=True)) @ self.share
        x = (states - self.states[0]) / max(self.states[-1] - self.states[0], 1e-12) * (len(self.states) - 1)
        k = np.clip(np.floor(x).astype(int), 0, len(self.states) - 2)
        rows, f = np.arange(len(states)), np.clip(x - k, 0, 1)
        return np.asarray((1 - f) * by_state[rows, k] + f * by_state[rows, k + 1])

    def count_shares(self, Ts_camera_object: Array, states: Array) -> Array:
        """(n,) share of the smaller side in poses (n, 4, 4) at `states` (n,), from rays for each pose."""
        R, t = Ts_camera_object[:, :3, :3], Ts_camera_object[:, :3, 3]
        return _share(self._counts(-np.einsum("nji,nj->ni", R, t), states), self.small)

    def _counts(self, eyes: Array, states: Array) -> NDArray[np.int64]:
        """(n, 2) rays that hit each side from `eyes` (n, 3), on a grid over the object's bounding rectangle."""
        counts = np.zeros((len(eyes), 2), np.int64)
        offsets = (np.arange(_GRID) + 0.4142) / _GRID  # off the middle: no ray runs along an edge of symmetry
        gu, gv = (g.reshape(-1) for g in np.meshgrid(offsets, offsets + 0.1317 / _GRID))
        for first in range(0, len(eyes), 256):
            part = slice(first, first + 256)
            eye, q = eyes[part], states[part]
            forward = self._body.centre - eye
            forward /= np.linalg.norm(forward, axis=1, keepdims=True)
            across = np.cross(forward, np.eye(3)[np.abs(forward).argmin(1)])
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            axes = np.stack([across, np.cross(forward, across), forward], 1)
            seen = np.einsum("nij,nkj->nki", axes, self._body.points(q) - eye[:, None])
            plane = seen[..., :2] / np.maximum(seen[..., 2:], 1e-9)
            low, high = plane.min(1), plane.max(1)
            x = low[:, :1] + (high - low)[:, :1] * gu
            y = low[:, 1:] + (high - low)[:, 1:] * gv
            directions = axes[:, None, 2] + x[..., None] * axes[:, None, 0] + y[..., None] * axes[:, None, 1]
            origins = np.broadcast_to(eye[:, None], directions.shape)
            back = se3.inverse(self._body.joint.transform(q))
            moved = se3.transform(back, origins), directions @ np.swapaxes(back[:, :3, :3], 1, 2)
            rays = (origins.reshape(-1, 3), directions.reshape(-1, 3)), tuple(a.reshape(-1, 3) for a in moved)
            side = self._caster.meet(rays).side.reshape(len(eye), -1)  # type: ignore[arg-type]
            counts[part] = np.stack([(side == 0).sum(1), (side == 1).sum(1)], 1)
        return counts


def _share(counts: NDArray[np.int64], small: int) -> Array:
    return np.asarray(counts[..., small] / np.maximum(counts.sum(-1), 1))
