"""An instance of every effect of the library, of a size that shows: for forces four times what fits begin with."""

from __future__ import annotations

import dataclasses

import pytest

from freeart21.effects import EFFECTS, Effect
from freeart21.effects.base import OperatingPoint
from freeart21.joint import JointType

KINDS: tuple[JointType, ...] = ("revolute", "prismatic")


def typical(name: str, kind: JointType) -> Effect:
    """The effect on a joint that moves by a radian or metre either way; optional parameters have their defaults."""
    cls = EFFECTS[name]
    at = OperatingPoint(
        kind, q_low=-1.0, q_high=1.0, speed=2.0, noise=1e-3, force=4.0, load=10.0, inertia=0.4, gravity=(0.0, -8.0, 0.0)
    )
    values = dict(zip(cls.range_fields, (at.q_low, at.q_high), strict=False))
    for k, field in enumerate(dataclasses.fields(cls)):
        spec = cls.parameters(kind).get(field.name)
        if spec is None or field.name in values:
            continue
        if field.default is dataclasses.MISSING or None in (spec.revolute_unit, spec.prismatic_unit):
            found = cls.fit_range(field.name, at)
            grown = 4.0 if cls.acts in ("force", "drive") and spec.revolute_unit not in ("rad", "rad/s") else 1.0
            size = 0.2 if cls.neutral else min(grown * found.size, 0.5 * found.upper)
            values[field.name] = cls.neutral + size * (1.0, 0.5, 0.8)[k % 3]
    return cls(**values)


ALL = {kind: tuple(typical(n, kind) for n, cls in EFFECTS.items() if kind in cls.joint_types) for kind in KINDS}
"""By joint type, every effect that it can have."""
EVERY = [pytest.param(effect, kind, id=f"{effect.name}-{kind}") for kind, effects in ALL.items() for effect in effects]
