"""What a user states of recordings: the options of `measure` for files, and the argument of `measure_series`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class SeriesSettings:
    """None is not stated."""

    asset: Path | None = None
    """Asset folder or URDF of the recorded object."""
    joint: str | None = None
    """Joint of the URDF; only needed when several can move."""
    columns: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ROLE=NAME...")] = ()
    """Columns of t, q, qd, effort, q_command, voltage, enabled, base_x, base_y, base_z, base_ax, base_ay, base_az,
    base_angle, such as t=time q=angle. Without a header they are called 1, 2, ... Names joined by + are consecutive
    runs."""
    unit_t: Annotated[Literal["s", "ms", "us", "ns"] | None, tyro.conf.arg(metavar="UNIT")] = None
    """Unit of times: s, ms, us or ns; by the header or their step when not given."""
    unit_q: Annotated[str | None, tyro.conf.arg(metavar="UNIT")] = None
    """Unit of positions and commands: rad, deg, turns, counts=N (N per turn), m, cm, mm; by the header, or where only
    one fits the joint's limits or dynamics, when not given."""
    unit_effort: Annotated[Literal["N*m", "N*cm", "mN*m", "N", "mN"] | None, tyro.conf.arg(metavar="UNIT")] = None
    """Unit of efforts: N*m, N*cm or mN*m, N or mN; N*m or N when not given."""
    zero: float = 0.0
    """Recorded position, in its unit, where the URDF's joint is at 0."""
    reverse: bool = False
    """The recording's positive direction is opposite to the URDF's joint axis."""
    rate_hz: float | None = None
    """Rows per second of files without times; frames of a result [30]."""
    gravity: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")] = None
    """Gravity, m/s^2. For files: in the asset's reference link, 0 0 -9.81 when not given. For a result: in the camera's
    axes (right, down, forward) of the first frame, 0 9.81 0 for a level camera."""
    effort: Literal["commanded", "external"] | None = None
    """Efforts are commanded to the actuator, or push the part."""
    actuator: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="STIFFNESS DAMPING")] = None
    """Gains of force = STIFFNESS (q_command - q) - DAMPING qd, in N*m/rad and N*m*s/rad (N/m, N*s/m)."""
    interpolation: Literal["held", "linear", "unknown"] | None = None
    """Efforts and commands between their rows; unknown when not given."""
    circumstances: Path | None = None
    """JSON file of actuator, base, prescribed runs, units, wrapped."""
    inertia_relative: Annotated[float, tyro.conf.arg(metavar="PART")] = 0.1
    """Relative uncertainty of the asset's inertia. Larger ones hide real effects, smaller ones cause false ones."""
    gravity_relative: Annotated[float, tyro.conf.arg(metavar="PART")] = 0.05
    """Relative uncertainty of its gravity torque or force."""
    held_out: tuple[str, ...] = ()
    """Runs that no fit uses: names, numbers from 1, or files."""
