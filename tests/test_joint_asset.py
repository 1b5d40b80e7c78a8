"""An asset of a few numbers moves as those numbers say."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from refusal import assert_refused

from export import commands
from export.joint_asset import write_joint_asset
from export.settings import JointNumbers
from freeart21.errors import FreeArtError
from freeart21.files.asset import find_movable_joint, read_asset
from generator.simulate import load, roll_out

G = 9.81


def write_and_read(folder: Path, kind, mass, *arguments, **numbers):
    """The asset as it is read back."""
    path = folder / "made.urdf"
    write_joint_asset(path, JointNumbers(mass, kind, *arguments, **numbers))
    return read_asset(path)


def period_of(asset, amplitude: float) -> float:
    """s of one free swing from `amplitude`, by its falls through the middle."""
    rolled = roll_out(asset, amplitude, duration_s=12.0)
    falls = np.flatnonzero((rolled.q[:-1] > 0) & (rolled.q[1:] <= 0))
    at = rolled.times_s[falls] - rolled.q[falls] * 1e-3 / (rolled.q[falls + 1] - rolled.q[falls])
    return float(np.diff(at).mean())


def complete_elliptic(k: float) -> float:
    """K(k), by the arithmetic-geometric mean."""
    a, b = 1.0, math.sqrt(1 - k * k)
    for _ in range(8):
        a, b = (a + b) / 2, math.sqrt(a * b)
    return math.pi / (2 * a)


@pytest.mark.parametrize("amplitude", [0.02, 1.2])
@pytest.mark.parametrize("inertia", [None, 0.021])
def test_a_compound_pendulum_has_the_period_of_its_closed_form(amplitude: float, inertia: float | None, tmp_path: Path):
    asset = write_and_read(tmp_path, "pendulum", 0.49, 0.17, inertia)
    true = 0.49 * 0.17**2 if inertia is None else inertia
    expected = 4 * math.sqrt(true / (0.49 * G * 0.17)) * complete_elliptic(math.sin(amplitude / 2))
    assert period_of(asset, amplitude) == pytest.approx(expected, rel=5e-5)


def test_a_period_tells_the_length_or_the_inertia(tmp_path: Path):
    for k, numbers in enumerate(({}, {"length": 0.195})):
        (tmp_path / str(k)).mkdir()
        asset = write_and_read(tmp_path / str(k), "pendulum", 0.096, period=0.993, **numbers)
        assert period_of(asset, 0.01) == pytest.approx(0.993, rel=5e-5)
    assert load(asset).joint_inertia == pytest.approx(0.096 * G * 0.195 * (0.993 / (2 * math.pi)) ** 2, rel=1e-6)


def test_a_door_feels_its_inertia_and_no_gravity_and_a_drawer_its_mass(tmp_path: Path):
    cases = (("door", {"length": 0.4, "inertia": 5.0}, 5.0), ("door", {"length": 0.0, "inertia": 1.2e-4}, 1.2e-4))
    for k, (kind, numbers, inertia) in enumerate((*cases, ("drawer", {}, 8.0))):
        (tmp_path / str(k)).mkdir()
        asset = write_and_read(tmp_path / str(k), kind, 8.0, **numbers)
        pushed = roll_out(asset, 0.0, duration_s=1.0, force=lambda t, inertia=inertia: 0.3 * inertia)
        np.testing.assert_allclose(pushed.q, 0.15 * pushed.times_s**2, atol=2e-6)


def test_limits_and_names_are_those_given(tmp_path: Path):
    asset = write_and_read(tmp_path, "drawer", 2.0, lower=0.0, upper=0.4, joint="slide")
    joint = find_movable_joint(asset.urdf)
    assert (joint.name, joint.type, joint.lower, joint.upper) == ("slide", "prismatic", 0.0, 0.4)
    assert find_movable_joint(write_and_read(tmp_path, "door", 2.0, 0.3).urdf).type == "continuous"
    assert (
        find_movable_joint(write_and_read(tmp_path, "pendulum", 2.0, 0.3, lower=-1.0, upper=1.0).urdf).type
        == "revolute"
    )


WRONG = {
    "needs --length": {"mass": 1.0},
    "is too small: 2 kg at 0.5 m have 0.5 alone": {"mass": 2.0, "length": 0.5, "inertia": 0.4},
    "expected a number above 0": {"mass": 0.0, "length": 0.5},
    "a pendulum's centre of mass is off its axis": {"mass": 1.0, "length": 0.0},
    "a drawer has a mass alone": {"kind": "drawer", "mass": 1.0, "length": 0.2},
    "expected both limits": {"mass": 1.0, "length": 0.2, "lower": 0.0},
    "expected the lower one to be less": {"mass": 1.0, "length": 0.2, "lower": 1.0, "upper": 0.0},
}


@pytest.mark.parametrize("message", WRONG)
def test_numbers_that_cannot_be_are_refused_in_one_line(message: str, tmp_path: Path):
    with pytest.raises(FreeArtError, match=message) as caught:
        write_joint_asset(tmp_path / "made.urdf", JointNumbers(**{"kind": "pendulum", **WRONG[message]}))
    assert "\n" not in str(caught.value) and not list(tmp_path.iterdir())


def test_only_an_older_asset_of_a_few_numbers_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture):
    out = tmp_path / "lid.urdf"
    commands.joint_asset(out, JointNumbers(0.3, length=0.1))
    commands.joint_asset(out, JointNumbers(0.3, length=0.2))
    assert "-0.2" in out.read_text() and capsys.readouterr().out.split() == [str(out), str(out)]
    mine = '<robot name="mine"/>'
    out.write_text(mine)
    assert_refused("lacks our mark", commands.joint_asset, out, JointNumbers(0.3, length=0.1))
    assert out.read_text() == mine
    assert_refused(
        "expected the name of a URDF file", commands.joint_asset, tmp_path / "lid", JointNumbers(0.3, length=0.1)
    )
