"""The object in ManiSkill's scene, stepped with its effects by `generator.simulate`."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Collection, Mapping, Sequence
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
from freeart21.mechanics import Actuator
from freeart21.se3 import Array
from generator import simulate

NAME = "object"
"""Of the articulation in ManiSkill's scene."""


class Body:
    """An articulated object in a CPU scene of ManiSkill; one joint moves under its effects."""

    n = 1

    def __init__(self, scene: Any, assets: Sequence[Asset], scale: float, timestep_s: float, fixed_base: bool):
        asset = assets[0]
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
        check_joint(asset, simulated)
        self._fixed = fixed_base
        self._joint = next(j for j in simulated.articulation.active_joints if j.name == asset.joint)
        self._limited = False
        self.links = {link.name: link for link in simulated.articulation.links}
        """URDF link name to the engine's link."""
        self.joint_name = asset.joint
        lower, upper = simulated.lower, simulated.upper
        self.limits = np.array([[lower, upper]])
        """(n, 2) the joint's limits, rad or m."""
        self.spans = np.array([joint_span(lower, upper, simulated.world_joint.type == "prismatic")])
        """(n, 2) range of the joint's targets, rad or m."""
        self.articulations = [simulated.articulation]
        self.articulation = register_articulations(self.articulations, scene, same_links=True)
        self.link_names = [link.name for link in self.articulation.get_links()]
        self.moving = [link for name, link in self.links.items() if name in simulated.moving_links]
        self._senses = any(effect.kind == "sensing" for effect in simulated.effects)
        late = sum(e.delay() for e in simulated.effects if e.kind == "sensing")
        self._history: deque[tuple[float, float]] = deque(maxlen=2 + int(np.ceil(late / timestep_s)))
        self._commands: list[tuple[float, float]] = []
        """Times, s, and the positions commanded since then; the first also before its time."""
        self.restarted = torch.ones(1, dtype=torch.bool)
        """(n,) environments that the controllers' next reset is for; ManiSkill does not say which."""
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

    @property
    def q(self) -> float:
        """Position of the joint, rad or m."""
        return self.simulated.state()[0]

    @property
    def qd(self) -> float:
        """Velocity of the joint, rad/s or m/s."""
        return self.simulated.state()[1]

    # what the environments ask of any number of bodies n, here 1; see `_body_batch.BodyBatch`

    def states(self) -> torch.Tensor:
        """(2, n) float32: position, rad or m, and velocity of the joint."""
        return torch.tensor([[self.q], [self.qd]], dtype=torch.float32)

    def measured(self) -> torch.Tensor:
        """(n,) float32: reading of a sensor with the asset's sensing effects."""
        if not self._senses:
            return self.states()[0]
        times, q = np.array(self._history).T
        return torch.tensor([float(readings(self.simulated.effects, times, q)[-1])], dtype=torch.float32)

    def centres(self) -> torch.Tensor:
        """(n, 3) float32 centre of mass of the moving part, world frame, m."""
        masses = np.array([link.mass for link in self.moving])
        centres = np.array([(link.entity_pose * link.cmass_local_pose).p for link in self.moving], float)
        return torch.from_numpy((masses @ centres / masses.sum())[None].astype(np.float32))

    def root_poses(self) -> Array:
        """(n, 4, 4) T_world_root."""
        pose = self.articulations[0].root_pose
        return se3.pose_from_wxyz(pose.p.astype(float), pose.q.astype(float))[None]

    def times_s(self) -> Array:
        """(n,) the clocks, s."""
        return np.array([self.simulated.time_s])

    def corners(self, q: Array) -> Array:
        """(n, 2, 3) corners of the collision shapes with the joint at `q` (n,) and the root at the origin, m."""
        self.put(float(q[0]))
        mesh = self.articulation.get_first_collision_mesh(to_world_frame=True)
        if mesh is None or not len(mesh.vertices):
            raise FreeArtError(f"{self.simulated.asset.urdf} has no collision shapes, expected some")
        return np.asarray(mesh.bounds, float)[None]

    def place(self, rows: torch.Tensor, q: Array, T_world_root: Array) -> None:
        """`put` in the environments `rows` (m,): positions (m,) and root poses (m, 4, 4)."""
        self.put(float(q[0]), T_world_root[0])

    def read(self, rows: torch.Tensor) -> None:
        """Take the state that was set in the engine."""
        articulation = self.simulated.articulation
        self.simulated.set_state(float(articulation.qpos[0]), float(articulation.qvel[0]))
        self.simulated.update_gravity()
        self._history.clear()
        self._note()

    def part_ids(self) -> torch.Tensor:
        """(n, links, 2) int16: id in segmentation images, and 1 for the parent's side or 2 for the moving side."""
        return torch.from_numpy(number_parts(self.links, self.simulated.moving_links)[None])

    # motor

    def start_motor(self, rate: float) -> None:
        """Give the joint a critically damped motor of `rate` rad/s on its inertia, which bears the weight and holds it
        where it is; only where `restarted`."""
        simulated = self.simulated
        self._commands = [(-np.inf, self.q)]
        inertia = simulated.joint_inertia
        simulated.set_actuator(Actuator(self._commanded, inertia * rate**2, 2 * inertia * rate, self._weight))

    def remove_motor(self) -> None:
        """Let the joint go."""
        self.simulated.set_actuator(None)

    def command(self, targets: torch.Tensor) -> torch.Tensor:
        """Command the motors to `targets` (n,), rad or m, from now on; returns them, float32, clipped to the spans."""
        target = float(np.clip(float(targets[0]), *self.spans[0]))
        self._commands.append((self.simulated.time_s, target))
        return torch.tensor([target], dtype=torch.float32)

    def _commanded(self, time_s: float) -> float:
        return self._commands[bisect_right(self._commands, (time_s, np.inf)) - 1][1]

    def _weight(self, time_s: float) -> float:
        return -float(self.simulated.mechanics.gravity_force(self.q))

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
            wide = (-simulate.UNREACHED, simulate.UNREACHED)
            self._joint.set_limits(np.array([np.clip(self.limits[0], *wide) if enabled else wide], np.float32))
            self._limited = enabled

    def _note(self) -> None:
        if self._senses:
            self._history.append((self.simulated.time_s, self.q))


def check_joint(asset: Asset, simulated: simulate.SimulatedAsset) -> None:
    """Raise FreeArtError if the joint moves no mass; warn of effects that do not show."""
    if simulated.joint_inertia <= 0:
        raise FreeArtError(f"{asset.urdf} joint '{asset.joint}' moves no mass")
    unseen = [effect.name for effect in simulated.effects if effect.kind == "kinematics"]
    if unseen:
        logger.warning(f"{asset.urdf}: ManiSkill does not render the effects {', '.join(unseen)}")


def number_parts(links: Mapping[str, Any], moving: Collection[str]) -> np.ndarray:
    """(n, 2) int16 per link of `links`, the engine's by name: id in segmentation images, 2 where `moving`, else 1."""
    return np.array([(link.entity.per_scene_id, 2 if name in moving else 1) for name, link in links.items()], np.int16)


def register_articulations(articulations: Sequence[Any], scene: Any, same_links: bool) -> Articulation:
    """ManiSkill's view of SAPIEN articulations, one in each sub-scene, named and registered as by its builder.

    With `same_links` all have the same links. Else each is registered alone, and the view is a merged one.
    """
    groups = [list(range(len(articulations)))] if same_links else [[i] for i in range(len(articulations))]
    views = []
    for rows in groups:
        name = NAME if same_links else f"{NAME}-{rows[0]}"
        for i in rows:
            for link in articulations[i].links:
                link.name = f"scene-{i}-{name}_{link.name}"
                link.joint.name = f"scene-{i}-{name}_{link.joint.name}"
            articulations[i].name = f"scene-{i}_{name}"
        here = torch.tensor(rows, dtype=torch.int32)
        view = Articulation.create_from_physx_articulations([articulations[i] for i in rows], scene, here)
        view.initial_pose = Pose.create(sapien.Pose(), device=scene.device)
        scene.articulations[name] = view
        views.append(view)
    merged = views[0] if same_links else Articulation.merge(views, name=NAME)
    scene.add_to_state_dict_registry(merged)
    return merged
