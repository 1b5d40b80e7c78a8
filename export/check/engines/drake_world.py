"""Drake: its own URDF parser, a discrete multibody plant."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    DefaultProximityProperties,
    HalfSpace,
    ProximityProperties,
    SceneGraphConfig,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, DiscreteContactApproximation
from pydrake.multibody.tree import PdControllerGains
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from export.check.engines.base import GRAVITY, Setting, World
from export.check.engines.plain_urdf import write_plain_urdf
from freeart21.files.urdf import UrdfInertial, read_urdf
from freeart21.se3 import Array

_STEP_S, _FRICTION = 0.002, 0.5
_CREEP = 1e-6
"""rad/s or m/s at which the damper that models Coulomb friction saturates, as in the asset's own loader, where it was
measured (`tests/test_loaders.py`)."""
_MODULUS_PER_KG, _HARDEST = 1e8, 1e9
"""Pa of hydroelastic modulus per kg of the asset, and Pa at most, that of plastics and wood. The stiffest contact that
steps of 2 ms follow grows with the mass: at Drake's default of 1e7 a nightstand of 25 kg sinks by 2.2 mm and cabinets
of 370 kg by 7, at 1e9 phones of 100 g fly off, and at 1e7 a lighter of 21 g trembles."""


def load(file: Path, folder: Path, setting: Setting) -> DrakeWorld:
    """The asset in a plant of its own."""
    builder = DiagramBuilder()
    plant, geometry = AddMultibodyPlantSceneGraph(builder, time_step=_STEP_S)
    plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)  # by default light assets tremble
    # without hydroelastic contact a box on a plane has one contact point and sinks in within seconds
    urdf = read_urdf(file)
    mass = sum(link.inertial.mass for link in urdf.links.values() if link.inertial is not None)
    properties = DefaultProximityProperties(
        compliance_type="compliant",
        hydroelastic_modulus=min(_MODULUS_PER_KG * mass, _HARDEST),
        dynamic_friction=_FRICTION,
        static_friction=_FRICTION,
    )
    geometry.set_config(SceneGraphConfig(default_proximity_properties=properties))
    (model,) = Parser(plant).AddModels(write_plain_urdf(file, folder))
    plant.mutable_gravity_field().set_gravity_vector([0, 0, -GRAVITY if setting.gravity else 0.0])
    if setting.floor:
        hard = ProximityProperties()
        AddContactMaterial(properties=hard, friction=CoulombFriction(_FRICTION, _FRICTION))
        AddRigidHydroelasticProperties(hard)
        plant.RegisterCollisionGeometry(plant.world_body(), RigidTransform(), HalfSpace(), "floor", hard)
    bodies = [plant.get_body(k) for k in plant.GetBodyIndices(model)]
    children = {plant.get_joint(k).child_body().name() for k in plant.GetJointIndices(model)}
    root = next((body for body in bodies if body.name() not in children), None)
    if root is not None and setting.fixed:
        plant.WeldFrames(plant.world_frame(), root.body_frame())
    has_friction = _add_friction(plant, model, {j.name: j.friction for j in urdf.joints.values()})
    plant.Finalize()
    if has_friction:
        still = builder.AddSystem(ConstantVectorSource(np.zeros(2 * plant.num_actuators(model))))
        builder.Connect(still.get_output_port(), plant.get_desired_state_input_port(model))
    return DrakeWorld(builder.Build(), plant, model, bodies, root)


def _add_friction(plant: Any, model: Any, friction: Mapping[str, float]) -> bool:
    """Add the friction that Drake drops from a URDF; returns whether there is any.

    An actuator that is only a damper towards speed 0, limited to the friction: a discrete plant solves it together with
    the contacts.
    """

    for k in plant.GetJointActuatorIndices(model):  # from the file's transmissions, which are not driven here
        plant.RemoveJointActuator(plant.get_joint_actuator(k))
    joints = [plant.get_joint(k) for k in plant.GetJointIndices(model)]
    rubs = [joint for joint in joints if joint.num_velocities() == 1 and friction.get(joint.name(), 0.0) > 0]
    for joint in rubs:
        limit = friction[joint.name()]
        actuator = plant.AddJointActuator(f"{joint.name()}_friction", joint, limit)
        actuator.set_controller_gains(PdControllerGains(p=1e-9, d=limit / _CREEP))
    return bool(rubs)


class DrakeWorld(World):
    """See `World`."""

    def __init__(self, diagram: Any, plant: Any, model: Any, bodies: list[Any], root: Any):

        self.plant, self.root = plant, root
        self.bodies = {body.name(): body for body in bodies}
        self.simulator = Simulator(diagram)
        self.context = plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
        joints = [plant.get_joint(k) for k in plant.GetJointIndices(model)]
        ends = [j for j in joints if j.child_body().name() in self.bodies and j.parent_body().name() in self.bodies]
        self.parents = {name: None for name in self.bodies}
        self.parents |= {j.child_body().name(): j.parent_body().name() for j in ends}
        self.drake_joints = {joint.name(): joint for joint in ends if joint.num_velocities() == 1}
        self.limits = {
            name: (float(joint.position_lower_limits()[0]), float(joint.position_upper_limits()[0]))
            for name, joint in self.drake_joints.items()
        }

    def inertials(self) -> dict[str, UrdfInertial]:
        found = {}
        for name, body in self.bodies.items():
            M = body.CalcSpatialInertiaInBodyFrame(self.context)
            centre = np.asarray(M.get_com(), float)
            about = np.asarray(M.CalcRotationalInertia().CopyToFullMatrix3(), float)
            mass = float(M.get_mass())
            about = about - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
            found[name] = UrdfInertial(mass, centre, about)
        return found

    def put(self, q: Mapping[str, float], qd: Mapping[str, float] | None = None) -> None:
        at, speed = self.plant.GetPositions(self.context).copy(), self.plant.GetVelocities(self.context).copy()
        for name, joint in self.drake_joints.items():
            at[joint.position_start()] = q.get(name, 0.0)
            speed[joint.velocity_start()] = (qd or {}).get(name, 0.0)
        self.plant.SetPositions(self.context, at)
        self.plant.SetVelocities(self.context, speed)
        self.simulator.Initialize()

    def place(self, T_world_root: Array) -> None:

        T: Any = np.array(T_world_root, float)
        self.plant.SetFreeBodyPose(self.context, self.root, RigidTransform(T))
        self.simulator.Initialize()

    def state(self) -> tuple[dict[str, float], dict[str, float]]:
        at, speed = self.plant.GetPositions(self.context), self.plant.GetVelocities(self.context)
        q = {name: float(at[joint.position_start()]) for name, joint in self.drake_joints.items()}
        return q, {name: float(speed[joint.velocity_start()]) for name, joint in self.drake_joints.items()}

    def poses(self) -> dict[str, Array]:
        found = {name: body.EvalPoseInWorld(self.context) for name, body in self.bodies.items()}
        return {name: np.asarray(T.GetAsMatrix4(), float) for name, T in found.items()}

    def advance(self, seconds: float, push: Mapping[str, float] | None = None) -> None:
        forces = np.zeros(self.plant.num_velocities())
        for name, force in (push or {}).items():
            forces[self.drake_joints[name].velocity_start()] = force
        self.plant.get_applied_generalized_force_input_port().FixValue(self.context, forces)
        self.simulator.AdvanceTo(self.simulator.get_context().get_time() + seconds)
