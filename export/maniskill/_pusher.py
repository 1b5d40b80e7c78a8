"""A ball that pushes: a finger on three crossed slides, the simplest robot that opens and shuts things from outside."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import sapien
import torch
from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.controllers.pd_joint_pos import PDJointPosControllerConfig
from mani_skill.agents.registration import register_agent

PUSHER = "freeart21_pusher"
"""robot_uids of this agent."""
RADIUS = 0.01
"""m: a fingertip's."""
STEP = 0.02
"""m by which a full action leads, along each world axis."""
_MASS, _SLIDE = 0.3, 0.001  # kg of the ball, a hand's, and of a slide, so that it is the same along every axis
_STIFFNESS, _DAMPING = 500.0, 25.0  # N/m, N*s/m: 10 N where it is held back by a full action; critical for 0.3 kg
_REACH = 5.0  # m


@register_agent()
class Pusher(BaseAgent):
    """The ball, without weight. `pd_joint_delta_pos`: (3,) within -1 and 1, a share of `STEP` from where it is.

    What holds it back feels up to 10 N along each axis.
    """

    uid = PUSHER

    def _load_articulation(self, initial_pose: Any = None) -> None:
        with tempfile.TemporaryDirectory() as folder:
            self.urdf_path = Path(folder) / "pusher.urdf"
            self.urdf_path.write_text(_urdf())
            super()._load_articulation(initial_pose if initial_pose is not None else sapien.Pose())

    def _after_init(self) -> None:
        self.tcp = self.robot.links_map["tip"]

    @property
    def _controller_configs(self) -> dict[str, Any]:
        slides = [joint.name for joint in self.robot.active_joints]
        drive = PDJointPosControllerConfig(slides, -STEP, STEP, _STIFFNESS, _DAMPING, use_delta=True)
        return {"pd_joint_delta_pos": drive}

    def place(self, positions: torch.Tensor) -> None:
        """Put the ball of each environment that is being reset to `positions` (m, 3), world frame, at rest."""
        self.robot.set_qpos(positions)
        self.robot.set_qvel(torch.zeros_like(positions))


def _urdf() -> str:
    """Three slides along x, y and z, the last with the ball."""
    inertia = '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'  # slides do not turn
    light, heavy = (f'<inertial><mass value="{mass}"/>{inertia}</inertial>' for mass in (_SLIDE, _MASS))
    limit = f'<limit lower="{-_REACH}" upper="{_REACH}" effort="1000" velocity="100"/>'
    ball = f'<geometry><sphere radius="{RADIUS}"/></geometry>'
    robot, parent = f'<link name="root">{light}</link>', "root"
    for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("tip", "0 0 1")):
        shapes = f"<visual>{ball}</visual><collision>{ball}</collision>" if name == "tip" else ""
        inertial = heavy if name == "tip" else light
        robot += f'<link name="{name}">{inertial}{shapes}</link><joint name="to_{name}" type="prismatic">'
        robot += f'<parent link="{parent}"/><child link="{name}"/><axis xyz="{axis}"/>{limit}</joint>'
        parent = name
    return f'<robot name="pusher">{robot}</robot>'
