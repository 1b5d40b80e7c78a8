"""Real recordings, by others, as assets and measured sets: through the doors that users have, from few numbers each.

The files stay where they are (`../shared/measured`, which says whose they are); what is known of them beforehand is in
`real_expected.json`. Masses that nobody gives are 1 kg: what is found is then over that mass.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from benchmarks.common import SHARED
from export.joint_asset import write_joint_asset
from export.settings import JointNumbers
from freeart21.formats.measured_series import measure_series
from freeart21.formats.series_settings import SeriesSettings
from freeart21.se3 import Array

MEASURED = SHARED / "measured"
STRETCHES = 6
"""Into which a long free swing is cut; the second and the fifth are held out."""
MULTIARM = JointNumbers(0.1476, "pendulum", 0.14775, 1.0912e-4 + 0.1476 * 0.14775**2)
"""EstimatedParameters_SinglePendulum.mat of its authors."""
PHY180, PHY180_SLOW = JointNumbers(1.0, "pendulum", period=1.024), JointNumbers(1.0, "pendulum", period=1.409)
"""Periods of small swings, read off the recordings: 1.024 s at .1 rad, 1.409 s at .2 rad."""
ADIP = JointNumbers(0.096, "pendulum", 0.195, period=0.993)
"""Mass and length of its authors, the period at .2 rad as recorded."""
ARM = 0.30
"""m of its authors, from the arm's axis to the pendulum."""
BAM = JointNumbers(0.49, "pendulum", 0.10)
"""Mass and length in the logs."""
BAM_MOTOR = {"kt": 0.3029, "R": 3.368, "error_gain": 0.00246, "vin": 7.4}
"""N*m/A, ohm, duty per rad and unit of kp, V: params/xl330/m1.json and xl330/actuator.py of Rhoban/bam."""
DFKI = JointNumbers(0.6755, "pendulum", 0.5)
"""Mass and length of its authors' URDF."""
DIRECTDRIVE = JointNumbers(10.0, "pendulum", 40.0 / 98.1, 2.519)
"""kg m^2 of its authors, 2.351 + .168 cos(0); the weight's moment, 40 N m, off the torque at steady speed."""
HSM150 = JointNumbers(0.5, "door", 0.0, 1.2e-4)
"""J of the recording's own variables (the catalogue's)."""
SPEEDS = {"steady": ("10", "20", "30", "15"), "slow": ("1", "2", "5", "3")}
"""Degrees a second, as its files call them; the last is held out."""


def recordings() -> dict[str, Callable[[Path], None]]:
    """Name to what writes that recording's asset.urdf and measured/ into a new folder; of those that are at hand."""
    made: dict[str, tuple[str, Callable[[Path], None]]] = {
        "multiarm": ("multiarm_pendulum", multiarm),
        "phy180_whole": ("phy180_pendulum", phy180_whole),
        "phy180_31": ("phy180_pendulum", lambda out: _write_filmed(out, "data31", PHY180)),
        "phy180_32": ("phy180_pendulum", lambda out: _write_filmed(out, "data32", PHY180)),
        "phy180_slow": ("phy180_pendulum", lambda out: _write_filmed(out, "data2_14", PHY180_SLOW)),
        "adip_pend": ("rotary_and_cart", adip_pend),
        "adip_pend_cut": ("rotary_and_cart", adip_pend_cut),
        "rotary_settled": ("rotary_and_cart", lambda out: rotary(out, settled=True)),
        "rotary_moving": ("rotary_and_cart", lambda out: rotary(out, settled=False)),
        "rotary_told": ("rotary_and_cart", rotary_with_base),
        "bam_kp100": ("bam_xl330", lambda out: servo(out, 100)),
        "bam_kp400": ("bam_xl330", lambda out: servo(out, 400)),
        "bam_free": ("bam_xl330", servo_off),
        "dfki": ("dfki_pendulum", dfki),
        "directdrive_steady": ("directdrive_friction", lambda out: directdrive(out, SPEEDS["steady"])),
        "directdrive_slow": ("directdrive_friction", lambda out: directdrive(out, SPEEDS["slow"])),
        "directdrive_breakaway": ("directdrive_friction", breakaway),
        "hsm150": ("hsm150_motor", lambda out: motor(out, ("pos_0.06", "neg_0.04"))),
        "hsm150_pos": ("hsm150_motor", lambda out: motor(out, ("pos_0.06",))),
        "hsm150_neg": ("hsm150_motor", lambda out: motor(out, ("neg_0.04",))),
    }
    return {name: make for name, (folder, make) in made.items() if (MEASURED / folder).is_dir()}


def multiarm(out: Path) -> None:
    """Four segments to fit, the authors' two validation segments held out; 0 is hanging."""
    file = MEASURED / "multiarm_pendulum" / "SinglePendulumDataForParameterEstimation.mat"
    given = {"columns": ("t=Time_id+Time_vad", "q=Y_id:1+Y_vad:1"), "zero": np.pi, "held_out": ("5", "6")}
    _write_set(out, MULTIARM, [file], **given, inertia_relative=0.05, gravity_relative=0.05)


def phy180_whole(out: Path) -> None:
    """One film fitted, the other held out, as their files are."""
    files = [MEASURED / "phy180_pendulum" / f"data{k}.csv" for k in (31, 32)]
    _write_set(out, PHY180, files, held_out=("data32",), **_LENGTH_BY_PERIOD)


_LENGTH_BY_PERIOD = {"inertia_relative": 0.0, "gravity_relative": 0.05}
"""Of a pendulum whose mass is a guess: what its period tells is the weight's moment over the inertia."""


def _write_filmed(out: Path, name: str, body: JointNumbers) -> None:
    rows = np.genfromtxt(MEASURED / "phy180_pendulum" / f"{name}.csv", delimiter=",", skip_header=1)
    files = _cut_in_three(out, rows)
    _write_set(out, body, files, held_out=("2", "5"), **_LENGTH_BY_PERIOD)


def adip_pend(out: Path) -> None:
    """The one file."""
    _write_set(out, ADIP, [MEASURED / "rotary_and_cart" / "adip_pend_data.mat"], **_LENGTH_BY_PERIOD)


def adip_pend_cut(out: Path) -> None:
    """The same in stretches."""
    data = loadmat(MEASURED / "rotary_and_cart" / "adip_pend_data.mat")
    files = _cut_in_three(out, np.column_stack([data["t"], data["theta2"]]))
    _write_set(out, ADIP, files, held_out=("2", "5"), **_LENGTH_BY_PERIOD)


def rotary(out: Path, settled: bool) -> None:
    """The pendulum of an arm that was turned by a radian: from the start on, or from where it is still (1e-3 rad)."""
    files = []
    for gain, still in ((3, 3.0), (5, 2.5)):
        data = loadmat(MEASURED / "rotary_and_cart" / f"adip_arm_pcont_data_kP_{gain}_ref_1.mat")
        rows = np.column_stack([data["t"], data["theta2"]])
        rows = rows[rows[:, 0] > (still if settled else 1.0)]
        files.append(_write_csv(out / "raw" / f"kp{gain}.csv", "time,angle", rows))
    _write_set(out, ADIP, files, held_out=("kp5",), **_LENGTH_BY_PERIOD)


def rotary_with_base(out: Path) -> None:
    """The pendulum and how its arm turns: the arm's axis is upright, ARM from the middle of the pendulum's bearing, on
    the side on which the first swing shows it."""
    files = []
    for gain in (3, 5):
        data = loadmat(MEASURED / "rotary_and_cart" / f"adip_arm_pcont_data_kP_{gain}_ref_1.mat")
        rows = np.column_stack([data[name] for name in ("t", "theta2", "theta1")])
        rows = rows[rows[:, 0] > 1.0]
        files.append(_write_csv(out / "raw" / f"kp{gain}.csv", "time,angle,arm", rows))
    columns = ("t=time", "q=angle", "base_angle=arm")
    given = out / "raw" / "circumstances.json"
    given.write_text(json.dumps({"base": {"axis": [0, 0, 1], "point": [0, ARM, 0]}}))
    _write_set(out, ADIP, files, columns=columns, circumstances=given, held_out=("kp5",), **_LENGTH_BY_PERIOD)


def servo(out: Path, gain: int) -> None:
    """Four commands at one gain; where the torque was switched off, a run without the servo begins."""
    names = ("lift_and_drop", "sin_sin", "sin_time_square", "up_and_down")
    files = [MEASURED / "bam_xl330" / f"kp{gain}_{name}.json" for name in names]
    per_amp = BAM_MOTOR["kt"] / BAM_MOTOR["R"]
    law = (BAM_MOTOR["error_gain"] * gain * BAM_MOTOR["vin"] * per_amp, BAM_MOTOR["kt"] * per_amp)
    held_out = (f"kp{gain}_sin_time_square",)
    _write_set(out, BAM, files, actuator=law, held_out=held_out, inertia_relative=0.05, gravity_relative=0.05)


def servo_off(out: Path) -> None:
    """What both gains' logs have after the servo is switched off."""
    files = []
    for gain in (100, 400):
        entries = json.loads((MEASURED / "bam_xl330" / f"kp{gain}_lift_and_drop.json").read_text())["entries"]
        rows = [(e["timestamp"], e["position"]) for e in entries if not e["torque_enable"]]
        files.append(_write_csv(out / "raw" / f"drop{gain}.csv", "time,angle", np.array(rows)))
    _write_set(out, BAM, files, held_out=("drop100",), inertia_relative=0.05, gravity_relative=0.05)


def dfki(out: Path) -> None:
    """One recording, cut in two; the last third is held out."""
    rows = np.genfromtxt(MEASURED / "dfki_pendulum" / "sysid_measured.csv", delimiter=",", skip_header=1)[:, [0, 1, 3]]
    parts = {"early": rows[: 2 * len(rows) // 3], "late": rows[2 * len(rows) // 3 :]}
    files = [_write_csv(out / "raw" / f"{name}.csv", "time,position,torque", part) for name, part in parts.items()]
    unsure = {"inertia_relative": 0.2, "gravity_relative": 0.2}
    _write_set(out, DFKI, files, effort="commanded", held_out=("late",), **unsure)


def directdrive(out: Path, speeds: Sequence[str]) -> None:
    """Turns at steady speeds, both ways, under the torque that they needed; the last speed is held out."""
    names = [sign + speed for speed in speeds for sign in ("", "n")]
    files = [_join_files(out, "test2", "cin", name) for name in names]
    held_out = tuple(file.stem for file in files[-2:])
    _write_torques(out, DIRECTDRIVE, files, held_out=held_out, inertia_relative=0.05, gravity_relative=0.1)


def breakaway(out: Path) -> None:
    """A torque that rises until nearly all the friction is used up."""
    _write_torques(
        out, DIRECTDRIVE, [_join_files(out, "test1", "est", "05")], inertia_relative=0.05, gravity_relative=0.1
    )


def _join_files(out: Path, test: str, kind: str, name: str) -> Path:
    """Position, degrees, and torque of one recording in one file: they stand in two, row by row."""
    folder = MEASURED / "directdrive_friction" / test
    pos, tau = (np.loadtxt(folder / f"{kind}_{what}1_{name}_exp_gan.t") for what in ("pos", "tau"))
    return _write_csv(out / "raw" / f"{kind}_{name}.csv", "time,angle,torque", np.column_stack([pos, tau[:, 1]]))


def motor(out: Path, ways: Iterable[str]) -> None:
    """Torque steps; of each way the second run is held out."""
    files = [MEASURED / "hsm150_motor" / f"idf_{way}_{k}.mat" for way in ways for k in (1, 2)]
    columns = ("t=data:1", "q=data:3", "effort=data:5")
    held_out = tuple(file.name for file in files if file.stem.endswith("_2"))
    _write_set(
        out, HSM150, files, columns=columns, unit_q="rad", unit_effort="N*m", effort="commanded", held_out=held_out,
        inertia_relative=0.1, gravity_relative=0.0,
    )  # fmt: skip


def _write_torques(out: Path, body: JointNumbers, files: list[Path], **given: Any) -> None:
    _write_set(out, body, files, effort="commanded", unit_q="deg", unit_effort="N*m", **given)


def _cut_in_three(out: Path, rows: Array) -> list[Path]:
    """Files of the stretches of (n, 2) times and angles; rows without a number go."""
    rows = rows[np.isfinite(rows).all(1)]
    edges = np.linspace(0, len(rows), STRETCHES + 1).astype(int)
    parts = [rows[a:b] for a, b in pairwise(edges)]
    return [_write_csv(out / "raw" / f"part{k + 1}.csv", "time,angle", part) for k, part in enumerate(parts)]


def _write_csv(path: Path, header: str, rows: Array) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, rows, fmt="%.9g", delimiter=",", header=header, comments="")
    return path


def _write_set(out: Path, body: JointNumbers, files: list[Path], **given: Any) -> None:
    """out/asset.urdf and out/measured, by the public functions; positions are in rad if nothing else is given."""
    write_joint_asset(out / "asset.urdf", body)
    stated = {"asset": out / "asset.urdf", "unit_q": "rad", **given}
    measure_series(files, out / "set", SeriesSettings(**stated))
    (out / "set" / "measured").rename(out / "measured")
    (out / "set").rmdir()
