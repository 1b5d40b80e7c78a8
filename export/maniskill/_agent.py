"""The object as ManiSkill's agent: a motor in its joint and, optionally, a hand that moves its base."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.controllers.base_controller import BaseController, ControllerConfig
from mani_skill.agents.controllers.pd_joint_pos import PDJointPosController, PDJointPosControllerConfig

from export.maniskill._body import Body
from freeart21 import se3
from freeart21.mechanics import Actuator

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
        body: Body,
        hand: Any = None,
        varied: bool = False,
    ):
        self.body, self._hand, self._varied = body, hand, varied
        super().__init__(scene, control_freq, control_mode)

    def _load_articulation(self, initial_pose: Any = None) -> None:
        self.robot = self.body.articulation
        self.robot_link_names = [link.name for link in self.robot.get_links()]

    @property
    def _controller_configs(self) -> dict[str, Any]:
        joint, body = [self.body.simulated.asset.joint], self.body
        step = _DELTA * (body.upper - body.lower)
        absolute = MotorConfig(joint, body.lower, body.upper, 0.0, 0.0, normalize_action=self._varied, body=body)
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
        """qpos as read by the asset's sensor, qvel, and the controller's state, each with ManiSkill's batch."""
        obs: dict[str, Any] = {"qpos": _to_tensor([self.body.q_measured]), "qvel": _to_tensor([self.body.qd])}
        state = self.controller.get_state()
        if state:
            obs["controller"] = state
        return obs


class Commands:
    """Commanded values over time; held between commands, before the first and after the last."""

    def __init__(self) -> None:
        self._times: list[float] = []
        self._values: list[float] = []

    def add(self, time_s: float, value: float) -> None:
        """`value` from `time_s` on."""
        self._times.append(time_s)
        self._values.append(value)

    def __call__(self, time_s: float) -> float:
        return self._values[max(bisect_right(self._times, time_s) - 1, 0)]


class MotorController(PDJointPosController):
    """ManiSkill's position controller, but targets go to the actuator of `generator.simulate`: the engine's drive is
    taken by Coulomb friction."""

    config: MotorConfig

    def _get_joint_limits(self) -> np.ndarray:
        return np.array([[self.config.lower, self.config.upper]], np.float32)

    @property
    def qpos(self) -> torch.Tensor:
        return _to_tensor([self.config.body.q])

    def set_drive_property(self) -> None:
        """The engine's drive is not used."""

    def reset(self) -> None:
        super().reset()
        simulated = self.config.body.simulated
        inertia, rate = simulated.joint_inertia, 2 * np.pi * _MOTOR_HZ
        self._commands = Commands()
        self._commands.add(-np.inf, self.config.body.q)
        simulated.set_actuator(
            Actuator(self._commands, inertia * rate**2, 2 * inertia * rate, lambda t: -self._weight(simulated))
        )

    @staticmethod
    def _weight(simulated: Any) -> float:
        return float(simulated.mechanics.gravity_force(simulated.state()[0]))

    def set_drive_targets(self, targets: torch.Tensor) -> None:
        body = self.config.body
        target = float(np.clip(float(targets[0, 0]), body.lower, body.upper))
        self._target_qpos = _to_tensor([target])
        self._commands.add(body.simulated.time_s, target)

    def set_state(self, state: dict[str, Any]) -> None:
        super().set_state(state)
        if "target_qpos" in state:
            self.set_drive_targets(self._target_qpos)


@dataclass
class MotorConfig(PDJointPosControllerConfig):
    """A motor in the joint of `body`."""

    body: Any = None
    controller_cls = MotorController


class PassiveController(BaseController):
    """No motor: the joint is free. Actions are empty."""

    sets_target_qpos = sets_target_qvel = False

    def _initialize_action_space(self) -> None:
        self.single_action_space = spaces.Box(np.empty(0, np.float32), np.empty(0, np.float32), dtype=np.float32)

    def set_drive_property(self) -> None:
        """The engine's drive is not used."""

    def reset(self) -> None:
        self.config.body.simulated.set_actuator(None)

    def set_action(self, action: Any) -> None:
        """Nothing acts."""


@dataclass
class PassiveConfig(ControllerConfig):
    """The joint of `body` without a motor."""

    body: Any = None
    controller_cls = PassiveController


class HandController(BaseController):
    """Moves the hand by a twist per control step: shift and rotation vector, world axes, about the root's origin."""

    sets_target_qpos = sets_target_qvel = False

    def _initialize_joints(self) -> None:
        self.joints: list[Any] = []
        self.active_joint_indices = torch.zeros(0, dtype=torch.int32)

    def _initialize_action_space(self) -> None:
        self.single_action_space = spaces.Box(-np.ones(6, np.float32), np.ones(6, np.float32), dtype=np.float32)

    def set_drive_property(self) -> None:
        """The engine's drive is not used."""

    def reset(self) -> None:
        self.config.hand.lead()

    def set_action(self, action: torch.Tensor) -> None:
        """Six numbers within -1 and 1, as fractions of the largest step."""
        step = np.clip(np.asarray(action, float).reshape(6), -1, 1) * np.repeat(_HAND_STEP, 3)
        self.config.hand.go(step[:3], se3.exp_so3(step[3:]))


@dataclass
class HandConfig(ControllerConfig):
    """The hand that holds the object's base."""

    hand: Any = None
    controller_cls = HandController


def _to_tensor(values: Any) -> torch.Tensor:
    """(1, n) with ManiSkill's batch."""
    return torch.tensor([values], dtype=torch.float32)
