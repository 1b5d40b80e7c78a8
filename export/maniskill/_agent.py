"""The object as ManiSkill's agent: a motor in its joint and, optionally, a hand that moves its base."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.controllers.base_controller import BaseController, ControllerConfig
from mani_skill.agents.controllers.pd_joint_pos import PDJointPosController, PDJointPosControllerConfig

from export.maniskill._body import Body
from export.maniskill._body_batch import BodyBatch
from freeart21 import se3
from freeart21.se3 import Array

OBJECT = "freeart21_object"
"""robot_uids of this agent."""
_MOTOR_HZ = 5.0
"""Undamped frequency of the motor's position control on the moving part's inertia: it settles within 0.2 s."""
_DELTA = 0.1
"""Largest change per control step in mode pd_joint_delta_pos, over the joint's span."""
_HAND_STEP = 0.02, 0.1
"""m and rad that the hand may move per control step."""


class ObjectAgent(BaseAgent):
    """An articulated object with a driven joint: `pd_joint_pos`, `pd_joint_delta_pos`, `passive`.

    Where a hand holds the base, also `pd_joint_pos_base_delta_pose`. The motor acts through the asset's effects. Its
    control is critically damped and compensates the moving part's weight, as for ManiSkill's robots. Where the object
    changes from reset to reset (`varied`), actions of `pd_joint_pos` are within -1 and 1, the ends of its span.
    """

    uid = OBJECT

    def __init__(
        self,
        scene: Any,
        control_freq: int,
        control_mode: str | None,
        body: Body | BodyBatch,
        hand: Any = None,
        varied: bool = False,
    ):
        self.body, self._hand, self._varied = body, hand, varied
        super().__init__(scene, control_freq, control_mode)

    def _load_articulation(self, initial_pose: Any = None) -> None:
        self.robot = self.body.articulation
        self.robot_link_names = self.body.link_names

    @property
    def _controller_configs(self) -> dict[str, Any]:
        joint, body = [self.body.joint_name], self.body
        lower, upper = body.spans.T
        step = _DELTA * (upper - lower)
        absolute = MotorConfig(joint, lower, upper, 0.0, 0.0, normalize_action=self._varied, body=body)
        delta = MotorConfig(joint, -step, step, 0.0, 0.0, use_delta=True, use_target=True, body=body)
        own_weight = {"balance_passive_force": False}  # ManiSkill would switch off gravity on the object
        modes: dict[str, Any] = {
            "pd_joint_pos": {"joint": absolute, **own_weight},
            "pd_joint_delta_pos": {"joint": delta, **own_weight},
            "passive": {"joint": PassiveConfig(joint, body=body), **own_weight},
        }
        if self._hand is not None:
            modes["pd_joint_pos_base_delta_pose"] = {
                "joint": absolute,
                "base": HandConfig([], hand=self._hand),
                **own_weight,
            }
        return modes

    def get_proprioception(self) -> dict[str, torch.Tensor]:
        """qpos as read by the asset's sensor (n, 1), qvel (n, 1), and the controller's state."""
        obs: dict[str, Any] = {"qpos": self.body.measured()[:, None], "qvel": self.body.states()[1, :, None]}
        state = self.controller.get_state()
        if state:
            obs["controller"] = state
        return obs


class _ObjectController(BaseController):
    """A controller of an object, or of n objects with different links, which ManiSkill's merged view does not name."""

    def _initialize_joints(self) -> None:
        if not self.articulation.merged:
            super()._initialize_joints()
            return
        self.joints: list[Any] = []
        self.active_joint_indices = torch.zeros(0, dtype=torch.int32)

    def set_drive_property(self) -> None:
        """The engine's drive is not used."""


class MotorController(_ObjectController, PDJointPosController):
    """ManiSkill's position controller, but targets go to the actuator of `generator.simulate`: the engine's drive is
    taken by Coulomb friction."""

    config: MotorConfig
    _target_qpos: torch.Tensor | None = None

    def _get_joint_limits(self) -> np.ndarray:
        return np.array([[self.config.lower[0], self.config.upper[0]]], np.float32)

    def _clip_and_scale_action_space(self) -> None:
        super()._clip_and_scale_action_space()
        low, high = (np.array(end, np.float32) for end in (self.config.lower, self.config.upper))
        self.action_space_low, self.action_space_high = (
            torch.from_numpy(end).to(self.device)[:, None] for end in (low, high)
        )

    @property
    def qpos(self) -> torch.Tensor:
        return self.config.body.states()[0, :, None]

    def reset(self) -> None:
        body, here = self.config.body, self.qpos
        before = here if self._target_qpos is None else self._target_qpos
        self._step, self._start_qpos = 0, here
        self._target_qpos = torch.where(body.restarted[:, None], here, before)
        body.start_motor(2 * np.pi * _MOTOR_HZ)

    def set_drive_targets(self, targets: torch.Tensor) -> None:
        self._target_qpos = self.config.body.command(targets[:, 0])[:, None]

    def set_state(self, state: dict[str, Any]) -> None:
        super().set_state(state)
        if "target_qpos" in state:
            self.set_drive_targets(self._target_qpos)


@dataclass
class MotorConfig(PDJointPosControllerConfig):
    """A motor in each joint of `body`; `lower` and `upper` are (n,)."""

    lower: Array
    upper: Array
    body: Any = None
    controller_cls = MotorController


class PassiveController(_ObjectController):
    """No motor: the joint is free. Actions are empty."""

    sets_target_qpos = sets_target_qvel = False

    def _initialize_action_space(self) -> None:
        self.single_action_space = spaces.Box(np.empty(0, np.float32), np.empty(0, np.float32), dtype=np.float32)

    def reset(self) -> None:
        self.config.body.remove_motor()

    def set_action(self, action: Any) -> None:
        """Nothing acts."""


@dataclass
class PassiveConfig(ControllerConfig):
    """The joint of `body` without a motor."""

    body: Any = None
    controller_cls = PassiveController


class HandController(_ObjectController):
    """Moves the hand by a twist per control step: shift and rotation vector, world axes, about the root's origin."""

    sets_target_qpos = sets_target_qvel = False

    def _initialize_joints(self) -> None:
        self.joints: list[Any] = []
        self.active_joint_indices = torch.zeros(0, dtype=torch.int32)

    def _initialize_action_space(self) -> None:
        self.single_action_space = spaces.Box(-np.ones(6, np.float32), np.ones(6, np.float32), dtype=np.float32)

    def reset(self) -> None:
        self.config.hand.lead()

    def set_action(self, action: torch.Tensor) -> None:
        """(n, 6) within -1 and 1, as fractions of the largest step."""
        step = np.clip(action.cpu().numpy().astype(float), -1, 1) * np.repeat(_HAND_STEP, 3)
        self.config.hand.go(step[:, :3], se3.exp_so3(step[:, 3:]))


@dataclass
class HandConfig(ControllerConfig):
    """The hand that holds the object's base."""

    hand: Any = None
    controller_cls = HandController
