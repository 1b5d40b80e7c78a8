"""Loads this asset into Drake and restores what Drake drops. Tested with Drake 1.51.1.

Drake warns about a URDF's friction and drops it. Here friction is an actuator: a damper towards speed 0, limited to the
friction's size, which a discrete plant solves together with the contacts. The actuator also carries the armature; a
spring is a force element.

    instance = load(plant)                # before plant.Finalize()
    connect(builder, plant, instance)     # afterwards; without it there is no friction
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

    `fixed` None takes the asset's own base. A base that was exported fixed is at the world's origin.
    """
    from pydrake.math import RigidTransform
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.tree import PdControllerGains, PrismaticSpring, RevoluteSpring

    info = _read_info()
    if info["base"] == "fixed" and (fixed is False or X_WB is not None):
        raise ValueError(f"{info['urdf']} was exported with a fixed base: it cannot move freely, nor stand elsewhere")
    if info["friction"] and plant.time_step() == 0:
        raise ValueError("the plant is continuous: Drake solves this joint's friction in discrete plants only")
    if info["trust"].startswith("doubtful"):
        warnings.warn(f"{info['urdf']} was made of a reconstruction that is {info['trust']}", stacklevel=2)
    if ignored := [name for name, word in info["effects"].items() if word not in PLAYED]:
        warnings.warn(f"Drake plays {info['urdf']} without {', '.join(ignored)}", stacklevel=2)

    parser = Parser(plant)
    parser.SetAutoRenaming(True)  # a plant may hold the asset more than once
    (instance,) = parser.AddModels(Path(__file__).resolve().parent.parent / info["urdf"])
    base = plant.GetBodyByName(info["base_link"], instance)
    if fixed and info["base"] == "free":
        plant.WeldFrames(plant.world_frame(), base.body_frame(), X_WB or RigidTransform())
    elif X_WB is not None:
        plant.SetDefaultFloatingBaseBodyPose(base, X_WB)
    joint = plant.GetJointByName(info["joint"], instance)
    if info["friction"] or info["armature"]:
        actuator = plant.AddJointActuator(f"{info['joint']}_friction", joint, info["friction"] or float("inf"))
        actuator.set_default_rotor_inertia(info["armature"])
        actuator.set_default_gear_ratio(1.0)
        if info["friction"]:
            actuator.set_controller_gains(PdControllerGains(p=1e-9, d=info["friction"] / CREEP))
    if info["stiffness"]:
        spring = RevoluteSpring if info["type"] == "revolute" else PrismaticSpring
        plant.AddForceElement(spring(joint, info["rest"], info["stiffness"]))
    return instance


def connect(builder: Any, plant: Any, instance: Any) -> None:
    """Make the friction of `instance` act. `plant` is finalized; `builder` is the DiagramBuilder that holds it."""
    from pydrake.systems.primitives import ConstantVectorSource

    if _read_info()["friction"]:
        zero: Any = [0.0, 0.0]  # position and speed
        still = builder.AddSystem(ConstantVectorSource(zero))
        builder.Connect(still.get_output_port(), plant.get_desired_state_input_port(instance))


def _read_info() -> dict[str, Any]:
    return dict(json.loads(Path(__file__).resolve().with_name("joint.json").read_text()))
