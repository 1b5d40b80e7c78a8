"""The joint of an asset as it moves once loaded: type, axis, pivot and states, read from link poses.

Assets come from anywhere and are read by native code, so scoring drives them in a Python of their own
(`python -m leaderboard.asset_joint`): one that crashes the simulator costs its own row, not the whole table.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import MAX_URDF_BYTES, movable_joint, read_asset
from freeart21.files.joint_json import joint_from_json, joint_to_json
from freeart21.joint import Joint
from freeart21.se3 import Array

DRIVEN_STATES = 33
"""States, spread over the joint's range, at which the link poses are read."""
TIME_LIMIT_S = 120.0
"""How long an asset may take to load and move."""
MAX_ASSET_BYTES = 1 << 30
LEAST_TURN = 1e-4
"""Radians over the whole range below which a joint does not turn (SAPIEN's poses are float32: 1e-6)."""
LEAST_SLIDE = 1e-6
"""Metres over the whole range below which a joint does not slide."""
LOOSEST_FIT = 1e-3
"""Largest entry, per metre of travel, by which the motion may differ from that of one hinge or slider."""


def measured_joint(folder: Path, states: ArrayLike) -> tuple[Joint, Array]:
    """The joint of the asset in `folder`, canonical frame, and what it makes of the canonical `states` (n,), rad or m.

    Drives the asset in a process of its own. Raises FreeArtError with one reason when it does not load, does not move,
    or crashes the simulator.
    """
    check_files(folder)
    request = json.dumps({"asset": str(folder.resolve()), "states": np.asarray(states, float).tolist()})
    try:
        with tempfile.TemporaryDirectory(prefix="freeart21-") as place:  # goes, however that process ends
            done = subprocess.run(
                [sys.executable, "-m", "leaderboard.asset_joint"],
                input=request,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=TIME_LIMIT_S,
                check=False,
                env={**os.environ, "TMPDIR": place},
            )
    except subprocess.TimeoutExpired as error:
        raise FreeArtError(f"{folder} did not load and move within {TIME_LIMIT_S:g} s") from error
    lines = done.stdout.splitlines()
    if done.returncode or not lines:
        raise FreeArtError(
            f"{folder} ended the simulator that loaded it (exit code {done.returncode}): "
            f"{(done.stderr.strip().splitlines() or ['no message'])[-1]}"
        )
    answer: dict[str, Any] = json.loads(lines[-1])
    if "error" in answer:
        raise FreeArtError(answer["error"])
    return joint_from_json(answer["joint"], folder), np.array(answer["states"], float)


def check_files(folder: Path) -> None:
    """FreeArtError unless the asset is of bounded size and its URDF names no file outside `folder`."""
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    if size > MAX_ASSET_BYTES:
        raise FreeArtError(f"{folder} has {size} bytes, at most {MAX_ASSET_BYTES} are read")
    for urdf in sorted(folder.rglob("*.urdf")):
        try:
            root = ET.fromstring(checked.require_file(urdf, MAX_URDF_BYTES).read_bytes())
        except ET.ParseError as error:
            raise FreeArtError(f"{urdf} is not XML: {error}") from error
        for element in root.iter():
            if "filename" in element.attrib:
                inside_asset(folder, urdf, element.attrib["filename"])


def inside_asset(folder: Path, urdf: Path, name: str) -> None:
    """FreeArtError when the file `name` of a URDF leads out of the asset's folder."""
    relative = urdf.parent.relative_to(folder) / name.removeprefix("file://").removeprefix("package://")
    checked.inside(folder, str(relative))


def drive(asset: Asset, states: ArrayLike) -> tuple[Joint, Array]:
    """Load `asset` in SAPIEN, drive its joint over its range, and read joint and states from the link poses.

    States beyond the URDF's limits are driven to the limit: an asset shows what it can do.
    """
    from generator.simulate import joint_motion

    states = np.asarray(states, float)
    limits = movable_joint(asset.urdf, asset.joint)
    lower, upper = limits.lower - asset.state_zero, limits.upper - asset.state_zero
    reachable = np.clip(states, lower, upper)
    low = lower if np.isfinite(lower) else min(reachable.min(), -0.5)
    high = upper if np.isfinite(upper) else max(reachable.max(), 0.5)
    driven = np.linspace(low, high, DRIVEN_STATES)
    motion = joint_motion(asset, np.concatenate([driven, reachable]))
    joint = joint_of_motion(asset.joint, driven, motion[: len(driven)])
    return joint, states_of_motion(joint, motion[len(driven) :])


def joint_of_motion(name: str, states: Array, motion: Array) -> Joint:
    """The hinge or slider that displaces a part by `motion` (n, 4, 4), canonical frame, at rising `states` (n,).

    The axis is the direction of the summed small rotations (or of the whole translation) towards larger states; the
    pivot solves (I - R) p = t in the plane across it by least squares over all displacements. Raises FreeArtError when
    the part does not move, or moves otherwise.
    """
    steps = motion[1:] @ se3.inverse(motion[:-1])
    turn = se3.log_so3(steps[:, :3, :3]).sum(0)
    slide = motion[-1, :3, 3] - motion[0, :3, 3]
    from_first = motion @ se3.inverse(motion[0])
    limits = float(states[0]), float(states[-1])
    if np.linalg.norm(turn) > LEAST_TURN:
        axis = turn / np.linalg.norm(turn)
        across = np.linalg.svd(axis[None])[2][1:].T  # (3, 2) basis of the plane across the axis
        A = (np.eye(3) - from_first[:, :3, :3]) @ across
        in_plane, *_ = np.linalg.lstsq(A.reshape(-1, 2), from_first[:, :3, 3].reshape(-1), rcond=None)
        joint = Joint(name, "revolute", axis, across @ in_plane, *limits)
    elif np.linalg.norm(slide) > LEAST_SLIDE:
        joint = Joint(name, "prismatic", slide / np.linalg.norm(slide), np.zeros(3), *limits)
    else:
        raise FreeArtError(f"joint '{name}' of the asset does not move over its range {limits[0]:g} to {limits[1]:g}")
    q = states_of_motion(joint, from_first)
    error = np.abs(from_first - joint.transform(q)).max()
    if error > LOOSEST_FIT * (1 + np.linalg.norm(from_first[:, :3, 3], axis=-1).max()):
        raise FreeArtError(f"joint '{name}' of the asset moves like neither hinge nor slider: off by {error:.2g}")
    return joint


def states_of_motion(joint: Joint, motion: Array) -> Array:
    """States (n,) along `joint` of displacements (n, 4, 4): rad in [-pi, pi] about its axis, or m along it."""
    if joint.type == "prismatic":
        return motion[:, :3, 3] @ joint.axis
    return se3.log_so3(motion[:, :3, :3]) @ joint.axis


def _main() -> None:
    request = json.loads(sys.stdin.read())
    try:
        joint, states = drive(read_asset(Path(request["asset"])), request["states"])
        answer: dict[str, Any] = {"joint": joint_to_json(joint), "states": states.tolist()}
    except (FreeArtError, RuntimeError, ValueError, OSError) as error:
        lines = str(error).splitlines() or [type(error).__name__]
        answer = {"error": lines[0]}
    print("\n" + json.dumps(answer))


if __name__ == "__main__":
    _main()
