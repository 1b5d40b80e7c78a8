"""A task in the joint's own frame, the same for two assets of one object however they stand and count their joint."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from export.maniskill import CONTROL_HZ
from export.maniskill._body import check_single
from export.maniskill._gymnasium import GymnasiumWrapper
from export.maniskill._pusher import PUSHER, STEP
from freeart21.effects import effects_from_urdf_dynamics
from freeart21.errors import FreeArtError
from freeart21.se3 import Array


class JointFrame(gymnasium.Wrapper):
    """Push a joint from one share of its way to another; observations (11,) and actions (3,) in the joint's frame.

    Shares are 0 at the end of the joint's way where the whole object is smaller (shut) and 1 at the other. The frame's
    x axis is the velocity of the moving part's centre of mass towards the target, now; z is up as far as it can be.
    Observed are, in order: what is left of the way in spans; the speed towards the target, spans/s; the vector from the
    moving part's centre to the ball, dm; the ball's velocity over its full speed; the unit vector up. The ball begins
    behind and above the part, at random.

    Args:
        env: `FreeArt21-Open-v1` with the pusher.
        start: share of the way at which an episode begins.
        target: share of the way to come to rest at.
        friction: Coulomb friction that replaces the asset's effects, N*m or N; None leaves them.
        ignore_terminations: go on after success, for training.
    """

    def __init__(
        self, env: Any, start: float, target: float, friction: float | None = None, ignore_terminations: bool = False
    ):
        plain = env.unwrapped
        if plain.robot_uids != PUSHER:
            raise FreeArtError(f"the robot is '{plain.robot_uids}', expected the pusher")
        check_single(plain)
        super().__init__(GymnasiumWrapper(env, ignore_terminations=ignore_terminations))
        self._plain = plain
        body = plain.body
        sizes = []
        for q in (body.lower, body.upper):
            body.put(q)
            sizes.append(float(np.linalg.norm(np.subtract(*body.bounds()))))
        if sizes[0] > sizes[1]:
            start, target = 1 - start, 1 - target
        plain._start_share, plain._target_share = start, target
        if friction is not None:
            body.simulated.set_effects(effects_from_urdf_dynamics(0.0, friction))
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (11,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1, 1, (3,), np.float32)

    def reset(self, **options: Any) -> Any:
        """A new episode; the ball is behind the part, seen in its way, and above it."""
        _, info = self.env.reset(**options)
        plain, frame = self._plain, self._frame()
        rng = plain._batched_episode_rng[0]
        aside = frame @ np.array([-1.0, 0.0, 0.0]) + np.array([0, 0, 0.5]) + rng.uniform(-0.1, 0.1, 3)
        place = plain.body.moving_centre() + plain._size * aside / np.linalg.norm(aside)
        place[2] = max(place[2], 0.05)
        plain.agent.place(plain._tensor(place[None]))
        return self._observe(), info

    def step(self, action: Any) -> Any:
        """One control step by an action in the joint's frame."""
        action = np.clip(self._frame() @ np.clip(np.asarray(action, float), -1, 1), -1, 1)
        _, reward, terminated, truncated, info = self.env.step(action.astype(np.float32))
        return self._observe(), reward, terminated, truncated, info

    def _frame(self) -> Array:
        """(3, 3) of the world from the joint's frame, now."""
        body = self._plain.body
        joint = body.simulated.world_joint.moved(body.root_pose)
        sign = 1.0 if float(self._plain._target[0]) >= body.q else -1.0
        arm = body.moving_centre() - joint.pivot
        x = sign * (joint.axis if joint.type == "prismatic" else np.cross(joint.axis, arm))
        x = x / max(float(np.linalg.norm(x)), 1e-9)
        up = np.array([0.0, 0, 1]) if abs(x[2]) < 0.9 else joint.axis if joint.type == "revolute" else np.eye(3)[0]
        z = up - (up @ x) * x
        z = z / np.linalg.norm(z)
        return np.stack([x, np.cross(z, x), z], axis=1)

    def _observe(self) -> np.ndarray:
        plain, body, frame = self._plain, self._plain.body, self._frame()
        span, target = body.upper - body.lower, float(plain._target[0])
        sign = 1.0 if target >= body.q else -1.0
        tip = plain.agent.tcp
        away = tip.pose.p[0].cpu().numpy().astype(float) - body.moving_centre()
        velocity = tip.linear_velocity[0].cpu().numpy().astype(float)
        joint = [abs(target - body.q) / span, sign * body.qd / span]
        full = STEP * CONTROL_HZ
        return np.concatenate([joint, 10 * away @ frame, velocity @ frame / full, frame[2]]).astype(np.float32)
