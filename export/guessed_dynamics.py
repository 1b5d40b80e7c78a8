"""Damping and friction of a joint for which nothing was measured.

Viscous damping inertia / SETTLE_S gives the joint a time constant of `SETTLE_S`. Coulomb friction is `FRICTION_SHARE`
of the largest force or torque of the moving part's weight, and at least `HOLD` times the load that would open the
joint of the standing object: what nobody touches stays as it was put. Both are guesses, to be replaced by what `gap`
identifies.
"""

from __future__ import annotations

import numpy as np

from freeart21.effects import Effect, effects_from_urdf_dynamics
from freeart21.files.urdf import UrdfInertial
from freeart21.joint import Joint

SETTLE_S = 1.0
"""s in which speed falls to 37 %. A guess: lids and drawers come to rest within a second or two."""
FRICTION_SHARE = 0.01
"""Friction over the largest torque or force of the weight. A guess."""
HOLD = 1.5
"""Friction over the load of the standing object's joint at zero, where that load points into its range. Set by hand: 1
would just hold it, and centre of mass and axis are not exact."""
GRAVITY = 9.81
DOWN = np.array([0.0, 0.0, -GRAVITY])


def guess_effects(joint: Joint, child: UrdfInertial) -> tuple[Effect, ...]:
    """Viscous damping and Coulomb friction of a joint.

    Args:
        joint: in the frame of the child link, at joint position zero, z up, with the limits.
        child: mass properties of the child link.
    """
    axis = joint.axis / np.linalg.norm(joint.axis)
    if joint.type == "prismatic":
        inertia, way, weight = child.mass, axis, child.mass * GRAVITY
    else:
        arm = child.centre - joint.pivot
        arm = arm - axis * (axis @ arm)
        inertia = float(axis @ child.inertia @ axis) + child.mass * float(arm @ arm)
        way, weight = np.cross(axis, arm), child.mass * GRAVITY * float(np.linalg.norm(arm))
    load = child.mass * float(DOWN @ way)
    opens = load * (joint.upper if load > 0 else joint.lower) > 0
    return effects_from_urdf_dynamics(inertia / SETTLE_S, max(FRICTION_SHARE * weight, HOLD * abs(load) * opens))
