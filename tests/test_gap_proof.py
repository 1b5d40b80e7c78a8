"""What `gap` claims is true of the files that it delivers: on motions from equations that the product does not have."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from freeart21.files.asset import read_asset
from freeart21.measured import Measured, Run
from simgap.workflow import find_gap

G = 9.81


def slider(folder: Path, mass: float) -> Path:
    """The URDF of a point mass on a free slider along x."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "ball.urdf"
    path.write_text(f"""<robot name="ball"><link name="base"/><link name="ball"><inertial><mass value="{mass}"/>
        <inertia ixx="1e-8" iyy="1e-8" izz="1e-8" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="j" type="prismatic"><parent link="base"/><child link="ball"/><axis xyz="1 0 0"/></joint></robot>""")
    return path


def test_a_ball_that_falls_along_a_slider_has_drag_and_no_load(tmp_path: Path):
    """Gravity along the slider: nothing presses on its bearing."""
    rng, mass, drag, runs = np.random.default_rng(0), 0.03, 0.001, []
    rate, end = np.sqrt(G * drag / mass), np.sqrt(mass * G / drag)
    for i, seconds in enumerate((2.0, 3.0, 3.5)):
        t = np.arange(round(15 * seconds)) / 15
        fallen = end / rate * np.log(np.cosh(rate * t))  # from rest, m v' = m g - drag v^2
        runs.append(Run(f"run_{i}", t, 45 - fallen + rng.normal(0, 0.01, len(t))))
    measured = Measured(
        "j", "prismatic", np.array([-G, 0.0, 0.0]), 15, "recorded", None, None, 0.0, 0.0, tuple(runs), "unknown"
    )
    found = find_gap(read_asset(slider(tmp_path, mass)), measured)
    assert [named.effect.name for named in found.effects] == ["quadratic_drag"]
    assert abs(found.effects[0].effect.values()[0] / drag - 1) < 0.03
