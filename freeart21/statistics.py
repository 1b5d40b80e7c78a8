"""Statistics of a recording's motion: its pace, what is visible of the object, and how hard it is to track."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3, sphere
from freeart21.mesh import box_centre
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.truth import Truth

TURN_DEGREES = 0.3
"""An object that turns less than this from frame to frame, and shifts less, is at rest. Motion capture noise at rest is
.007 to .028 (2nd percentile of 32 takes of ARCTIC), that of an object held still in a hand .02 to .08 (median)."""
SHIFT = 0.003
"""The same limit for its centre, as a share of the object's diagonal."""
JOINT_SHARE = 0.002
"""A joint that moves less than this share of its range from frame to frame is at rest."""
FEW = 0.05
"""Share of the object's pixels below which the moving part is hard to track."""
HARD_FRAMES = 0.15
"""A sequence is hard when the moving part has few pixels in this share of its frames."""
GONE_FRAMES = 5
"""The moving part has disappeared when it has no pixel in this many frames in a row."""


@dataclass(frozen=True)
class MotionStatistics:
    """Statistics of one sequence of n frames."""

    name: str
    source: dict[str, str]
    """Object, motion, sensor and seed, where the truth states them; of a take, its name and device."""
    joint_type: str
    degrees: Array
    """(n - 1,) degrees from frame to frame that the held part (the one that turns less in all) turns in camera axes."""
    share: Array
    """(n,) the moving part's share of the object's pixels."""
    both: float
    """Share of the frames in which pose and joint moved."""
    coverage: float
    """Share of the viewing sphere that the video covers (`freeart21.sphere`)."""
    range_covered: float
    """Share of the joint's limits that its states span; 1 where it has no limits."""
    depth_m: tuple[float, float]
    """Nearest and furthest depth, metres, over the checked frames."""

    @property
    def motion_source(self) -> str:
        """The scripted style, or the device of the take."""
        return self.source.get("device") or self.source.get("motion", "unknown")

    @property
    def few_pixels_share(self) -> float:
        """Share of frames in which the moving part has few pixels (FEW)."""
        return float(np.mean(self.share < FEW))

    @property
    def longest_absence(self) -> int:
        """Most frames in a row without a pixel of the moving part."""
        return longest_run(self.share == 0)

    @property
    def is_hard(self) -> bool:
        """Whether the moving part has few pixels in HARD_FRAMES of the frames."""
        return self.few_pixels_share >= HARD_FRAMES


def motion_statistics(recording: Recording, truth: Truth, every: int = 10) -> MotionStatistics:
    """The statistics of a recording with its truth; depth is measured in every `every`-th frame.

    Raises FreeArtError when a picture is missing or of another size than the camera's.
    """
    joint, states, n = truth.articulation.joint, truth.states, len(truth)
    middles, turns, shifts = _parts_motion(truth)
    held = int(turns[1].sum() < turns[0].sum())
    moves = np.maximum(turns / TURN_DEGREES, shifts / (SHIFT * truth.diagonal))
    pose = moves.min(0) >= 1  # one part at rest: the object was held still while the joint moved
    span = float(np.ptp(states))
    working = np.abs(np.diff(states)) >= JOINT_SHARE * span if span > 0 else np.zeros(n - 1, bool)
    limits = joint.upper - joint.lower
    views = sphere.view_directions(truth.Ts_camera_reference, np.mean(middles, axis=0))
    return MotionStatistics(
        recording.name,
        _source(truth),
        joint.type,
        turns[held],
        truth.seen[:, 1] / np.maximum(truth.seen.sum(1), 1),
        float(np.mean(pose & working)) if n > 1 else 0.0,
        sphere.coverage(views),
        span / max(limits if np.isfinite(limits) else span, 1e-12),
        _depth_range(recording, range(0, n, every)),
    )


def longest_run(flags: NDArray[np.bool_]) -> int:
    """The most flags (n,) in a row that are set."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(flags, int), [0]])))
    return int(np.diff(edges)[::2].max(initial=0))


def _source(truth: Truth) -> dict[str, str]:
    keys = ("object", "motion", "sensor", "seed")
    found: dict[str, str] = {str(key): str(truth.source[key]) for key in keys if key in truth.source}
    take = truth.source.get("track")
    if isinstance(take, dict):
        found |= {"take": str(take.get("name", "unknown")), "device": str(take.get("device", "a take"))}
    return found


def _parts_motion(truth: Truth) -> tuple[list[Array], Array, Array]:
    """Box centres (3,) of both parts, canonical frame; rotations, degrees, and shifts of the centres, metres, from
    frame to frame in the camera's axes, (2, n - 1) each."""
    middles, turns, shifts = [], [], []
    parts = truth.articulation.reference, truth.articulation.moving
    for mesh, Ts in zip(parts, (truth.Ts_camera_reference, truth.Ts_camera_moving), strict=True):
        middle = box_centre(mesh)
        Rs = Ts[:, :3, :3]
        where = Rs @ middle + Ts[:, :3, 3]
        middles.append(middle)
        turns.append(np.degrees(se3.rotation_angle(Rs[1:] @ np.swapaxes(Rs[:-1], 1, 2))))
        shifts.append(np.linalg.norm(np.diff(where, axis=0), axis=1))
    return middles, np.stack(turns), np.stack(shifts)


def _depth_range(recording: Recording, frames: range) -> tuple[float, float]:
    """Nearest and furthest depth of the object, metres; zeros without any."""
    depths = [frame.depth[frame.mask & (frame.depth > 0)] for frame in map(recording.frame, frames)]
    found = [depth for depth in depths if len(depth)]
    return (min(float(d.min()) for d in found), max(float(d.max()) for d in found)) if found else (0.0, 0.0)
