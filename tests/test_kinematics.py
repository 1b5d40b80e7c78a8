"""Geometry effects found in synthetic part poses by independent formulas, under correlated tracker noise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.measured import Measured, Run
from simgap.geometry.finding import KinematicsFinding
from simgap.geometry.kinematics import find_geometry

PIVOT = np.array([0.1, -0.2, 0.3])
ARM = np.array([0.25, 0.0, -0.1])  # from the pivot to the middle of the part at q = 0
OFFSET = np.array([0.012, 0, -0.009])  # of the pivot, where it is
TYPES = pytest.mark.parametrize("kind", ["revolute", "prismatic"])
X, Y, Z = np.eye(3)
Shape = Callable[[np.ndarray, np.ndarray], np.ndarray]


def turn(axis, angle):
    """(n, 3, 3) rotations by Rodrigues' formula."""
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    a = np.asarray(angle, float)[..., None, None]
    return np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K


def about(point, R):
    """(n, 4, 4) rotation by R about a point."""
    T = np.tile(np.eye(4), (len(R), 1, 1))
    T[:, :3, :3] = R
    T[:, :3, 3] = np.asarray(point, float) - np.einsum("nij,...j->ni", R, np.asarray(point, float))
    return T


def slid(ways):
    T = np.tile(np.eye(4), (len(ways), 1, 1))
    T[:, :3, 3] = ways
    return T


def asset(folder: Path, kind: str, axis: str = "0 1 0", mass: float = 1.5) -> Asset:
    """A part of `mass` kg, its middle at ARM from a hinge along y (or on a slider along y)."""
    path = folder / "part.urdf"
    path.write_text(f"""<robot name="part"><link name="base"/><link name="part"><inertial>
        <origin xyz="{ARM[0]} {ARM[1]} {ARM[2]}"/><mass value="{mass}"/>
        <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j" type="{kind}"><parent link="base"/><child link="part"/>
        <origin xyz="{PIVOT[0]} {PIVOT[1]} {PIVOT[2]}" rpy="0 0 0"/><axis xyz="{axis}"/>
        <limit lower="-6" upper="6"/></joint></robot>""")
    return read_asset(path)


def ideal(kind: str, axis=Y):
    """The asset's own joint."""
    if kind == "revolute":
        return lambda q, t: about(PIVOT, turn(axis, q))
    return lambda q, t: slid(np.outer(q, axis))


def measured(
    kind: str,
    motion: Shape,
    seed: int = 0,
    runs: int = 5,
    span: float = 0.9,
    gravity=(0, 0, -9.81),
    noise: float = 1.0,
    rho: float = 0.8,
    seconds: float = 5.0,
    held_out: int = 1,
) -> tuple[Measured, list[np.ndarray]]:
    """Tracked swings of the part at 30 poses/s with correlated errors, and the true joint positions."""
    rng = np.random.default_rng(seed)
    made, true = [], []
    for r in range(runs):
        t = np.arange(round(30 * seconds)) / 30 + rng.normal(size=round(30 * seconds)) * 2e-4
        way = span * (1.0 if kind == "revolute" else 0.25)
        q = way * np.exp(-0.15 * t) * np.cos(rng.uniform(3, 5) * t + rng.uniform(0, 6)) + 0.1 * way
        size = noise * np.array([1, 1, 1, 1.5, 1.5, 1.5]) * 1e-3
        error = np.zeros((len(t), 6))
        error[0] = rng.normal(size=6) * size
        for i in range(1, len(t)):
            error[i] = rho * error[i - 1] + np.sqrt(1 - rho**2) * rng.normal(size=6) * size
        middle = PIVOT + ARM
        R = np.stack([turn(w, np.linalg.norm(w)) for w in error[:, 3:]])
        shaken = slid(error[:, :3]) @ about(middle, R)
        seen = rng.random(len(t)) > 0.05
        made.append(
            Run(f"r{r}", t, np.full(len(t), np.nan), None, None, motion(q, t) @ shaken, seen, r >= runs - held_out)
        )
        true.append(q[seen])
    return Measured("j", kind, np.asarray(gravity, float), 30.0, "recorded", runs=tuple(made)), true  # type: ignore[arg-type]


def found_in(folder: Path, kind: str, motion: Shape, mass: float = 1.5, **more) -> KinematicsFinding:
    data, _ = measured(kind, motion, **more)
    found = find_geometry(asset(folder, kind, mass=mass), data)
    assert found is not None
    return found


def tilted(kind):
    axis = turn(X, 0.03) @ turn(Z, -0.02) @ Y
    return ideal(kind, axis)


def moved_pivot(kind):
    return lambda q, t: about(PIVOT + OFFSET, turn(Y, q))


def helix(kind):
    if kind == "revolute":  # not quite straight
        return lambda q, t: slid(np.outer(0.012 * (q + 0.05 * q**2), Y)) @ ideal(kind)(q, t)
    return lambda q, t: about(PIVOT, turn(Y, 0.3 * (q + 0.1 * q**2))) @ ideal(kind)(q, t)


def out_of_round(kind, size=0.008):
    def motion(q, t):
        shift = size * np.stack([np.cos(2 * q + 0.7), 0 * q, -np.sin(2 * q + 0.7)], 1)
        return slid(shift + 0.05 * shift**2 / size) @ ideal(kind)(q, t)

    return motion


def rocking(kind):
    def motion(q, t):
        wave = 2 / np.pi * np.arcsin(0.98 * np.sin(2 * np.pi * 2.7 * t + 1.0))  # nearly a triangle
        return about(PIVOT, turn([0.6, 0, 0.8], 0.015 * wave)) @ ideal(kind)(q, t)

    return motion


HINGES = {"pivot_offset": moved_pivot, "eccentricity": out_of_round}
"""A slider has no pivot."""
EITHER = {"axis_tilt": tilted, "screw_pitch": helix, "wobble": rocking}


@pytest.mark.parametrize(
    "kind, name, shape",
    [
        *(("revolute", *of) for of in {**HINGES, **EITHER}.items()),
        *(("prismatic", *of) for of in EITHER.items()),
    ],
)
def test_every_geometry_effect_is_named(tmp_path: Path, kind: str, name: str, shape):
    found = found_in(tmp_path, kind, shape(kind))
    assert (found.verdict, [e.name for e in found.effects]) == ("named", [name]), found.ranking[:4]
    for track in found.tracks:
        assert track.gap_before > 1.3 * track.floor
        assert track.gap_after < 1.15 * track.floor
    assert found.p_values[0] < 0.01


@TYPES
def test_ideal_geometry_has_no_gap(tmp_path: Path, kind: str):
    for seed in range(3):
        found = found_in(tmp_path, kind, ideal(kind), seed=seed, rho=[0.2, 0.8, 0.97][seed], runs=3 + seed)
        assert (found.verdict, found.effects, found.rivals) == ("no_gap", (), ())
        assert np.mean([t.gap_after / t.floor for t in found.tracks]) == pytest.approx(1.0, abs=0.25)


def test_parameters_lie_in_their_confidence_intervals(tmp_path: Path):
    inside, tests = 0, 0
    for seed in range(3):
        found = found_in(tmp_path, "revolute", moved_pivot("revolute"), seed=20 + seed)
        first = np.cross(X, Y)  # x is the coordinate axis least along y, the earlier of equals
        true = {"along_first": OFFSET @ first, "along_second": OFFSET @ np.cross(Y, first)}
        for name, value in true.items():
            tests += 1
            inside += found.named[0].low[name] <= value <= found.named[0].high[name]
            assert found.named[0].high[name] - found.named[0].low[name] < 0.003
    assert inside >= 0.6 * tests


def test_a_tumbling_part_is_a_one_line_error(tmp_path: Path):
    """A part that rotates as no joint of this type can: the wrong joint, or inconsistent frames."""

    def tumbles(q, t):
        T = ideal("prismatic")(q, t)
        T[:, :3, :3] = turn(X, 8.0 * q)
        return T

    data, _ = measured("prismatic", tumbles)
    message = r"run 'r0' turns the part by \S+ rad across the axis of joint 'j\w*', expected less than 1"
    with pytest.raises(FreeArtError, match=message):
        find_geometry(asset(tmp_path, "prismatic"), data)
