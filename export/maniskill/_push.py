"""A scripted policy for the pusher: the ball goes round the object to a face that moves the joint, and pushes it."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from mani_skill.utils.geometry.trimesh_utils import get_component_mesh

from export.maniskill._body import check_single
from export.maniskill._environments import ObjectEnvironment
from export.maniskill._pusher import RADIUS, STEP
from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.se3 import Array

_SAMPLES = 2000
"""Points of the moving part that are looked at."""
_FACING = 0.7
"""Least cosine between a face's inward normal and the way of its point: steeper ones slip at a friction of 1."""
_CLEAR = 3.0
"""Radii of the ball from its surface to a face that it comes from."""


class PushPolicy:
    """Actions of the pusher (3,), within -1 and 1, for the episode that `env` is in; made anew after each reset.

    Raises FreeArtError where no face of the moving part that pushes the joint towards its target can be reached.
    """

    def __init__(self, env: Any, seed: int = 0):
        plain = env.unwrapped
        assert isinstance(plain, ObjectEnvironment)
        self._env, self._body = plain, check_single(plain)
        self._q0 = self._body.q
        self._joint = self._body.simulated.world_joint.moved(self._body.root_pose)  # it was read with the root at 0
        self._sign = float(np.sign(float(plain._target[0]) - self._q0)) or 1.0
        self._point, self._normal = self._find_face(np.random.default_rng(seed))
        self._way = self._round_the_object()
        self._more = 0.0

    def _velocity(self, points: Array) -> Array:
        """(n, 3) of points (n, 3) of the moving part for a speed of 1 towards the target, m/s, world frame."""
        joint = self._joint
        if joint.type == "prismatic":
            return np.broadcast_to(self._sign * joint.axis, points.shape)
        return np.asarray(self._sign * np.cross(joint.axis, points - joint.pivot))

    def _find_face(self, rng: np.random.Generator) -> tuple[Array, Array]:
        """(3,) point and (3,) outward normal, world frame, now: reachable, facing its way, with the longest lever."""
        moving, whole = self._meshes()
        points, faces = trimesh.sample.sample_surface(moving, _SAMPLES, seed=int(rng.integers(1 << 31)))
        normals, velocity = moving.face_normals[faces], self._velocity(points)
        lever = np.linalg.norm(velocity, axis=1)
        facing = -(normals * velocity).sum(1) > _FACING * np.maximum(lever, 1e-9)
        starts = points + (RADIUS + 1e-3) * normals
        clear = ~whole.ray.intersects_any(starts, normals) & (points[:, 2] > RADIUS)
        found = np.flatnonzero(facing & clear)
        found = found[trimesh.proximity.signed_distance(whole, starts[found]) < -0.9 * RADIUS] if len(found) else found
        if not len(found):
            urdf = self._body.simulated.asset.urdf
            raise FreeArtError(f"{urdf}: no face to push the joint by can be reached from outside")
        if self._joint.type == "prismatic":
            middle = self._body.centres()[0].numpy().astype(float)
            best = found[np.argmin(np.linalg.norm(np.cross(points[found] - middle, self._joint.axis), axis=1))]
        else:
            best = found[np.argmax(lever[found])]
        return points[best], normals[best]

    def _meshes(self) -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
        """The contact shapes of the moving part and of the whole object, world frame, now."""
        self._body.settle()
        moving = [get_component_mesh(link, to_world_frame=True) for link in self._body.moving]
        every = [get_component_mesh(link, to_world_frame=True) for link in self._body.links.values()]
        both = (trimesh.util.concatenate([mesh for mesh in meshes if mesh is not None]) for meshes in (moving, every))
        first, second = both
        assert isinstance(first, trimesh.Trimesh) and isinstance(second, trimesh.Trimesh)
        return first, second

    def _round_the_object(self) -> list[Array]:
        """(3,) each: places of the ball, up, over the object and down to before the face."""
        low, high = self._body.bounds()
        room = 2 * _CLEAR * RADIUS
        tip = self._tip()
        before = self._point + _CLEAR * RADIUS * self._normal
        outside = before.copy()
        if abs(self._normal[2]) < 0.7:  # a face from the side: down beside the object, then in
            level = self._normal * (1, 1, 0)
            level /= np.linalg.norm(level)
            reach = float(np.abs(high - low)[:2].sum())
            steps = before + np.linspace(0, reach, 50)[:, None] * level
            beside = ((steps < low - room) | (steps > high + room))[:, :2].any(1)
            outside = steps[int(beside.argmax())]
        top = max(high[2] + room, before[2], tip[2])
        return [np.array([*tip[:2], top]), np.array([*outside[:2], top]), outside, before]

    def _tip(self) -> Array:
        return np.asarray(self._env.agent.tcp.pose.p[0].cpu().numpy(), float)

    def __call__(self) -> np.ndarray:
        """(3,) the next action."""
        tip = self._tip()
        while self._way and np.linalg.norm(self._way[0] - tip) < 0.5 * RADIUS:
            self._way.pop(0)
        if self._way:
            return self._towards(self._way[0] - tip)
        moved = self._joint.transform(self._body.q - self._q0)
        point, normal = se3.transform(moved, self._point), moved[:3, :3] @ self._normal
        velocity = self._velocity(point[None])[0]
        lever = float(np.linalg.norm(velocity))
        left = self._sign * (float(self._env._target[0]) - self._body.q) * lever
        stuck = abs(self._body.qd) * lever < 0.01 and left > 0
        self._more = min(self._more + 0.1 * STEP, STEP) if stuck else 0.5 * self._more
        lead = min(max(left, 0.0), 0.5 * STEP) + self._more
        return self._towards(point + RADIUS * normal + lead * velocity / lever - tip)

    def _towards(self, way: Array) -> np.ndarray:
        return np.asarray(way * min(1.0, STEP / max(float(np.abs(way).max()), 1e-9)) / STEP, np.float32)
