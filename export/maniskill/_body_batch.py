"""The objects of many environments in ManiSkill's GPU scenes, stepped with their effects by `JointBatch`.

The engine's drive, armature and limits of a joint, by which Coulomb friction, inertia and rest at a limit act, have no
buffers on the GPU: SAPIEN sets them joint by joint, here only where they change.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import sapien
import torch
from mani_skill.utils.geometry.trimesh_utils import get_component_mesh
from mani_skill.utils.structs import Pose

from export.maniskill._batch import JointBatch, Kick
from export.maniskill._body import check_joint, number_parts, register_articulations
from export.maniskill.assets import joint_span, prepare_asset
from freeart21 import se3
from freeart21.asset import Asset
from freeart21.effects.base import readings
from freeart21.errors import FreeArtError
from freeart21.files.asset import find_movable_joint
from freeart21.files.urdf import read_urdf
from freeart21.joint import Joint
from freeart21.se3 import Array
from generator import simulate
from generator.sapien_asset import build_articulation


class BodyBatch:
    """Articulated objects in GPU scenes, one in each of n environments; one joint of each moves under its effects.

    Its functions are those of `Body`. Environment i has the asset i modulo their number. All are stepped in as many
    substeps as the stiffest needs.
    """

    def __init__(self, scene: Any, assets: Sequence[Asset], scale: float, timestep_s: float, fixed_base: bool):
        self._scene, self._timestep, self._fixed = scene, timestep_s, fixed_base
        self.n = len(scene.sub_scenes)
        self._device = scene.device
        models: list[simulate.SimulatedAsset] = []
        self.articulations: list[Any] = [None] * self.n
        for first, asset in enumerate(assets[: self.n]):
            with prepare_asset(asset, scale) as readable:
                alone = sapien.Scene([sapien.physx.PhysxCpuSystem()])  # with the gravity that ManiSkill has set
                model = simulate.load(readable, timestep_s=timestep_s, scene=alone, settable_limits=True)
                check_joint(asset, model)
                models.append(model)
                for i in range(first, self.n, len(assets)):
                    self.articulations[i] = build_articulation(
                        readable,
                        read_urdf(readable.urdf),
                        find_movable_joint(readable.urdf, readable.joint),
                        scene.sub_scenes[i],
                        fixed_base=fixed_base,
                        visuals=scene.can_render(),
                        collisions=True,
                        settable_limits=True,
                    )
        self._models = [models[i % len(models)] for i in range(self.n)]
        """(n,) the asset of each environment in a CPU scene: what a GPU scene does not say before it is stepped."""
        self.links = [{link.name: link for link in articulation.links} for articulation in self.articulations]
        self._engine_joints = [
            next(j for j in articulation.active_joints if j.name == model.asset.joint)
            for articulation, model in zip(self.articulations, self._models, strict=True)
        ]
        self.joint_name = models[0].asset.joint
        self.link_names = list(self.links[0])
        self.articulation = register_articulations(self.articulations, scene, same_links=len(models) == 1)
        self.joints = JointBatch(self._models, self._device)
        self.limits = np.array([[model.lower, model.upper] for model in self._models])
        self.spans = np.array([joint_span(m.lower, m.upper, m.world_joint.type == "prismatic") for m in self._models])
        self._bounds = torch.tensor(self.spans, device=self._device)
        self.restarted = torch.ones(self.n, dtype=torch.bool, device=self._device)
        self._read_geometry()
        self._friction, self._armature = torch.zeros_like(self.joints.q), torch.zeros_like(self.joints.q)
        self._limited = torch.zeros_like(self.restarted)
        late = [sum(e.delay() for e in model.effects if e.kind == "sensing") for model in self._models]
        self._senses = [any(e.kind == "sensing" for e in model.effects) for model in self._models]
        self._history: deque[tuple[torch.Tensor, torch.Tensor]] = deque(maxlen=2 + int(np.ceil(max(late) / timestep_s)))
        if not fixed_base:
            self._keep_limits(torch.ones_like(self.restarted))

    def _read_geometry(self) -> None:
        """Where the moving parts' centres are in the root's frame, still + cos q * c + sin q * s + q * axis, and the
        rotation of the joints' parents there."""
        rows = [_centre(model.world_joint, model._moment_at_zero / model.moving_mass) for model in self._models]
        self._centre_terms = [self._tensor([row[k] for row in rows]) for k in range(4)]
        self._R_root_parent = self._tensor([model.link_pose(model._parent)[:3, :3] for model in self._models])

    def _tensor(self, values: Any) -> torch.Tensor:
        return torch.as_tensor(np.asarray(values, float), device=self._device)

    # state

    def states(self) -> torch.Tensor:
        """(2, n) float32: position, rad or m, and velocity of the joint."""
        return torch.stack([self.joints.q, self.joints.qd]).float()

    def times_s(self) -> Array:
        """(n,) the clocks, s."""
        return np.asarray(self.joints.time_s.cpu().numpy())

    def root_poses(self) -> Array:
        """(n, 4, 4) T_world_root, each in its own sub-scene."""
        pose = self.articulation.root.pose.raw_pose.cpu().numpy().astype(float)
        return se3.pose_from_wxyz(pose[:, :3], pose[:, 3:])

    def centres(self) -> torch.Tensor:
        """(n, 3) float32 centre of mass of the moving part, world frame, m."""
        still, across, turned, axis = self._centre_terms
        q = self.joints.q[:, None]
        centre = still + torch.cos(q) * across + torch.sin(q) * turned + q * axis
        T = self._tensor(self.root_poses())
        return ((T[:, :3, :3] @ centre[:, :, None])[:, :, 0] + T[:, :3, 3]).float()

    def measured(self) -> torch.Tensor:
        """(n,) float32: readings of sensors with the assets' sensing effects."""
        seen = self.states()[0]
        if any(self._senses):
            times, q = (torch.stack(column).cpu().numpy() for column in zip(*self._history, strict=True))
            for i in np.flatnonzero(self._senses):
                known = np.isfinite(times[:, i])
                seen[i] = float(readings(self._models[i].effects, times[known, i], q[known, i])[-1])
        return seen

    def corners(self, q: Array) -> Array:
        """(n, 2, 3) corners of the collision shapes with the joint at `q` (n,) and the root at the origin, m."""
        found: dict[int, Array] = {}
        for model, position in zip(self._models, q, strict=True):
            if id(model) not in found:
                model.set_state(float(position))
                meshes = [get_component_mesh(link, to_world_frame=True) for link in model.articulation.links]
                bounds = np.array([mesh.bounds for mesh in meshes if mesh is not None])
                if not len(bounds):
                    raise FreeArtError(f"{model.asset.urdf} has no collision shapes, expected some")
                found[id(model)] = np.array([bounds[:, 0].min(0), bounds[:, 1].max(0)])
        return np.array([found[id(model)] for model in self._models])

    def part_ids(self) -> torch.Tensor:
        """(n, links, 2) int16 as of `Body`, with rows of zeros where an asset has fewer links."""
        most = max(len(links) for links in self.links)
        ids = np.zeros((self.n, most, 2), np.int16)
        for row, links, model in zip(ids, self.links, self._models, strict=True):
            row[: len(links)] = number_parts(links, model.moving_links)
        return torch.from_numpy(ids).to(self._device)

    def place(self, rows: torch.Tensor, q: Array, T_world_root: Array) -> None:
        """Put the joints of the environments `rows` (m,) at `q` (m,), at rest, and their roots at poses (m, 4, 4).

        Their clocks and effects with memory begin anew.
        """
        at = self._tensor(q)
        self.joints.set_state(at, torch.zeros_like(at), rows)
        placed = np.concatenate([T_world_root[:, :3, 3], se3.wxyz(T_world_root)], axis=1)
        with self._only(rows):
            view, still = self.articulation, torch.zeros((len(rows), 3), device=self._device)
            view.set_root_pose(Pose.create(self._tensor(placed).float()))
            view.set_root_linear_velocity(still)
            view.set_root_angular_velocity(still)
            view.set_qpos(at[:, None].float())
            view.set_qvel(still[:, :1])
            view.set_qf(still[:, :1])
        self._forget(rows)

    def read(self, rows: torch.Tensor) -> None:
        """Take the state of the environments `rows` (m,) that was set in the engine."""
        view = self.articulation
        self.joints.set_state(view.qpos[rows, 0], view.qvel[rows, 0], rows, restart=False)
        self._forget(rows)

    @contextmanager
    def _only(self, rows: torch.Tensor) -> Iterator[None]:
        """ManiSkill's functions set the environments `rows` only."""
        before = self._scene._reset_mask
        self._scene._reset_mask = torch.zeros_like(before)
        self._scene._reset_mask[rows] = True
        yield
        self._scene._reset_mask = before

    # motor

    def start_motor(self, rate: float) -> None:
        """Give the joints critically damped motors of `rate` rad/s on their inertia; only where `restarted`.

        They bear the weight and hold the joints where they are.
        """
        inertia, rows = self.joints.joint_inertia, self.restarted.nonzero()[:, 0]
        if len(rows) == self.n:
            self.joints.set_motor(inertia * rate**2, 2 * inertia * rate)
        self.joints.command(self.joints.q[rows], rows, at_s=-torch.inf)

    def remove_motor(self) -> None:
        """Let the joints go."""
        self.joints.remove_motor()

    def command(self, targets: torch.Tensor) -> torch.Tensor:
        """Command the motors to `targets` (n,), rad or m, from now on; returns them, float32, clipped to the spans."""
        clipped = torch.minimum(torch.maximum(targets.double(), self._bounds[:, 0]), self._bounds[:, 1])
        self.joints.command(clipped)
        return clipped.float()

    # stepping

    def before_step(self) -> None:
        """Apply effects before ManiSkill's next engine step; substeps needed by stiff effects are made here."""
        joints, px = self.joints, self._scene.px
        if not self._fixed:
            self._update_gravity()
        n = joints.substeps
        self._h = px.timestep = self._timestep / n
        for _ in range(n - 1):
            self._begin()
            px.step()
            self._end()
        self._begin()

    def after_step(self) -> None:
        """Read the result of the engine's step."""
        self._end()
        self._scene.px.timestep = self._timestep
        self._note()

    def settle(self) -> None:
        """Align the engine's positions with the joints': within a step they are half a step ahead."""
        self._write(self.joints.q, torch.zeros_like(self.joints.q))

    def _update_gravity(self) -> None:
        self._scene.px.gpu_fetch_articulation_link_pose()
        R = self._tensor(self.root_poses()[:, :3, :3]) @ self._R_root_parent
        self.joints.set_gravity((R.mT @ self._tensor(self._models[0].gravity)[:, None])[:, :, 0])

    def _begin(self) -> None:
        joints = self.joints
        if self._fixed:
            at_limit = (joints.q == joints.lower) | (joints.q == joints.upper)
            self._keep_limits(at_limit & (joints.qd == 0))
        kick = joints.before_engine(self._h)
        self._set_drives(kick)
        self._write(kick.q, kick.force)

    def _end(self) -> None:
        px = self._scene.px
        px.gpu_fetch_articulation_qpos()  # of a robot too: what is fetched is applied again before the next step
        px.gpu_fetch_articulation_qvel()
        self.joints.after_engine(self.articulation.qvel[:, 0], self._h)

    def _write(self, q: torch.Tensor, force: torch.Tensor) -> None:
        """Give the engine positions, the joints' velocities, and forces, (n,) each."""
        view, px = self.articulation, self._scene.px
        for name, values in (("qpos", q), ("qvel", self.joints.qd), ("qf", force)):
            setattr(view, name, values[:, None].float())
            getattr(px, f"gpu_apply_articulation_{name}")()
        px.gpu_update_articulation_kinematics()

    def _set_drives(self, kick: Kick) -> None:
        """Set Coulomb friction and armature, as `SimulatedAsset` does for one joint, where they have changed."""
        rubs = kick.friction != self._friction
        grows = (kick.armature - self._armature).abs() > 1e-9 * self.joints.joint_inertia
        for i, limit in _changes(rubs, kick.friction):
            damping = limit / simulate._CREEP_SPEED
            self._engine_joints[i].set_drive_properties(stiffness=0.0, damping=damping, force_limit=limit, mode="force")
        for i, armature in _changes(grows, kick.armature):
            self._engine_joints[i].set_armature(np.array([armature], np.float32))
        self._friction = kick.friction
        self._armature = torch.where(grows, kick.armature, self._armature)

    def _keep_limits(self, enabled: torch.Tensor) -> None:
        """Enable or disable the engine's joint limits (n,), as `Body` does for one."""
        wide = (-simulate.UNREACHED, simulate.UNREACHED)
        for i, on in _changes(enabled != self._limited, enabled):
            limits = np.clip(self.limits[i], *wide) if on else wide
            self._engine_joints[i].set_limits(np.array([limits], np.float32))
        self._limited = enabled

    def _note(self) -> None:
        if any(self._senses):
            self._history.append((self.joints.time_s.clone(), self.joints.q.clone()))

    def _forget(self, rows: torch.Tensor) -> None:
        """Begin the history of what sensors saw anew in the environments `rows`."""
        for times, _ in self._history:
            times[rows] = torch.nan
        if not self._history:
            self._note()
        elif any(self._senses):
            times, q = self._history[-1]
            times[rows], q[rows] = self.joints.time_s[rows], self.joints.q[rows]


def _changes(changed: torch.Tensor, values: torch.Tensor) -> Iterator[tuple[int, float]]:
    """Index and new value where `changed` (n,)."""
    rows = changed.nonzero()[:, 0]
    return zip(rows.tolist(), values[rows].tolist(), strict=True)


def _centre(joint: Joint, centre: Array) -> tuple[Array, Array, Array, Array]:
    """(3,) each, m: a point of the moving part that is at `centre` (3,) at q = 0 is, at q, at the first + cos q * the
    second + sin q * the third + q * the fourth."""
    none = np.zeros(3)
    if joint.type == "prismatic":
        return centre, none, none, joint.axis
    arm = centre - joint.pivot
    along = (arm @ joint.axis) * joint.axis
    return joint.pivot + along, arm - along, np.cross(joint.axis, arm), none
