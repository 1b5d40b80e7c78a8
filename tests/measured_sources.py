"""Recordings of real pendula, by others, as measured sets and assets. They stay where they are: loaded by path.

multiarm   dynamicslab/MultiArm-Pendulum, e99a7e13 (MIT): one arm swinging free, 1 kHz.
           Asset: the authors' estimated arm, without its damping.
bam_kp100  Rhoban/bam, af226046 (Apache-2.0): a servo with 0.49 kg at 0.1 m; bam_kp400 the same.
           Asset: mass and length of the logs; the servo by the authors' motor constants.
dfki       dfki-ric-underactuated-lab/torque_limited_simple_pendulum, ed17ea2d (BSD-3-Clause): known motor torque.
           Asset: mass and length of the authors' URDF, as a point.

    python tests/measured_sources.py DIR      writes DIR/NAME/{asset,measured} for `freeart21 gap`
"""

from __future__ import annotations

import json
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

SHARED = Path(__file__).resolve().parents[2] / "shared" / "measured"
G = 9.81
MULTIARM = {"mass": 0.1476, "arm": 0.14775, "inertia": 1.0912e-4}
"""kg, m, kg*m^2 about the centre of mass: EstimatedParameters_SinglePendulum.mat."""
BAM = {"mass": 0.49, "arm": 0.10, "inertia": 1e-6}
BAM_MOTOR = {"kt": 0.3029, "R": 3.368, "error_gain": 0.00246, "vin": 7.4}
"""N*m/A, ohm, duty per rad and unit of kp, V: params/xl330/m1.json and xl330/actuator.py."""
DFKI = {"mass": 0.6755, "arm": 0.5, "inertia": 1e-6}
EVERY = 4
"""Of the 1 kHz recording every fourth sample is kept: 250 Hz."""


def sources() -> dict[str, Any]:
    """Name to a function that writes that set into a folder; of those whose recordings are here."""
    found: dict[str, Any] = {}
    if (SHARED / "multiarm_pendulum").is_dir():
        found["multiarm"] = multiarm
    if (SHARED / "bam_xl330").is_dir():
        found["bam_kp100"] = lambda out: bam(out, 100)
        found["bam_kp400"] = lambda out: bam(out, 400)
    if (SHARED / "dfki_pendulum").is_dir():
        found["dfki"] = dfki
    return found


def multiarm(out: Path) -> None:
    """Four segments to fit, the authors' two validation segments held out; 0 is hanging."""
    from scipy.io import loadmat

    data = loadmat(SHARED / "multiarm_pendulum" / "SinglePendulumDataForParameterEstimation.mat")
    runs = []
    for held_out, which in ((False, "id"), (True, "vad")):
        for times, y in zip(data[f"Time_{which}"].ravel(), data[f"Y_{which}"].ravel(), strict=True):
            kept = np.column_stack([times.ravel() - times.ravel()[0], y[0] - np.pi])[::EVERY]
            runs.append((kept, ("t_s", "q"), held_out))
    write(out, MULTIARM, runs, 1000.0 / EVERY, "nominal", {"inertia_relative": 0.05, "gravity_relative": 0.05})


def bam(out: Path, kp: int) -> None:
    """A set for each gain; where the torque was switched off, a run without the servo begins."""
    runs = []
    names = ("lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")
    for name in names:
        log = json.loads((SHARED / "bam_xl330" / f"kp{kp}_{name}.json").read_text())
        rows = np.array([[e["timestamp"], e["position"], e["goal_position"]] for e in log["entries"]])
        on = np.array([bool(e["torque_enable"]) for e in log["entries"]])
        edges = [0, *(np.flatnonzero(np.diff(on.astype(int))) + 1).tolist(), len(rows)]
        for begin, end in pairwise(edges):
            held_out = name == "sin_time_square"
            part = rows[begin:end]
            if on[begin]:
                runs.append((part, ("t_s", "q", "q_command"), held_out))
            else:
                runs.append((part[:, :2], ("t_s", "q"), held_out))
    per_amp = BAM_MOTOR["kt"] / BAM_MOTOR["R"]
    servo = {
        "type": "position",
        "stiffness": BAM_MOTOR["error_gain"] * kp * BAM_MOTOR["vin"] * per_amp,
        "damping": BAM_MOTOR["kt"] * per_amp,
    }
    uncertainty = {"inertia_relative": 0.1, "gravity_relative": 0.05}
    write(out, BAM, runs, 190.0, "recorded", uncertainty, actuator=servo)


def dfki(out: Path) -> None:
    """One recording, cut in two: the motor's torque is as the motor says; the last third is held out."""
    path = SHARED / "dfki_pendulum" / "sysid_measured.csv"
    table = np.genfromtxt(path, delimiter=",", names=True)
    rows = np.column_stack([table["time"], table["position"], table["torque"]])
    cut = 2 * len(rows) // 3
    runs = [(rows[:cut], ("t_s", "q", "effort"), False), (rows[cut:], ("t_s", "q", "effort"), True)]
    uncertainty = {"inertia_relative": 0.2, "gravity_relative": 0.2}
    write(out, DFKI, runs, 300.0, "recorded", uncertainty, effort="commanded")


def write(
    out: Path,
    body: dict[str, float],
    runs: list[tuple[np.ndarray, tuple[str, ...], bool]],
    rate_hz: float,
    timestamps: str,
    uncertainty: dict[str, float],
    **more: Any,
) -> None:
    """out/asset/pendulum.urdf and out/measured: a pendulum about the y axis that hangs down at 0."""
    (out / "asset").mkdir(parents=True)
    (out / "measured").mkdir()
    i = body["inertia"]
    (out / "asset" / "pendulum.urdf").write_text(
        f"""<robot name="pendulum"><link name="base"/><link name="bob"><inertial><origin xyz="0 0 {-body["arm"]}"/>
<mass value="{body["mass"]}"/><inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/></joint></robot>
"""
    )
    entries = []
    for k, (rows, columns, held_out) in enumerate(runs):
        lines = [",".join(columns), *(",".join(f"{v:.9g}" for v in row) for row in rows)]
        (out / "measured" / f"run_{k}.csv").write_text("\n".join(lines) + "\n")
        entries.append({"file": f"run_{k}.csv", "held_out": held_out})
    units = {"t_s": "s", "q": "rad", "effort": "N*m", "q_command": "rad"}
    used = {column for _, columns, _ in runs for column in columns}
    described = {
        "version": 1,
        "joint": "hinge",
        "joint_type": "revolute",
        "units": {column: unit for column, unit in units.items() if column in used},
        "gravity": [0.0, 0.0, -G],
        "base": "fixed",
        "sampling": {"rate_hz": rate_hz, "timestamps": timestamps},
        "runs": entries,
        "asset_uncertainty": uncertainty,
        **more,
    }
    (out / "measured" / "measured.json").write_text(json.dumps(described, indent=1))


if __name__ == "__main__":
    for name, make in sources().items():
        make(Path(sys.argv[1]) / name)
