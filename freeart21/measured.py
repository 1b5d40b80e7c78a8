"""What was measured of one joint: runs of its position against time, and what is known of the circumstances."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from freeart21.joint import JointType
from freeart21.mechanics import Actuator
from freeart21.se3 import Array

Timestamps = Literal["recorded", "nominal"]
EffortKind = Literal["commanded", "external"]
Interpolation = Literal["held", "linear", "unknown"]
TIMESTAMPS: tuple[str, ...] = get_args(Timestamps)
EFFORT_KINDS: tuple[str, ...] = get_args(EffortKind)
INTERPOLATIONS: tuple[str, ...] = get_args(Interpolation)


@dataclass(frozen=True)
class BaseSeries:
    """How the base moved in a run: NaN where nothing was logged, None for what it did not do."""

    position: Array | None = None
    """(n, 3) m by which it was moved, in the directions that the canonical frame has at angle 0."""
    acceleration: Array | None = None
    """(n, 3) m/s^2 in these directions; in place of positions."""
    angle: Array | None = None
    """(n,) rad by which it was turned about `Measured.base_axis`."""


@dataclass(frozen=True)
class BaseAxis:
    """What a base turns about, in its canonical frame."""

    axis: Array
    """(3,) unit vector."""
    point: Array
    """(3,) m: what `BaseSeries.position` and its acceleration are of."""


@dataclass(frozen=True)
class Run:
    """One recording of the joint; (n,) arrays of one length, times rising."""

    name: str
    times_s: Array
    """(n,) seconds."""
    q: Array
    """(n,) position as read, rad or m; NaN where there is no reading, and all NaN when only poses were measured."""
    effort: Array | None = None
    """(n,) N*m or N, NaN where none was logged; between those as `Measured.interpolation` says."""
    q_command: Array | None = None
    """(n,) commanded position, rad or m, NaN where none was logged; between those as `Measured.interpolation` says."""
    poses: Array | None = None
    """(n, 4, 4) T_reference_moving: the moving part's pose in the reference part's (base) frame, which is the identity
    at state zero of an ideal joint: both parts are at home in the asset's canonical frame."""
    seen: NDArray[np.bool_] | None = None
    """(n,) whether the parts were seen when the poses were measured."""
    held_out: bool | None = None
    """Whether a fit must never see it; None when nobody said."""
    voltage: Array | None = None
    """(n,) V at the actuator's motor, NaN where none was logged; between those as `Measured.interpolation` says."""
    enabled: Array | None = None
    """(n,) whether the actuator was on, above 0, until the next value; NaN where none was logged."""
    base: BaseSeries | None = None
    """How the base moved; None at rest."""
    qd: Array | None = None
    """(n,) velocity as read, rad/s or m/s, NaN where there is no reading. Fits look at positions; it tells what torque
    goes with what speed (`simgap.measure.prescribed`)."""
    prescribed: bool | None = None
    """Whether something else than the efforts told the joint how to move, as a drive that holds its speed: efforts then
    answer the motion. None when nobody said."""


@dataclass(frozen=True)
class Measured:
    """All runs of one joint of one object, its base at rest or moved as the runs tell."""

    joint: str
    """Name in the asset's URDF."""
    joint_type: JointType
    gravity: Array
    """(3,) m/s^2 in the asset's canonical frame, its base at rest (`T_canonical_reference` takes the base link's)."""
    rate_hz: float
    timestamps: Timestamps
    """"recorded" times may jitter and are to be believed; "nominal" ones are even and may be off by the jitter."""
    effort_kind: EffortKind | None = None
    """Whether efforts pass the actuator or push the moving part itself; None without efforts."""
    actuator: Actuator | None = None
    """What the actuator is known to be: its position law, limits and motor; its functions of time are empty. What it
    is not known for may be missing from the simulation."""
    inertia_relative: float = 0.0
    """How far the asset's inertia may be off, as a part of it; 0 is exact."""
    gravity_relative: float = 0.0
    """How far the asset's gravity torque (or force) may be off, as a part of it; 0 is exact."""
    runs: tuple[Run, ...] = field(default_factory=tuple)
    """In the order of recording: what changes over the session shows in it."""
    interpolation: Interpolation = "held"
    """Efforts and commands between their rows: each value lasts until the next one ("held", as by a digital drive that
    is logged at its own rate), they go on straight ("linear"), or nobody knows: they may be held, go on
    smoothly, or anything between the two ("unknown")."""
    base_axis: BaseAxis | None = None
    """What the base turns about where runs have an angle of it."""
    notes: tuple[str, ...] = ()
    """What was left out of it, and why: a line each."""


def drop_duplicate_runs(runs: tuple[Run, ...]) -> tuple[tuple[Run, ...], tuple[str, ...]]:
    """The runs without those that are another one again, reading by reading, and a line for each that was left out.

    Of a run that is fitted and its copy that is held out the copy goes: it would confirm what it was fitted to.
    """
    first: dict[bytes, Run] = {}
    for run in sorted(runs, key=lambda run: bool(run.held_out)):
        first.setdefault(_readings(run), run)
    kept = {id(run) for run in first.values()}
    notes = [
        f"run '{run.name}' is run '{first[_readings(run)].name}' again, reading by reading: it was left out"
        for run in runs
        if id(run) not in kept
    ]
    return tuple(run for run in runs if id(run) in kept), tuple(notes)


def _readings(run: Run) -> bytes:
    """All that was measured in a run, whenever its clock began."""
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
