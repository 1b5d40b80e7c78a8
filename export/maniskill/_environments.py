"""FreeArt21-Open-v1: bring the joint of a standing object to a target state, with a robot or a motor in the joint.
FreeArt21-FreeMoving-v1: the same while the object is carried."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils import common, sapien_utils
from mani_skill.utils.building.ground import build_ground
from mani_skill.utils.registration import register
from mani_skill.utils.scene_builder.table import TableSceneBuilder
from mani_skill.utils.structs.types import SceneConfig, SimConfig

from export.maniskill import CONTROL_HZ, ENVIRONMENTS, EPISODE_STEPS
from export.maniskill._agent import OBJECT, ObjectAgent
from export.maniskill._body import Body
from export.maniskill._body_batch import BodyBatch
from export.maniskill._hand import Hand
from export.maniskill.assets import find_asset
from export.maniskill.motion import CarriedMotion, draw_motion
from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.se3 import Array

TOLERANCE = 0.02
"""Distance from the target, over the joint's span, at which the joint must come to rest."""
AT_REST = 0.1
"""Spans per second below which the joint is at rest."""
OPENED = 0.9
"""Default target: this far from the start to the farther end of the span, as in ManiSkill's cabinets."""
_SIM_HZ = 500  # against 1 kHz, a released joint is off by less than 0.1 %: see docs/maniskill.md
_BEFORE_ROBOT = 0.12  # m from ManiSkill's place for a panda's hand at rest to the object's near side
_SECONDS = EPISODE_STEPS / CONTROL_HZ
_TURN, _SHIFT = 0.1, 0.01  # rad and m by which a standing object is displaced at random


class ObjectEnvironment(BaseEnv):
    """Base of both environments: one object, one joint, a target, reward and success.

    Args:
        asset: as for `assets.find_asset`, or several of them: each environment has one, the next one the next. A single
            environment draws another at each reset.
        joint: the joint that moves; None takes the asset's.
        object_seed: sizes and colours of a procedural object.
        scale: lengths of the object over those of its files; PartNet-Mobility is not metric.
        target: fraction of the joint's span, from its lower end; None is `OPENED`.
        start: the same for the initial state; None is the position nearest to zero.
        tolerance: fraction of the joint's span.
        robot_uids: a robot, or `freeart21_object` (also "none") for the motor in the joint.
    """

    SUPPORTED_ROBOTS: ClassVar[Any] = ["panda", OBJECT]
    agent: Any

    def __init__(
        self,
        *args: Any,
        asset: str | Path | Sequence[str | Path] = "drawer_unit",
        joint: str | None = None,
        object_seed: int = 0,
        scale: float = 1.0,
        target: float | None = None,
        start: float | None = None,
        tolerance: float = TOLERANCE,
        robot_uids: Any = OBJECT,
        **kwargs: Any,
    ):
        for name, share in (("target", target), ("start", start), ("tolerance", tolerance)):
            if share is not None and not 0 <= share <= 1:
                raise FreeArtError(f"{name} is {share:g}, expected a share of the joint's span, 0 to 1")
        several = [asset] if isinstance(asset, str | Path) else list(asset)
        if not several:
            raise FreeArtError("asset is an empty list, expected one object at least")
        self._assets = [find_asset(one, joint, object_seed) for one in several]
        if len(several) > 1 and kwargs.get("num_envs", 1) == 1:
            kwargs.setdefault("reconfiguration_freq", 1)  # as ManiSkill's own environments of many objects
        self._scale = scale
        self._target_share, self._start_share, self._tolerance = target, start, tolerance
        robot_uids = OBJECT if robot_uids in (None, "none") else robot_uids
        super().__init__(*args, robot_uids=robot_uids, **kwargs)

    @property
    def _default_sim_config(self) -> SimConfig:
        return SimConfig(
            sim_freq=_SIM_HZ,
            control_freq=CONTROL_HZ,
            scene_config=SceneConfig(enable_enhanced_determinism=True),
        )

    # scene

    _fixed_base: bool = True
    _held: bool = False

    def _load_agent(self, options: dict[str, Any], *args: Any, **kwargs: Any) -> None:
        several, n = len(self._assets), self.num_envs
        first = int(self._batched_episode_rng[0].randint(several)) if several > 1 and n == 1 else 0
        self._asset_index = (first + torch.arange(n, device=self.device, dtype=torch.int32)) % several
        assets = self._assets[first:] + self._assets[:first]
        build = BodyBatch if self.gpu_sim_enabled else Body
        self.body: Any = build(self.scene, assets, self._scale, self.sim_timestep, self._fixed_base)
        self._target = self._tensor(np.zeros(n))
        """(n,) position, rad or m."""
        corners = self.body.corners(np.array([self._position(i, self._start_share, None) for i in range(n)]))
        self._T_root_rest = self._standing(*corners.swapaxes(0, 1))
        self._size = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
        """(n,) m."""
        spacing = self.sim_config.spacing
        if n > 1 and spacing < 2 * self._size.max():  # one engine holds them all
            raise FreeArtError(
                f"sim_config.spacing of {spacing:g} m is too little for objects of {self._size.max():.3g} m in "
                f"{n} scenes side by side, expected {2 * self._size.max():.3g} m at least"
            )
        self._centre_root = corners.mean(axis=1)
        """(n, 3) of the object in its root's frame, initially."""
        self.hand = Hand(self.scene, self.body) if self._held else None
        if self.robot_uids == OBJECT:
            varied = len(self._assets) > 1
            self.agent = ObjectAgent(self.scene, self._control_freq, self._control_mode, self.body, self.hand, varied)
        else:
            super()._load_agent(options, sapien.Pose(p=[-0.615, 0, 0]))

    def _standing(self, low: Array, high: Array) -> Array:
        """(n, 4, 4) of roots whose objects have corners (n, 3) with the root at the origin: upright on z = 0.

        They are centred at the origin, or their near side is in front of the robot.
        """
        T = np.tile(np.eye(4), (len(low), 1, 1))
        near = -0.5 * (high[:, 0] - low[:, 0]) if self.robot_uids == OBJECT else _BEFORE_ROBOT
        T[:, 0, 3], T[:, 1, 3], T[:, 2, 3] = near - low[:, 0], -0.5 * (low[:, 1] + high[:, 1]), -low[:, 2]
        return T

    def _camera(self, uid: str, side: int) -> CameraConfig:
        """The same in all environments, for the largest object."""
        largest = int(self._size.argmax())
        size = float(self._size[largest])
        middle = se3.transform(self._T_root_rest[largest], self._centre_root[largest])
        pose = sapien_utils.look_at(middle + 1.6 * size * np.array([-0.75, 0.5, 0.6]), middle)
        return CameraConfig(uid, pose, side, side, fov=0.8, near=0.02 * size, far=max(20 * size, 5.0))

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        return [self._camera("base_camera", 128)]

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        return self._camera("render_camera", 512)

    def reset(self, seed: Any = None, options: dict[str, Any] | None = None) -> Any:
        """ManiSkill's, which does not seed gymnasium's own generator, as gymnasium's checker requires."""
        if seed is not None:
            gymnasium.Env.reset(self, seed=int(np.ravel(seed)[0]))
        body = getattr(self, "body", None)
        if body is not None and options is not None and "env_idx" in options:
            body.restarted[:] = False
            body.restarted[options["env_idx"]] = True
        result = super().reset(seed=seed, options=options)
        self.body.restarted[:] = True
        return result

    # joint

    def _position(self, i: int, share: float | None, otherwise: float | None) -> float:
        """The position, rad or m, of a fraction of the span in environment `i`.

        None: `otherwise`, or the one nearest to zero.
        """
        low, high = self.body.spans[i]
        if share is not None:
            return float(low + share * (high - low))
        return float(np.clip(0.0, low, high)) if otherwise is None else otherwise

    def _begin(self, rows: torch.Tensor, starts: Sequence[float], targets: Sequence[float], T: Sequence[Array]) -> None:
        """Begin episodes in the environments `rows` (m,): positions (m,), targets (m,) and root poses (m, 4, 4)."""
        self._target[rows] = self._tensor(targets)
        self.body.place(rows, np.array(starts), np.array(T))

    def _before_simulation_step(self) -> None:
        if self.hand is not None:
            self.hand.move(self.sim_timestep)
        self.body.before_step()

    def _after_simulation_step(self) -> None:
        self.body.after_step()

    def _after_control_step(self) -> None:
        self.body.settle()

    # state

    def get_state_dict(self) -> dict[str, Any]:
        """ManiSkill's state and the target."""
        return {**super().get_state_dict(), "target": self._target[:, None].clone()}

    def set_state_dict(self, state: dict[str, Any], env_idx: Any = None) -> None:
        """Restore a state. Effects with memory are reset."""
        super().set_state_dict(state, env_idx)
        rows = torch.arange(self.num_envs, device=self.device) if env_idx is None else env_idx
        self.body.read(rows)
        if "target" in state:
            self._target[rows] = common.to_tensor(state["target"], device=self.device).reshape(-1).float()

    # observations and rewards

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Tensors of (n,). `success`: at rest within the tolerance of the target; `fail`: the state is no number, the
        joint is past a limit by more than the tolerance, or the object's middle is below what it stood on;
        `joint_error`: distance from the target in spans of the joint, 1 where it is no number; `asset_index`: which of
        several assets it is."""
        (q, qd), (low, high) = self.body.states(), self._tensor(self.body.spans.T)
        lowest, highest = self._tensor(self.body.limits.T)
        span = high - low
        away = (q - self._target).abs() / span
        root = self._tensor(self.body.root_poses())
        finite = torch.isfinite(q) & torch.isfinite(qd) & torch.isfinite(root).flatten(1).all(1)
        past = (q < lowest - self._tolerance * span) | (q > highest + self._tolerance * span)
        middle = (root[:, 2, :3] * self._tensor(self._centre_root)).sum(1) + root[:, 2, 3]
        fell = (middle < 0) & (not self._held)
        info = {
            "success": finite & (away <= self._tolerance) & (qd.abs() <= AT_REST * span),
            "fail": ~finite | past | fell,
            "joint_error": torch.where(finite, away, torch.ones_like(away)),
        }
        if len(self._assets) > 1:
            info["asset_index"] = self._asset_index.clone()
        return info

    def _get_obs_extra(self, info: dict[str, Any]) -> dict[str, torch.Tensor]:
        obs = {"target_qpos": self._target[:, None].clone()}
        if hasattr(self.agent, "tcp"):
            obs["tcp_pose"] = self.agent.tcp.pose.raw_pose
        if self.obs_mode_struct.use_state:
            obs["joint_qpos"], obs["joint_qvel"] = self.body.states()[:, :, None]
            obs["object_pose"] = self.body.articulation.pose.raw_pose
            obs["moving_part_pos"] = self.body.centres()
            if hasattr(self.agent, "tcp"):
                obs["tcp_to_moving_part"] = obs["moving_part_pos"] - self.agent.tcp.pose.p
        if self.obs_mode_struct.visual.segmentation:
            obs["part_ids"] = self.body.part_ids()
        return obs

    def _tensor(self, values: Any) -> torch.Tensor:
        return torch.tensor(np.array(values, np.float32), device=self.device)

    def compute_dense_reward(self, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
        """Up to 1 for the joint near its target, plus 1 for the robot's hand near the moving part; 3 on success, 0 on
        failure."""
        reward = 1 - torch.tanh(5 * info["joint_error"])
        if hasattr(self.agent, "tcp"):
            away = self.body.centres() - self.agent.tcp.pose.p
            reward = reward + 1 - torch.tanh(5 * torch.linalg.norm(away, dim=1))
        reward = torch.where(info["success"], torch.full_like(reward, 3.0), reward)
        return torch.where(info["fail"], torch.zeros_like(reward), reward)

    def compute_normalized_dense_reward(self, obs: Any, action: Any, info: dict[str, Any]) -> torch.Tensor:
        """The dense reward over 3."""
        return self.compute_dense_reward(obs, action, info) / 3


class OpenEnvironment(ObjectEnvironment):
    """An object stands on a table or the ground; its joint must come to rest at the target.

    Args:
        base: "fixed" fixes the object to the world, "free" lets it slide and topple.
    """

    def __init__(self, *args: Any, base: str = "fixed", robot_uids: Any = "panda", **kwargs: Any):
        if base not in ("fixed", "free"):
            raise FreeArtError(f"base is '{base}', expected fixed or free")
        self._fixed_base = base == "fixed"
        super().__init__(*args, robot_uids=robot_uids, **kwargs)

    def _load_scene(self, options: dict[str, Any]) -> None:
        self._table = None
        if self.robot_uids == OBJECT:
            build_ground(self.scene)
        else:
            self._table = TableSceneBuilder(self, robot_init_qpos_noise=0.02)
            self._table.build()

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        if self._table is not None:
            self._table.initialize(env_idx)
        begins = [self._begin_standing(i) for i in env_idx.tolist()]
        self._begin(env_idx, *zip(*begins, strict=True))

    def _begin_standing(self, i: int) -> tuple[float, float, Array]:
        """Start and target, rad or m, and root pose (4, 4) of the next episode of environment `i`."""
        rng = self._batched_episode_rng[i]
        turn, shift = rng.uniform(-_TURN, _TURN), rng.uniform(-_SHIFT, _SHIFT, 2)
        moved = se3.exp_se3(np.array([0, 0, 0, 0, 0, turn]))
        moved[:2, 3] = shift
        start = self._position(i, self._start_share, None)
        farther = max(self.body.spans[i], key=lambda end: abs(end - start))
        target = self._position(i, self._target_share, start + OPENED * (farther - start))
        return start, target, moved @ self._T_root_rest[i]


class FreeMovingEnvironment(ObjectEnvironment):
    """An object is carried by an invisible hand; its joint must come to rest at the target.

    The hand's motion is random from the seed; in control mode `pd_joint_pos_base_delta_pose` the action moves it.
    """

    SUPPORTED_ROBOTS: ClassVar[Any] = [OBJECT]
    _fixed_base = False
    _held = True

    def _load_scene(self, options: dict[str, Any]) -> None:
        """Nothing but the object."""

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        begins, motions = [], []
        for i in env_idx.tolist():
            start, target, motion = self._begin_carried(i)
            begins.append((start, target, motion.at(0.0)[0]))
            motions.append(motion)
        self._begin(env_idx, *zip(*begins, strict=True))
        assert self.hand is not None
        self.hand.follow(env_idx.tolist(), motions)

    def _begin_carried(self, i: int) -> tuple[float, float, CarriedMotion]:
        """Start and target, rad or m, and the hand's motion in the next episode of environment `i`."""
        rng, centre_root = self._batched_episode_rng[i], self._centre_root[i]
        low, high = self.body.spans[i]
        drawn = low + rng.uniform(0.1, 0.9, 2) * (high - low)
        start = self._position(i, self._start_share, drawn[0])
        target = self._position(i, self._target_share, drawn[1])
        begins = se3.exp_se3(np.concatenate([np.zeros(3), rng.uniform(-1, 1, 3)]))
        centre = se3.transform(self._T_root_rest[i], centre_root)
        begins[:3, 3] = centre - begins[:3, :3] @ centre_root
        motion = draw_motion(rng, begins, centre, float(self._size[i]), _SECONDS)
        return start, target, motion

    def set_state_dict(self, state: dict[str, Any], env_idx: Any = None) -> None:
        """Restore a state; the hand continues from there."""
        super().set_state_dict(state, env_idx)
        assert self.hand is not None
        self.hand.catch(range(self.num_envs) if env_idx is None else env_idx.tolist())


for _uid, _environment in zip(ENVIRONMENTS, (OpenEnvironment, FreeMovingEnvironment), strict=True):
    register(_uid, _environment, max_episode_steps=EPISODE_STEPS)
