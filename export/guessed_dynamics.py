"""What slows a joint of which nothing is known: a guess, marked as one, so that no door swings for ever.

A joint loses its speed with a time constant of `SETTLE_S`, by viscous damping inertia / SETTLE_S, and dry friction
holds it against a hundredth part, `HOLD`, of what the moving part's weight does at most. Both are guesses: what `gap`
finds of the real joint takes their place.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from export.inertia import Inertial
from freeart21.effects import Effect, effects_from_urdf_dynamics
from freeart21.joint import Joint

Dynamics = Literal["guessed", "none"]
DYNAMICS: tuple[str, ...] = get_args(Dynamics)
SETTLE_S = 1.0
"""Seconds in which speed falls to 37 %. A guess: lids and drawers of a room come to rest in about a second or two."""
HOLD = 0.01
"""Friction as a part of the weight's greatest torque, or force. A guess."""
GRAVITY = 9.81


def guessed_effects(joint: Joint, child: Inertial) -> tuple[Effect, ...]:
    """Viscous damping and Coulomb friction of a joint, by inertia and weight of the part that hangs on it.

    Args:
        joint: in the frame of `child`, its link at joint position zero.
        child: mass properties of that part.
    """
    if joint.type == "prismatic":
        inertia, weight = child.mass, child.mass * GRAVITY
    else:
        axis = joint.axis / np.linalg.norm(joint.axis)
        arm = child.centre - joint.pivot
        arm = arm - axis * (axis @ arm)
        inertia = float(axis @ child.inertia @ axis) + child.mass * float(arm @ arm)
        weight = child.mass * GRAVITY * float(np.linalg.norm(arm))
    return effects_from_urdf_dynamics(inertia / SETTLE_S, HOLD * weight)
