"""This asset in Drake, with what Drake drops put back. Measured with Drake 1.51.1.

Drake warns of a URDF's friction and drops it. Here the joint gets an actuator that is nothing but friction: a damper of
speed 0, cut off at the friction's size, which a discrete plant solves together with the contacts. The actuator carries
the armature, too, and a spring is a force element.

    instance = load(plant)                # before plant.Finalize()
    connect(builder, plant, instance)     # after it: without this there is no friction
"""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

PLAYED = {"damping", "friction", "armature", "stiffness"}
CREEP = 1e-6  # rad/s or m/s at which the friction's damper is cut off


def load(plant: Any, X_WB: Any = None, fixed: bool | None = None) -> Any:
    """The model instance in `plant` (a discrete MultibodyPlant, not yet finalized), its base link at `X_WB`.

    `fixed` None takes the asset's own base; a base that was exported fixed stands at the world's origin.
    """
    from pydrake.math import RigidTransform
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.tree import PdControllerGains, PrismaticSpring, RevoluteSpring

    said = _said()
    if said["base"] == "fixed" and (fixed is False or X_WB is not None):
        raise ValueError(f"{said['urdf']} was exported with a fixed base: it cannot move freely, nor stand elsewhere")
    if said["friction"] and plant.time_step() == 0:
        raise ValueError("the plant is continuous: Drake solves this joint's friction in discrete plants only")
    if said["trust"].startswith("doubtful"):
        warnings.warn(f"{said['urdf']} was made of a reconstruction that is {said['trust']}", stacklevel=2)
    if left := [name for name, word in said["effects"].items() if word not in PLAYED]:
        warnings.warn(f"Drake plays {said['urdf']} without {', '.join(left)}", stacklevel=2)

    parser = Parser(plant)
    parser.SetAutoRenaming(True)  # a plant may hold the asset more than once
    (instance,) = parser.AddModels(Path(__file__).resolve().parent.parent / said["urdf"])
    base = plant.GetBodyByName(said["base_link"], instance)
    if fixed and said["base"] == "free":
        plant.WeldFrames(plant.world_frame(), base.body_frame(), X_WB or RigidTransform())
    elif X_WB is not None:
        plant.SetDefaultFloatingBaseBodyPose(base, X_WB)
    joint = plant.GetJointByName(said["joint"], instance)
    if said["friction"] or said["armature"]:
        actuator = plant.AddJointActuator(f"{said['joint']}_friction", joint, said["friction"] or float("inf"))
        actuator.set_default_rotor_inertia(said["armature"])
        actuator.set_default_gear_ratio(1.0)
        if said["friction"]:
            actuator.set_controller_gains(PdControllerGains(p=1e-9, d=said["friction"] / CREEP))
    if said["stiffness"]:
        spring = RevoluteSpring if said["type"] == "revolute" else PrismaticSpring
        plant.AddForceElement(spring(joint, said["rest"], said["stiffness"]))
    return instance


def connect(builder: Any, plant: Any, instance: Any) -> None:
    """Let the friction of `instance` act; `plant` is finalized, and `builder` is the DiagramBuilder that holds it."""
    from pydrake.systems.primitives import ConstantVectorSource

    if _said()["friction"]:
        zero: Any = [0.0, 0.0]  # position and speed
        still = builder.AddSystem(ConstantVectorSource(zero))
        builder.Connect(still.get_output_port(), plant.get_desired_state_input_port(instance))


def _said() -> dict[str, Any]:
    return dict(json.loads(Path(__file__).resolve().with_name("joint.json").read_text()))
