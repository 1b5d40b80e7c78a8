"""The object in ManiSkill's scene, stepped with its effects by `generator.simulate`."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.utils.logging_utils import logger
from mani_skill.utils.structs import Articulation, Pose

from export.maniskill.assets import joint_span, prepare_asset
from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects.base import readings
from freeart21.errors import FreeArtError
from freeart21.se3 import Array
from generator import simulate

NAME = "object"
"""Of the articulation in ManiSkill's scene."""


class Body:
    """An articulated object in a CPU scene of ManiSkill; one joint moves under its effects."""

    def __init__(self, scene: Any, asset: Asset, scale: float, timestep_s: float, fixed_base: bool):
        self._scene, self._timestep = scene, timestep_s
        sub_scene = scene.sub_scenes[0]
        with prepare_asset(asset, scale) as readable:
            self.simulated = simulate.load(
                readable,
                timestep_s=timestep_s,
                fixed_base=fixed_base,
                scene=sub_scene,
                visuals=scene.can_render(),
                settable_limits=True,
            )
        simulated = self.simulated
        if simulated.joint_inertia <= 0:
            raise FreeArtError(f"{asset.urdf} joint '{asset.joint}' moves no mass")
        unseen = [effect.name for effect in simulated.effects if effect.kind == "kinematics"]
        if unseen:
            logger.warning(f"{asset.urdf}: ManiSkill does not render the effects {', '.join(unseen)}")
        self._fixed = fixed_base
        self._joint = next(j for j in simulated.articulation.active_joints if j.name == asset.joint)
        self._limited = False
        self.links = {link.name: link for link in simulated.articulation.links}
        """URDF link name to the engine's link."""
        self.lower, self.upper = joint_span(simulated.lower, simulated.upper, simulated.world_joint.type == "prismatic")
        """Range of the joint's targets, rad or m."""
        self.articulation = _register_articulation(simulated.articulation, scene)
        self.moving = [link for name, link in self.links.items() if name in simulated.moving_links]
        self._senses = any(effect.kind == "sensing" for effect in simulated.effects)
        late = sum(e.delay() for e in simulated.effects if e.kind == "sensing")
        self._history: deque[tuple[float, float]] = deque(maxlen=2 + int(np.ceil(late / timestep_s)))
        if not fixed_base:
            self._keep_limits(True)

    # state

    def put(self, q: float, T_world_root: Array | None = None) -> None:
        """Put the joint at `q`, at rest, and the root at its pose if given; reset the clock and effects with memory."""
        if T_world_root is not None:
            self.simulated.set_base_pose(T_world_root)
        self.simulated.time_s = 0.0
        self.simulated.set_state(q)
        self._history.clear()
        self._note()

    def fetch(self) -> None:
        """Read the state that was set in the engine."""
        articulation = self.simulated.articulation
        self.simulated.set_state(float(articulation.qpos[0]), float(articulation.qvel[0]))
        self.simulated.update_gravity()
        self._history.clear()
        self._note()

    @property
    def q(self) -> float:
        """Position of the joint, rad or m."""
        return self.simulated.state()[0]

    @property
    def qd(self) -> float:
        """Velocity of the joint, rad/s or m/s."""
        return self.simulated.state()[1]

    @property
    def q_measured(self) -> float:
        """Reading of a sensor with the asset's sensing effects."""
        if not self._senses:
            return self.q
        times, q = np.array(self._history).T
        return float(readings(self.simulated.effects, times, q)[-1])

    @property
    def root_pose(self) -> Array:
        """(4, 4) T_world_root."""
        pose = self.simulated.articulation.root_pose
        return se3.pose_from_wxyz(pose.p.astype(float), pose.q.astype(float))

    def bounds(self) -> Array:
        """(2, 3) smallest and largest corner of the collision shapes, world frame, m."""
        mesh = self.articulation.get_first_collision_mesh(to_world_frame=True)
        if mesh is None or not len(mesh.vertices):
            raise FreeArtError(f"{self.simulated.asset.urdf} has no collision shapes, expected some")
        return np.asarray(mesh.bounds, float)

    def moving_centre(self) -> Array:
        """(3,) centre of mass of the moving part, world frame, m."""
        masses = np.array([link.mass for link in self.moving])
        centres = np.array([(link.entity_pose * link.cmass_local_pose).p for link in self.moving], float)
        return np.asarray(masses @ centres / masses.sum())

    def part_ids(self) -> np.ndarray:
        """(n, 2) int16 per link: id in segmentation images, and 1 for the parent's side or 2 for the moving side."""
        return np.array(
            [
                (link.entity.per_scene_id, 2 if name in self.simulated.moving_links else 1)
                for name, link in self.links.items()
            ],
            np.int16,
        )

    # stepping

    def before_step(self) -> None:
        """Apply effects before ManiSkill's next engine step; substeps needed by stiff effects are made here."""
        simulated, px = self.simulated, self._scene.px
        if not self._fixed:
            simulated.update_gravity()
        n = simulated.substeps
        self._h = px.timestep = self._timestep / n
        for _ in range(n - 1):
            self._begin()
            px.step()
            simulated.after_engine(self._h)
        self._begin()

    def after_step(self) -> None:
        """Read the result of the engine's step."""
        self.simulated.after_engine(self._h)
        self._scene.px.timestep = self._timestep
        self._note()

    def settle(self) -> None:
        """Align the engine's link poses with the joint: within a step its position is half a step ahead."""
        self.simulated.link_pose(self.simulated.asset.reference_link)

    def _begin(self) -> None:
        if self._fixed:
            resting = self.qd == 0 and self.q in (self.simulated.lower, self.simulated.upper)
            self._keep_limits(resting)
        self.simulated.before_engine(self._h)

    def _keep_limits(self, enabled: bool) -> None:
        """Enable or disable the engine's joint limits.

        `generator.simulate` computes impacts and bounces at limits, so the engine's limits must be off. A part that
        rests at a limit needs them for contact forces, and a free base for the reaction: there impacts are inelastic.
        """
        if enabled != self._limited:
            own, wide = (self.simulated.lower, self.simulated.upper), (-simulate.UNREACHED, simulate.UNREACHED)
            self._joint.set_limits(np.array([np.clip(own, *wide) if enabled else wide], np.float32))
            self._limited = enabled

    def _note(self) -> None:
        if self._senses:
            self._history.append((self.simulated.time_s, self.q))


def _register_articulation(articulation: Any, scene: Any) -> Articulation:
    """ManiSkill's view of a SAPIEN articulation, named and registered as by its builder."""
    for link in articulation.links:
        link.name = f"scene-0-{NAME}_{link.name}"
        link.joint.name = f"scene-0-{NAME}_{link.joint.name}"
    articulation.name = f"scene-0_{NAME}"
    managed = Articulation.create_from_physx_articulations([articulation], scene, torch.zeros(1, dtype=torch.int32))
    managed.initial_pose = Pose.create(sapien.Pose())
    scene.articulations[NAME] = managed
    scene.add_to_state_dict_registry(managed)
    return managed
