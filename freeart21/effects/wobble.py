"""Wobble: the moving part oscillates in its worn joint, over time instead of over position."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from freeart21.effects.base import Acts, Effect, Kind, parameter, perpendiculars
from freeart21.mechanics import JointMechanics
from freeart21.se3 import Array


@dataclass(frozen=True)
class Wobble(Effect):
    """Rotation by amplitude * sin(2 pi frequency t + phase) about cos(direction) * first + sin(direction) * second, in
    the basis `perpendiculars(axis)`, through the pivot: a second mode as a steady oscillation."""

    name: ClassVar[str] = "wobble"
    kind: ClassVar[Kind] = "kinematics"
    acts: ClassVar[Acts] = "pose"
    label: ClassVar[str] = "rocking in a worn bearing"
    time_driven: ClassVar[bool] = True
    experiment: ClassVar[str] = (
        "Move the joint at another speed: rocking keeps its own frequency, the rest goes with the joint's position."
    )

    amplitude: float = parameter("rad", "rad", 0.0, 0.8, "largest turn", scale=0.01)
    frequency: float = parameter("Hz", "Hz", 0.0, 1000.0, "oscillations a second", scale=1.0)
    phase: float = parameter("rad", "rad", -7.0, 7.0, "phase at t = 0", scale=1.0)
    direction: float = parameter("rad", "rad", -7.0, 7.0, "where across the axis it turns about", scale=1.0)

    @classmethod
    def from_rocking(cls, frequency: float, waves: Array) -> Wobble:
        """Amplitude over all runs, phase of the first run."""
        u = np.linalg.svd(np.concatenate(list(waves), -1))[0][:, 0]
        u = u * (1.0 if u[int(np.argmax(np.abs(u)))] > 0 else -1.0)
        along = u @ waves  # (runs, 2)
        amplitude = min(float(np.sqrt((along**2).sum(-1).mean())), cls.parameters()["amplitude"].upper)
        phase = float(np.arctan2(along[0, 1], along[0, 0]))
        return cls(amplitude, frequency, phase, float(np.arctan2(u[1], u[0])))

    def displacement(self, q: ArrayLike, t: ArrayLike, mechanics: JointMechanics) -> Array:
        joint, (first, second) = mechanics.joint, perpendiculars(mechanics.joint.axis)
        t = np.asarray(t, float) + 0.0 * np.asarray(q, float)
        angle = self.amplitude * np.sin(2 * np.pi * self.frequency * t + self.phase)
        axis = np.cos(self.direction) * first + np.sin(self.direction) * second
        return replace(joint, type="revolute", axis=axis).transform(angle)
