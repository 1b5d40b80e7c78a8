"""ManiSkill's GPU scenes without a GPU: n CPU scenes behind the tensors and functions of SAPIEN's GPU system.

As there, what is written to a tensor reaches the engine only by `gpu_apply_...`, and the other way by `gpu_fetch_...`;
all articulations at once, a robot's among them. Nothing of CUDA.
"""

import contextlib
from types import SimpleNamespace

import numpy as np
import sapien
import torch
from mani_skill.envs import sapien_env
from mani_skill.envs.scene import ManiSkillScene
from mani_skill.envs.utils.system.backend import BackendInfo
from mani_skill.utils.building.actor_builder import ActorBuilder
from mani_skill.utils.structs.articulation import Articulation
from mani_skill.utils.structs.articulation_joint import ArticulationJoint
from mani_skill.utils.structs.base import PhysxRigidBodyComponentStruct


class CpuScenes:
    """Stands for `sapien.physx.PhysxGpuSystem`; each sub-scene is a CPU scene of its own."""

    def __init__(self, scene):
        self._scene, self._systems = scene, [sub_scene.physx_system for sub_scene in scene.sub_scenes]

    @property
    def timestep(self):
        return self._systems[0].timestep

    @timestep.setter
    def timestep(self, seconds):
        for system in self._systems:
            system.timestep = seconds

    def get_scene_offset(self, sub_scene):
        return np.zeros(3)

    def step(self):
        self.gpu_apply_articulation_target_position()  # ManiSkill does so where the device is CUDA's
        for system in self._systems:
            system.step()

    def gpu_init(self):
        self._all = [a for view in self._scene.articulations.values() for a in view._objs]
        actors = [actor for actor in self._scene.actors.values() if actor.px_body_type != "static"]
        self._actors = [body for actor in actors for body in actor._bodies]
        self._bodies = [link for articulation in self._all for link in articulation.links] + self._actors
        self.articulation_rows = {id(a): row for row, a in enumerate(self._all)}
        self.body_rows = {id(body): row for row, body in enumerate(self._bodies)}
        shape = len(self._all), max(a.dof for a in self._all)
        for name in ("qpos", "qvel", "qf", "qacc", "target_qpos", "target_qvel"):
            setattr(self, f"cuda_articulation_{name}", buffer(torch.zeros(shape)))
        self.cuda_rigid_body_data = buffer(torch.zeros(len(self._bodies), 13))
        self._fetch_bodies()

    def _fetch_bodies(self):
        rows = [[*k.entity_pose.p, *k.entity_pose.q, *k.linear_velocity, *k.angular_velocity] for k in self._bodies]
        self.cuda_rigid_body_data.torch()[:] = torch.tensor(np.array(rows))

    def __getattr__(self, name):
        """`gpu_apply_articulation_NAME` and `gpu_fetch_articulation_NAME`; the rest does nothing on a CPU."""
        action, _, what = name.removeprefix("gpu_").partition("_articulation_")
        if action == "apply" and what in ("qpos", "qvel", "qf"):
            return lambda: [self._set(a, what, row) for a, row in zip(self._all, self._rows(what), strict=True)]
        if action == "fetch" and what in ("qpos", "qvel", "qacc"):
            return lambda: [self._get(a, what, row) for a, row in zip(self._all, self._rows(what), strict=True)]
        if (action == "fetch" and what.startswith("link_")) or name == "gpu_fetch_rigid_dynamic_data":
            return self._fetch_bodies
        if name == "gpu_apply_rigid_dynamic_data":
            return lambda: [self._put(actor) for actor in self._actors]
        if action == "apply" and what.startswith("root_"):
            return lambda: [self._set_root(a, what) for a in self._all]
        if action == "apply" and what == "target_position":
            return lambda: [self._aim(a, row) for a, row in zip(self._all, self._rows("target_qpos"), strict=True)]
        nothing = ("update_articulation_kinematics", "target_qpos", "target_qvel")
        if name.startswith("gpu_") and name.endswith((*nothing, "target_velocity")):
            return lambda: None
        raise AttributeError(name)

    def _rows(self, what):
        return getattr(self, f"cuda_articulation_{what}").torch()

    def _set(self, articulation, what, row):
        getattr(articulation, f"set_{what}")(row[: articulation.dof].numpy())

    def _get(self, articulation, what, row):
        row[: articulation.dof] = torch.from_numpy(getattr(articulation, what))

    def _put(self, actor):
        row = self.cuda_rigid_body_data.torch()[self.body_rows[id(actor)]].numpy()
        actor.entity.set_pose(sapien.Pose(row[:3], row[3:7]))

    def _set_root(self, articulation, what):
        row = self.cuda_rigid_body_data.torch()[self.body_rows[id(articulation.root)]].numpy()
        if what == "root_pose":
            articulation.set_root_pose(sapien.Pose(row[:3], row[3:7]))
        else:
            articulation.set_root_linear_velocity(row[7:10])
            articulation.set_root_angular_velocity(row[10:13])

    def _aim(self, articulation, row):
        for joint, target in zip(articulation.active_joints, row.tolist(), strict=False):
            joint.set_drive_target(target)


def buffer(tensor):
    """Stands for SAPIEN's CudaArray."""
    return SimpleNamespace(torch=lambda: tensor)


@contextlib.contextmanager
def gpu_scenes_on_cpu(monkeypatch):
    """Inside, ManiSkill makes environments with `sim_backend="physx_cuda"` of CPU scenes."""
    cpu = BackendInfo(torch.device("cpu"), sapien.Device("cpu"), "physx_cuda", None, "none")

    def setup_scene(self):
        self._set_scene_config()
        sub_scenes = [sapien.Scene([sapien.physx.PhysxCpuSystem()]) for _ in range(self.num_envs)]
        self.scene = ManiSkillScene(sub_scenes, sim_config=self.sim_config, device=self.device, backend=self.backend)
        self.scene.px, self.scene.gpu_sim_enabled = CpuScenes(self.scene), True
        self.scene.px.timestep = 1.0 / self._sim_freq

    def rows(names, objects):
        return torch.tensor([names[id(one)] for one in objects], dtype=torch.int32)

    with monkeypatch.context() as patch:
        patch.setattr(sapien_env, "parse_sim_and_render_backend", lambda *_: cpu)
        patch.setattr(sapien_env.BaseEnv, "_setup_scene", setup_scene)
        patch.setattr(Articulation, "_data_index", property(lambda s: rows(s.px.articulation_rows, s._objs)))
        of_joint = property(lambda s: rows(s.px.articulation_rows, s._physx_articulations))
        patch.setattr(ArticulationJoint, "_data_index", of_joint)
        body = PhysxRigidBodyComponentStruct
        patch.setattr(body, "_body_data_index", property(lambda s: rows(s.px.body_rows, s._bodies)))
        patch.setattr(body, "_body_data", property(lambda s: s.px.cuda_rigid_body_data.torch()))
        # on a GPU the first scene's ground is under all
        everywhere = property(lambda s: True, lambda s, value: None)
        patch.setattr(ActorBuilder, "_allow_overlapping_plane_collisions", everywhere, raising=False)
        yield
