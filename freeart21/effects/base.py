"""What an effect is: a named physical behaviour of a joint that the neutral simulation lacks.

An effect is a frozen dataclass whose fields, made by `parameter`, carry units and bounds. It says how it acts, and what
of it URDF and MJCF can express; `effects.json` holds all of it. To add one: one file here with one class, one test.
"""

from __future__ import annotations

import dataclasses
from abc import ABC
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.joint import JointType


@dataclass(frozen=True)
class Parameter:
    """Unit, bounds and meaning of one number of an effect."""

    revolute_unit: str
    prismatic_unit: str
    lower: float
    upper: float
    meaning: str

    def unit(self, joint_type: JointType) -> str:
        """The SI unit for a joint of this type."""
        return self.revolute_unit if joint_type == "revolute" else self.prismatic_unit


def parameter(revolute_unit: str, prismatic_unit: str, lower: float, upper: float, meaning: str) -> Any:
    """A dataclass field that is a parameter of an effect: SI units for both joint types, closed bounds, meaning."""
    return dataclasses.field(metadata={"parameter": Parameter(revolute_unit, prismatic_unit, lower, upper, meaning)})


class Effect(ABC):
    """Base of all effects. Subclasses are frozen dataclasses with fields made by `parameter`.

    `acts` says through what the simulator lets it act:
      "force"  a generalised force `force(q, qd, t)` added to the joint at every step;
      "drive"  a saturated damper of strength `drive_limit(q, qd)`, which the joint's one drive owns (Coulomb friction).
    """

    name: ClassVar[str]
    acts: ClassVar[Literal["force", "drive"]]

    def __post_init__(self) -> None:
        for field, spec in self.parameters().items():
            value = getattr(self, field)
            if not isinstance(value, int | float) or not np.isfinite(value) or not spec.lower <= value <= spec.upper:
                raise FreeArtError(
                    f"effect '{self.name}' {field} is {value}, expected {spec.lower:g} to {spec.upper:g}"
                )
            object.__setattr__(self, field, float(value))

    @classmethod
    def parameters(cls) -> dict[str, Parameter]:
        """Parameter name to its specification, in order."""
        return {f.name: f.metadata["parameter"] for f in dataclasses.fields(cls)}  # type: ignore[arg-type]

    def force(self, q: float, qd: float, t: float) -> float:
        """Generalised force, N*m or N, at position `q` (rad or m), velocity `qd` and time `t` (s)."""
        return 0.0

    def drive_limit(self, q: float, qd: float) -> float:
        """Largest force, N*m or N, with which the drive opposes motion."""
        return 0.0

    def urdf_dynamics(self) -> dict[str, float]:
        """Attributes of URDF `<dynamics>` that say this effect; empty when URDF can't."""
        return {}

    def mjcf_joint(self) -> dict[str, float]:
        """Attributes of an MJCF `<joint>` that say this effect; empty when MJCF can't."""
        return {}

    def to_json(self, joint_type: JointType) -> dict[str, Any]:
        """The effect as it stands in effects.json."""
        return {
            "effect": self.name,
            "parameters": {
                name: {"value": getattr(self, name), "unit": spec.unit(joint_type)}
                for name, spec in self.parameters().items()
            },
        }

    @classmethod
    def from_json(cls, data: dict[str, Any], joint_type: JointType, where: str) -> Effect:
        """The effect of one effects.json entry; FreeArtError on a missing or unknown parameter or unit."""
        given, specs = data.get("parameters"), cls.parameters()
        if not isinstance(given, dict) or set(given) != set(specs):
            got = sorted(given) if isinstance(given, dict) else given
            raise FreeArtError(f"{where}: effect '{cls.name}' has parameters {got}, expected {sorted(specs)}")
        for name, spec in specs.items():
            entry = given[name]
            unit = entry.get("unit") if isinstance(entry, dict) else None
            if unit != spec.unit(joint_type):
                raise FreeArtError(
                    f"{where}: effect '{cls.name}' {name} has unit '{unit}', expected '{spec.unit(joint_type)}'"
                )
        return cls(**{name: given[name].get("value") for name in specs})
