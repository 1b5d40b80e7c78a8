"""A reconstructed video as a measured set: its part poses and their visibility."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.asset import read_asset
from freeart21.files.measured import write_measured
from freeart21.files.places import check_place
from freeart21.files.result import read_result
from freeart21.measured import Measured, Run
from freeart21.reconstruction import Failure

DENSITY_UNCERTAINTY = 0.3
"""Relative uncertainty of inertia and weight of a reconstructed part, whose density is a guess."""

_STATIC_SHARE = 0.1
"""Motion before the camera, relative to the other part's, below which a part stood still."""


def measure_result(result: Path, out: Path, gravity: ArrayLike, rate_hz: float) -> None:
    """Write `out/measured`, for `freeart21 gap` with the result's own exported asset: one run, not held out.

    Args:
        result: a result folder with its `asset`; its reference part was static in the world.
        out: the folder to make.
        gravity: (3,) m/s^2 in the result's canonical frame (for our own results the camera's of the first frame).
        rate_hz: frames a second.

    Raises FreeArtError when the result is a failure, has no asset, or one of another joint, or when its moving part,
    not its reference part, was static before the camera.
    """
    result = Path(result)
    check_place(out, None, (result,))
    read = read_result(result, appearance=False)
    if isinstance(read, Failure):
        raise FreeArtError(f"{result} is a failure, nothing to measure: {read.stage}: {read.reason}")
    if not (result / "asset").is_dir():
        raise FreeArtError(f"{result} has no asset; make one by `freeart21 export {result} --out {result / 'asset'}`")
    asset = read_asset(result / "asset", guesses=False)
    moved = [float(np.ptp(Ts, axis=0).max()) for Ts in (read.Ts_camera_reference, read.Ts_camera_moving)]
    if moved[1] < _STATIC_SHARE * moved[0]:
        raise FreeArtError(
            f"{result} has for its moving part the one that stood still before the camera, expected that the reference "
            "part stands fixed: the asset's base is the part that swung"
        )
    joint = read.articulation.joint
    n = len(read)
    poses = se3.inverse(read.Ts_camera_reference) @ read.Ts_camera_moving
    poses[:, :3, 3] *= asset.scale
    run = Run(
        "take_0",
        np.arange(n) / rate_hz,
        np.full(n, np.nan),
        poses=poses,
        seen=np.asarray(read.seen.all(1)),
    )
    measured = Measured(
        asset.joint,
        joint.type,
        np.asarray(gravity, float),
        rate_hz,
        "nominal",
        inertia_relative=DENSITY_UNCERTAINTY,
        gravity_relative=DENSITY_UNCERTAINTY,
        runs=(run,),
    )
    with atomic.new_folder(out) as aside:
        write_measured(aside / "measured", measured)
