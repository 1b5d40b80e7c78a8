"""A URDF of one joint from a few numbers, for recordings of a joint without a model.

    pendulum   about the y axis of its base, hanging down at 0
    door       about z, upright; its centre of mass along x at 0. Without a length it is a rotor
    drawer     along x, level

The moving part is a small ball at its centre of mass; inertia beyond that of the mass there is the ball's own, the same
about every axis.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from export.settings import JointNumbers
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.places import JOINT_ASSET, check_place
from freeart21.files.urdf import Urdf, UrdfInertial, UrdfJoint, UrdfLink, UrdfShape, format_urdf
from freeart21.se3 import pose

G = 9.81
"""m/s^2, for inertia from a period; also the default of `freeart21 measure`."""
BALL = 4e-5
"""Inertia about the ball's own centre over mass times length squared: a ball of a hundredth of the length (2/5 r^2).
Engines take no point masses; it lengthens a period by 2e-5."""
_SMALL = 1e-3
"""m: radius of the ball of a drawer. Not measured: engines need some inertia, and sliding does not depend on it."""


def write_joint_asset(out: Path, numbers: JointNumbers) -> None:
    """Write a URDF of that joint; FreeArtError when the numbers contradict each other."""
    if Path(out).suffix != ".urdf":
        raise FreeArtError(f"{out}: expected the name of a URDF file to write, such as {numbers.kind}.urdf")
    text = format_joint_urdf(numbers)
    check_place(out, JOINT_ASSET)
    atomic.write_bytes(out, text)


def format_joint_urdf(numbers: JointNumbers) -> bytes:
    """The URDF file."""
    length, own = _mass_properties(numbers)
    centre = np.array(
        {"pendulum": (0.0, 0.0, -length), "door": (length, 0.0, 0.0), "drawer": np.zeros(3)}[numbers.kind]
    )
    axis = {"pendulum": (0.0, 1.0, 0.0), "door": (0.0, 0.0, 1.0), "drawer": (1.0, 0.0, 0.0)}[numbers.kind]
    size = np.maximum(np.abs(centre), max(0.1 * length, 0.02))
    visual = UrdfShape("box", pose(np.eye(3), centre / 2), size)
    part = UrdfLink("part", (visual,), (), UrdfInertial(float(numbers.mass), centre, own * np.eye(3)))
    free, turns = numbers.lower is None and numbers.upper is None, numbers.kind != "drawer"
    kind = "continuous" if free and turns else "revolute" if turns else "prismatic"
    lower, upper = (np.inf if end is None else end for end in (numbers.lower, numbers.upper))
    strength = None if free else 0.0
    joint = UrdfJoint(
        numbers.joint,
        kind,
        "base",
        "part",
        np.eye(4),
        np.array(axis),
        lower,
        upper,
        limited=not free,
        effort=strength,
        velocity=strength,
        damping=0.0,
        friction=0.0,
    )
    links = {"base": UrdfLink("base", (), (), None), "part": part}
    return format_urdf(Urdf(Path(), numbers.kind, links, {joint.name: joint}), f" {JOINT_ASSET.mark.decode()} ")


def _mass_properties(numbers: JointNumbers) -> tuple[float, float]:
    """Distance of the centre of mass from the axis, m, and the part's inertia about its own centre, kg m^2."""
    _check(numbers)
    mass, length, inertia = numbers.mass, numbers.length, numbers.inertia
    if numbers.kind == "drawer":
        return 0.0, 0.4 * mass * _SMALL**2
    if numbers.period is not None:
        swung = G * (numbers.period / (2 * math.pi)) ** 2  # length of the simple pendulum of that period, I / (m l)
        if length is None:
            length = swung / (1 + BALL)
        else:
            inertia = mass * length * swung
    if length is None:
        raise FreeArtError(
            f"a {numbers.kind} needs --length, metres from its axis to the centre of mass"
            + (", or --period" if numbers.kind == "pendulum" else "; 0 for a rotor")
        )
    point = mass * length**2
    if inertia is None and length == 0:
        raise FreeArtError("a part whose centre of mass is on its axis (--length 0) needs --inertia, kg*m^2")
    least = BALL * point
    own = least if inertia is None else inertia - point
    if inertia is not None and own < -1e-6 * point:
        raise FreeArtError(
            f"an inertia of {inertia:.4g} kg*m^2 about the axis is too small: {mass:g} kg at {length:g} m "
            f"have {point:.4g} alone"
        )
    return length, max(own, least)


def _check(numbers: JointNumbers) -> None:
    """Raise FreeArtError when a number is invalid, or belongs to another kind of joint."""
    for name in ("mass", "length", "inertia", "period", "lower", "upper"):
        value = getattr(numbers, name)
        if value is not None and not math.isfinite(value):
            raise FreeArtError(f"--{name} {value}: expected a finite number")
        if value is not None and name in ("mass", "inertia", "period") and value <= 0:
            raise FreeArtError(f"--{name} {value:g}: expected a number above 0")
    if numbers.length is not None and numbers.length < 0:
        raise FreeArtError(f"--length {numbers.length:g}: expected 0 or more")
    if numbers.kind == "pendulum" and numbers.length == 0:
        raise FreeArtError("--length 0: a pendulum's centre of mass is off its axis; a rotor is of --kind door")
    alien = [n for n in ("length", "inertia", "period") if getattr(numbers, n) is not None]
    if numbers.kind == "drawer" and alien:
        raise FreeArtError(f"--{alien[0]}: a drawer has a mass alone")
    if numbers.kind == "door" and numbers.period is not None:
        raise FreeArtError("--period: gravity does not swing an upright door; expected --inertia")
    if None not in (numbers.period, numbers.inertia):
        raise FreeArtError("--period and --inertia: a period tells an inertia; expected one of them")
    if (numbers.lower is None) != (numbers.upper is None):
        raise FreeArtError("--lower and --upper: expected both limits, or none")
    if numbers.lower is not None and numbers.upper is not None and not numbers.lower < numbers.upper:
        raise FreeArtError(f"--lower {numbers.lower:g} --upper {numbers.upper:g}: expected the lower one to be less")
