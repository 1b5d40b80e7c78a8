"""Damping and friction of a joint for which nothing was measured.

Viscous damping inertia / SETTLE_S gives the joint a time constant of `SETTLE_S`. Coulomb friction is `FRICTION_SHARE`
of the largest force or torque of the moving part's weight. Both are guesses, to be replaced by what `gap` identifies.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from freeart21.effects import Effect, effects_from_urdf_dynamics
from freeart21.files.urdf import UrdfInertial
from freeart21.joint import Joint

Dynamics = Literal["guessed", "none"]
DYNAMICS: tuple[str, ...] = get_args(Dynamics)
SETTLE_S = 1.0
"""s in which speed falls to 37 %. A guess: lids and drawers come to rest within a second or two."""
FRICTION_SHARE = 0.01
"""Friction over the largest torque or force of the weight. A guess."""
GRAVITY = 9.81


def guess_effects(joint: Joint, child: UrdfInertial) -> tuple[Effect, ...]:
    """Viscous damping and Coulomb friction of a joint.

    Args:
        joint: in the frame of the child link, at joint position zero.
        child: mass properties of the child link.
    """
    if joint.type == "prismatic":
        inertia, weight = child.mass, child.mass * GRAVITY
    else:
        axis = joint.axis / np.linalg.norm(joint.axis)
        arm = child.centre - joint.pivot
        arm = arm - axis * (axis @ arm)
        inertia = float(axis @ child.inertia @ axis) + child.mass * float(arm @ arm)
        weight = child.mass * GRAVITY * float(np.linalg.norm(arm))
    return effects_from_urdf_dynamics(inertia / SETTLE_S, FRICTION_SHARE * weight)
