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

import sys
from pathlib import Path
from typing import Any

import numpy as np

from freeart21.formats.measured_series import SeriesSettings, measure_series

SHARED = Path(__file__).resolve().parents[2] / "shared" / "measured"
MULTIARM = {"mass": 0.1476, "arm": 0.14775, "inertia": 1.0912e-4}
"""kg, m, kg*m^2 about the centre of mass: EstimatedParameters_SinglePendulum.mat."""
BAM = {"mass": 0.49, "arm": 0.10, "inertia": 1e-6}
BAM_MOTOR = {"kt": 0.3029, "R": 3.368, "error_gain": 0.00246, "vin": 7.4}
"""N*m/A, ohm, duty per rad and unit of kp, V: params/xl330/m1.json and xl330/actuator.py."""
DFKI = {"mass": 0.6755, "arm": 0.5, "inertia": 1e-6}


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
    brought(
        out,
        MULTIARM,
        [SHARED / "multiarm_pendulum" / "SinglePendulumDataForParameterEstimation.mat"],
        columns={"t": "Time_id+Time_vad", "q": "Y_id:1+Y_vad:1"},
        zero=np.pi,
        held_out=("5", "6"),
        inertia_relative=0.05,
        gravity_relative=0.05,
    )


def bam(out: Path, kp: int) -> None:
    """A set for each gain; where the torque was switched off, a run without the servo begins."""
    names = ("lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")
    per_amp = BAM_MOTOR["kt"] / BAM_MOTOR["R"]
    brought(
        out,
        BAM,
        [SHARED / "bam_xl330" / f"kp{kp}_{name}.json" for name in names],
        unit_q="rad",
        actuator=(BAM_MOTOR["error_gain"] * kp * BAM_MOTOR["vin"] * per_amp, BAM_MOTOR["kt"] * per_amp),
        held_out=(f"kp{kp}_sin_time_square",),
        gravity_relative=0.05,
    )


def dfki(out: Path) -> None:
    """One recording, cut in two: the motor's torque is as the motor says; the last third is held out."""
    header, *rows = (SHARED / "dfki_pendulum" / "sysid_measured.csv").read_text().splitlines()
    cut = 2 * len(rows) // 3
    out.mkdir(parents=True)
    files = {out / "early.csv": rows[:cut], out / "late.csv": rows[cut:]}
    for file, kept in files.items():
        file.write_text("\n".join([header, *kept, ""]))
    brought(out, DFKI, list(files), effort="commanded", held_out=("late",), inertia_relative=0.2, gravity_relative=0.2)


def brought(out: Path, body: dict[str, float], files: list[Path], **told: Any) -> None:
    """out/asset/pendulum.urdf, about y and hanging down at 0, and out/measured as `freeart21 measure` has it."""
    (out / "asset").mkdir(parents=True)
    i = body["inertia"]
    urdf = out / "asset" / "pendulum.urdf"
    urdf.write_text(
        f"""<robot name="pendulum"><link name="base"/><link name="bob"><inertial><origin xyz="0 0 {-body["arm"]}"/>
<mass value="{body["mass"]}"/><inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/></joint></robot>
"""
    )
    measure_series(files, out / "set", urdf, None, SeriesSettings(**told))
    (out / "set" / "measured").rename(out / "measured")


if __name__ == "__main__":
    for name, make in sources().items():
        make(Path(sys.argv[1]) / name)
