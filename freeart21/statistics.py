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
    frames: int
    degrees: Array
    """(n - 1,) degrees from frame to frame that the held part (the one that turns less in all) turns in camera axes."""
    opening: Array
    """(n,) joint state as a share of its limits, or of its range in the video where it has no limits."""
    share: Array
    """(n,) the moving part's share of the object's pixels."""
    views: Array
    """(n, 3) unit vectors from the object to the camera, canonical frame."""
    pose_only: float
    """Shares of the frames in which only the pose, only the joint, both or neither moved."""
    joint_only: float
    both: float
    neither: float
    coverage: float
    """Share of the viewing sphere that the video covers (`freeart21.sphere`)."""
    range_covered: float
    """Share of the joint's limits that its states span."""
    fill: float
    """Median height of the object, as a share of the picture's."""
    leaves: bool
    """Whether the object touches the border of the picture in some frame."""
    depth_m: tuple[float, float]
    """Nearest and furthest depth, metres, over the checked frames."""
    masks_valid: bool
    """Whether foreground, part masks and the truth's pixel counts agree, in the checked frames."""

    @property
    def recorded(self) -> bool:
        """Whether a person moved the object, not a script."""
        return "take" in self.source

    @property
    def motion_source(self) -> str:
        """The scripted style, or the device of the take."""
        return self.source.get("device", "a take") if self.recorded else self.source.get("motion", "unknown")

    @property
    def median_degrees(self) -> float:
        """Median rotation from frame to frame, degrees."""
        return float(np.median(self.degrees)) if len(self.degrees) else 0.0

    @property
    def max_degrees(self) -> float:
        """Largest rotation from frame to frame, degrees."""
        return float(self.degrees.max(initial=0.0))

    @property
    def few_pixels_share(self) -> float:
        """Share of frames in which the moving part has few pixels (FEW)."""
        return float(np.mean(self.share < FEW))

    @property
    def longest_absence(self) -> int:
        """Most frames in a row without a pixel of the moving part."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], (self.share == 0).astype(int), [0]])))
        return int(np.diff(edges)[::2].max(initial=0))

    @property
    def is_hard(self) -> bool:
        """Whether the moving part has few pixels in HARD_FRAMES of the frames."""
        return self.few_pixels_share >= HARD_FRAMES


def motion_statistics(recording: Recording, truth: Truth, every: int = 10) -> MotionStatistics:
    """The statistics of a recording with its truth; depth and foreground are checked in every `every`-th frame.

    Raises FreeArtError when a picture is missing or of another size than the camera's.
    """
    joint, states, n = truth.articulation.joint, truth.states, len(truth)
    middles, turns, shifts = _parts_motion(truth)
    held = int(turns[1].sum() < turns[0].sum())
    moves = np.maximum(turns / TURN_DEGREES, shifts / (SHIFT * truth.diagonal))
    pose = moves.min(0) >= 1  # one part at rest: the object was held still while the joint moved
    span = float(np.ptp(states))
    working = np.abs(np.diff(states)) >= JOINT_SHARE * span if span > 0 else np.zeros(n - 1, bool)
    limits = joint.lower, joint.upper
    low, high = limits if np.isfinite(limits).all() else (float(states.min()), float(states.max()))
    boxes, leaves, counts_agree = _outlines(truth)
    depth, masks_agree = _depths(recording, truth, range(0, n, every))
    centre = np.mean(middles, axis=0)
    views = sphere.view_directions(truth.Ts_camera_reference, centre)
    pose_only, joint_only, both, neither = (
        float(np.mean(kind)) if n > 1 else 0.0
        for kind in (pose & ~working, ~pose & working, pose & working, ~pose & ~working)
    )
    return MotionStatistics(
        recording.name,
        _source(truth),
        joint.type,
        n,
        turns[held],
        (states - low) / max(high - low, 1e-12),
        truth.seen[:, 1] / np.maximum(truth.seen.sum(1), 1),
        views,
        pose_only,
        joint_only,
        both,
        neither,
        sphere.coverage(views),
        span / max(high - low, 1e-12),
        float(np.median(boxes)) / recording.camera.height,
        leaves,
        depth,
        counts_agree and masks_agree,
    )


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


def _outlines(truth: Truth) -> tuple[NDArray[np.int64], bool, bool]:
    """Heights (n,) of the object, pixels; whether it touches a border; whether the truth's pixel counts fit the
    masks."""
    heights, leaves, agree = np.zeros(len(truth), np.int64), False, True
    for i in range(len(truth)):
        labels = truth.part_mask(i)
        rows = np.flatnonzero((labels > 0).any(1))
        heights[i] = rows[-1] - rows[0] + 1 if len(rows) else 0
        leaves |= bool(labels[[0, -1]].any() or labels[:, [0, -1]].any())
        counts = np.bincount(labels.reshape(-1), minlength=3)
        agree &= len(counts) == 3 and np.array_equal(counts[1:], truth.seen[i])
    return heights, leaves, agree


def _depths(recording: Recording, truth: Truth, frames: range) -> tuple[tuple[float, float], bool]:
    """Nearest and furthest depth of the object, metres, and whether the foreground fits the part masks."""
    near, far, agree = np.inf, 0.0, True
    for i in frames:
        frame = recording.frame(i)
        agree &= np.array_equal(frame.mask, truth.part_mask(i) > 0)
        depth = frame.depth[frame.mask & (frame.depth > 0)]
        if len(depth):
            near, far = min(near, float(depth.min())), max(far, float(depth.max()))
    return (near if np.isfinite(near) else 0.0, far), agree
