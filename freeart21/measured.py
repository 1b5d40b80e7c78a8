"""Measured runs of one joint: position against time, and their circumstances."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from freeart21.joint import JointType
from freeart21.mechanics import Actuator
from freeart21.se3 import Array

Timestamps = Literal["recorded", "nominal"]
EffortKind = Literal["commanded", "external"]
Interpolation = Literal["held", "linear", "unknown"]


@dataclass(frozen=True)
class BaseSeries:
    """Motion of the base in a run: NaN where nothing was logged, None for no such motion."""

    position: Array | None = None
    """(n, 3) m, displacement in the directions of the canonical frame at angle 0."""
    acceleration: Array | None = None
    """(n, 3) m/s^2 in these directions; in place of positions."""
    angle: Array | None = None
    """(n,) rad about `Measured.base_axis`."""


@dataclass(frozen=True)
class BaseAxis:
    """Rotation axis of a base, in its canonical frame."""

    axis: Array
    """(3,) unit vector."""
    point: Array
    """(3,) m: the point of `BaseSeries.position` and acceleration."""


@dataclass(frozen=True)
class Run:
    """One recording of the joint; (n,) arrays of one length, times rising."""

    name: str
    times_s: Array
    """(n,) seconds."""
    q: Array
    """(n,) position as read, rad or m; NaN where there is no reading, and all NaN when only poses were measured."""
    effort: Array | None = None
    """(n,) N*m or N, NaN where none was logged; interpolated as `Measured.interpolation`."""
    q_command: Array | None = None
    """(n,) commanded position, rad or m, NaN where none was logged; interpolated as `Measured.interpolation`."""
    poses: Array | None = None
    """(n, 4, 4) T_reference_moving: the moving part's pose in the reference part's (base) frame, identity at state zero
    of an ideal joint. Both frames are the asset's canonical frame there."""
    seen: NDArray[np.bool_] | None = None
    """(n,) whether both parts were visible when the poses were measured."""
    held_out: bool | None = None
    """Whether fits must not use it; None when not specified."""
    voltage: Array | None = None
    """(n,) V at the actuator's motor, NaN where none was logged; interpolated as `Measured.interpolation`."""
    enabled: Array | None = None
    """(n,) whether the actuator was on (above 0), by zero-order hold; NaN where none was logged."""
    base: BaseSeries | None = None
    """Motion of the base; None at rest."""
    qd: Array | None = None
    """(n,) velocity as read, rad/s or m/s, NaN where there is no reading. Fits use positions; velocities relate torque
    to speed in prescribed motion (`simgap.measure.prescribed`)."""
    prescribed: bool | None = None
    """Whether something other than the efforts prescribed the motion, such as a speed-controlled drive: efforts are
    then a response. None when not specified."""


@dataclass(frozen=True)
class Measured:
    """All runs of one joint of one object."""

    joint: str
    """Name in the asset's URDF."""
    joint_type: JointType
    gravity: Array
    """(3,) m/s^2 in the asset's canonical frame, its base at rest."""
    rate_hz: float
    timestamps: Timestamps
    """"recorded" times may jitter and are exact; "nominal" ones are even and may be off by the jitter."""
    effort_kind: EffortKind | None = None
    """Whether efforts pass the actuator or act on the moving part directly; None without efforts."""
    actuator: Actuator | None = None
    """The known properties of the actuator: position law, limits and motor, without functions of time. Unknown ones may
    be missing in the simulation."""
    inertia_relative: float = 0.0
    """Relative uncertainty of the asset's inertia; 0 is exact."""
    gravity_relative: float = 0.0
    """Relative uncertainty of the asset's gravity torque or force; 0 is exact."""
    runs: tuple[Run, ...] = field(default_factory=tuple)
    """In the order of recording, so that drift over the session shows."""
    interpolation: Interpolation = "held"
    """Efforts and commands between rows: zero-order hold ("held", such as a digital drive logged at its own rate),
    "linear", or "unknown" (anything between hold and a smooth curve)."""
    base_axis: BaseAxis | None = None
    """Rotation axis of the base, where runs have its angle."""
    notes: tuple[str, ...] = ()
    """What was left out, and why: a line each."""


def drop_duplicate_runs(runs: tuple[Run, ...]) -> tuple[tuple[Run, ...], tuple[str, ...]]:
    """The runs without exact copies of others, and a line for each that was dropped.

    Of a fitted run and its held-out copy the copy is dropped: it would confirm what it was fitted to.
    """
    first: dict[bytes, Run] = {}
    for run in sorted(runs, key=lambda run: bool(run.held_out)):
        first.setdefault(_readings(run), run)
    first_ids = {id(run) for run in first.values()}
    notes = [
        f"run '{run.name}' is run '{first[_readings(run)].name}' again, reading by reading: it was left out"
        for run in runs
        if id(run) not in first_ids
    ]
    return tuple(run for run in runs if id(run) in first_ids), tuple(notes)


def _readings(run: Run) -> bytes:
    """All measurements of a run, with times since its start."""
    since = np.round(run.times_s - run.times_s[0], 9)
    base = BaseSeries() if run.base is None else run.base
    series = (
        since,
        run.q,
        run.effort,
        run.q_command,
        run.poses,
        run.voltage,
        run.enabled,
        base.position,
        base.acceleration,
        base.angle,
    )
    return b"|".join(b"" if values is None else np.ascontiguousarray(values).tobytes() for values in series)
