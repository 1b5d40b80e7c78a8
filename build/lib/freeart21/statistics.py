"""What a recording's motion is like: its pace, what is seen of the object, and how hard it is to follow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3, sphere
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.strokes import JOINT_SHARE, SHIFT, TURN_DEGREES, Movement
from freeart21.truth import Truth

FEW = 0.05
"""Share of the object's pixels below which the moving part is hard to follow."""
HARD_FRAMES = 0.15
"""Share of the frames, with few pixels of the moving part, that makes a sequence a hard one."""
GONE_FRAMES = 5
"""Frames without a pixel of the moving part, one after the other, that count as its disappearance."""


@dataclass(frozen=True)
class MotionStatistics:
    """Of one sequence of n frames."""

    name: str
    source: dict[str, str]
    """Object, motion, sensor and seed, as far as the truth tells; of a take, its name and device."""
    joint_type: str
    frames: int
    degrees: Array
    """(n - 1,) turn of the held part (the one that turns less in all) from frame to frame, against the camera."""
    opening: Array
    """(n,) joint state as a share of its limits; of its states in the video where there are none."""
    share: Array
    """(n,) the moving part's share of the object's pixels."""
    views: Array
    """(n, 3) unit vectors from the object to the camera, canonical frame."""
    movement: Movement
    """Of the held part, and of the joint over the range of its states."""
    pose_only: float
    """Shares of the frames in which only the pose, only the joint, both or neither moved."""
    joint_only: float
    both: float
    neither: float
    coverage: float
    """Share of the sphere of views that was seen (`freeart21.sphere`)."""
    range_covered: float
    """Share of the joint's limits that its states span."""
    fill: float
    """Median height of the object, as a share of the picture's."""
    leaves: bool
    """Whether the object touches the border of the picture in some frame."""
    depth_m: tuple[float, float]
    """Nearest and furthest depth, metres, over the frames looked at."""
    masks_valid: bool
    """Whether foreground, part masks and the truth's pixel counts agree, in the frames looked at."""

    @property
    def recorded(self) -> bool:
        """Whether somebody moved the object, rather than a script."""
        return "take" in self.source

    @property
    def moved_by(self) -> str:
        """The scripted style, or what the motion was taken with."""
        return self.source.get("device", "a take") if self.recorded else self.source.get("motion", "unknown")

    @property
    def median_degrees(self) -> float:
        """Median turn a frame."""
        return float(np.median(self.degrees)) if len(self.degrees) else 0.0

    @property
    def max_degrees(self) -> float:
        """Largest turn a frame."""
        return float(self.degrees.max(initial=0.0))

    @property
    def few(self) -> float:
        """Share of frames in which the moving part has few pixels."""
        return float(np.mean(self.share < FEW))

    @property
    def gone(self) -> int:
        """Most frames in a row without a pixel of the moving part."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], (self.share == 0).astype(int), [0]])))
        return int(np.diff(edges)[::2].max(initial=0))

    @property
    def hard(self) -> bool:
        """Whether the moving part has few pixels for long."""
        return self.few >= HARD_FRAMES


def motion_statistics(recording: Recording, truth: Truth, every: int = 10) -> MotionStatistics:
    """The statistics of a recording with its truth; depth and foreground are looked at in every `every`-th frame.

    Raises FreeArtError when a picture is missing or of another size than the camera's.
    """
    joint, states, n = truth.articulation.joint, truth.states, len(truth)
    middles, wheres, turns, shifts = _parts_motion(truth)
    poses = truth.Ts_camera_reference, truth.Ts_camera_moving
    held = int(turns[1].sum() < turns[0].sum())
    moves = np.maximum(turns / TURN_DEGREES, shifts / (SHIFT * truth.diagonal))
    pose = moves.min(0) >= 1  # a part at rest says that the object was held still and the joint worked
    span = float(np.ptp(states))
    working = np.abs(np.diff(states)) >= JOINT_SHARE * span if span > 0 else np.zeros(n - 1, bool)
    shares = (states - states.min()) / max(span, 1e-12)
    low, high = (joint.lower, joint.upper) if np.isfinite([joint.lower, joint.upper]).all() else _ends(states)
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
        Movement.of(poses[held][:, :3, :3], wheres[held] / truth.diagonal, shares, frames_a_second(recording)),
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
    told: dict[str, str] = {str(key): str(truth.source[key]) for key in keys if key in truth.source}
    take = truth.source.get("track")
    if isinstance(take, dict):
        told |= {"take": str(take.get("name", "unknown")), "device": str(take.get("device", "a take"))}
    return told


def _ends(states: Array) -> tuple[float, float]:
    return float(states.min()), float(states.max())


def frames_a_second(recording: Recording) -> float:
    """Frames a second, by the middle one of all waits between frames."""
    return 1 / float(np.median(np.diff(recording.times_s))) if len(recording) > 1 else 30.0


def _parts_motion(truth: Truth) -> tuple[list[Array], list[Array], Array, Array]:
    """Middles (3,) of both parts, canonical; where these are before the camera, metres, (n, 3) each; turns,
    degrees, and shifts of the middles, metres, (2, n - 1) each."""
    middles, wheres, turns, shifts = [], [], [], []
    parts = truth.articulation.reference, truth.articulation.moving
    for mesh, Ts in zip(parts, (truth.Ts_camera_reference, truth.Ts_camera_moving), strict=True):
        corners = mesh.vertices[np.unique(mesh.faces)]
        middle = (corners.min(0) + corners.max(0)) / 2 if len(corners) else np.zeros(3)
        Rs = Ts[:, :3, :3]
        where = Rs @ middle + Ts[:, :3, 3]
        middles.append(middle)
        wheres.append(where)
        turns.append(np.degrees(se3.rotation_angle(Rs[1:] @ np.swapaxes(Rs[:-1], 1, 2))))
        shifts.append(np.linalg.norm(np.diff(where, axis=0), axis=1))
    return middles, wheres, np.stack(turns), np.stack(shifts)


def _outlines(truth: Truth) -> tuple[NDArray[np.int64], bool, bool]:
    """Heights (n,) of the object, pixels; whether it touches a border; whether the pixel counts are the masks'."""
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
    """Nearest and furthest depth of the object, metres, and whether the foreground is that of the part masks."""
    near, far, agree = np.inf, 0.0, True
    for i in frames:
        frame = recording.frame(i)
        agree &= np.array_equal(frame.mask, truth.part_mask(i) > 0)
        depth = frame.depth[frame.mask & (frame.depth > 0)]
        if len(depth):
            near, far = min(near, float(depth.min())), max(far, float(depth.max()))
    return (near if np.isfinite(near) else 0.0, far), agree
