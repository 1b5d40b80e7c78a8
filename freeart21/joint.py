"""The joint between two rigid parts: a revolute or prismatic screw with limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.se3 import Array

JointType = Literal["revolute", "prismatic"]
JOINT_TYPES: tuple[JointType, ...] = get_args(JointType)


@dataclass(frozen=True)
class Joint:
    """A one-degree-of-freedom joint, in the frame of the reference part (the canonical frame).

    The moving part's points at state q are `transform(q)` applied to its points at state zero. Positive state:
    right-hand rule about, or motion along, the axis, of the moving part against the reference part.
    """

    name: str
    type: JointType
    axis: Array
    """(3,) unit vector."""
    pivot: Array
    """(3,) a point on the axis, metres. Arbitrary for a prismatic joint, where it is not scored."""
    lower: float
    """Lower limit, rad or m; -inf when there is none."""
    upper: float
    """Upper limit, rad or m; inf when there is none."""

    def __post_init__(self) -> None:
        if self.type not in JOINT_TYPES:
            raise FreeArtError(f"joint '{self.name}' has type '{self.type}', expected one of {', '.join(JOINT_TYPES)}")
        for field in ("axis", "pivot"):
            value = np.array(getattr(self, field), float)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise FreeArtError(f"joint '{self.name}' {field} is {value.tolist()}, expected three finite numbers")
            if field == "axis":
                length = float(np.linalg.norm(value))
                if abs(length - 1) > 1e-3:
                    raise FreeArtError(f"joint '{self.name}' axis has length {length:.4g}, expected 1")
                value = value / length
            value.flags.writeable = False
            object.__setattr__(self, field, value)
        if np.isnan(self.lower) or np.isnan(self.upper) or self.lower > self.upper:
            raise FreeArtError(f"joint '{self.name}' limits are [{self.lower}, {self.upper}], expected lower <= upper")

    def spanning(self, states: Array) -> Joint:
        """This joint with the range of `states` (n,), rad or m, as its limits."""
        return replace(self, lower=float(np.min(states)), upper=float(np.max(states)))

    @property
    def state_unit(self) -> str:
        """'rad' or 'm'."""
        return "rad" if self.type == "revolute" else "m"

    @property
    def screw(self) -> Array:
        """(6,) the unit twist (v, w): transform(q) = exp(q * screw)."""
        if self.type == "prismatic":
            return np.concatenate([self.axis, np.zeros(3)])
        return np.concatenate([np.cross(self.pivot, self.axis), self.axis])

    def transform(self, q: ArrayLike) -> Array:
        """The displacement (..., 4, 4) of the moving part at state(s) `q` (...), rad or m (FreeArtGS, sec. 3.4)."""
        q = np.asarray(q, float)
        if self.type == "prismatic":
            return se3.pose(np.broadcast_to(np.eye(3), (*q.shape, 3, 3)), q[..., None] * self.axis)
        R = se3.exp_so3(q[..., None] * self.axis)
        return se3.pose(R, self.pivot - R @ self.pivot)

    def moved(self, T_new_old: ArrayLike) -> Joint:
        """The same joint written in another frame: axis and pivot mapped by `T_new_old` (4, 4)."""
        T = np.asarray(T_new_old, float)
        return replace(self, axis=T[:3, :3] @ self.axis, pivot=se3.transform(T, self.pivot))

    def reversed(self) -> Joint:
        """The same motion with the opposite axis and negated states."""
        return replace(self, axis=-self.axis, lower=-self.upper, upper=-self.lower)
