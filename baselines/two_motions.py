"""SIFT with depth, RANSAC of two rigid motions between keyframes, and the closed-form joint.

    python -m baselines.two_motions SEQUENCE OUT

Every 3rd frame is used.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from baselines.answer import Motion, run_baseline
from baselines.commands import run_command
from baselines.groups import agree, vote_by_motions
from baselines.rigid import LEAST_POINTS, assign_tracks, estimate_poses
from baselines.surfaces import label_pixels
from baselines.tracks import match_features
from baselines.video import UnsolvableError, Video
from freeart21.se3 import Array, Ints

EVERY = 3
TOLERANCE = 0.01
"""Of the object's size: how far a tracked point may lie from where its part's motion takes it."""


def solve(video: Video, rng: np.random.Generator) -> Motion:
    """The parts' motion by votes of pairs of keyframes."""
    points = match_features(video)
    parts = agree(vote_by_motions(points, TOLERANCE * video.size, rng))
    return move_parts(video, points, parts, rng)


def move_parts(video: Video, points: Array, parts: Ints, rng: np.random.Generator) -> Motion:
    """Poses of both parts from tracks `points` (P, F, 3) of known `parts` (P,), -1 unknown, and the pixels' labels.

    Poses and the tracks' parts are estimated in turn, while more frames are found.
    """
    tolerance, frames = TOLERANCE * video.size, -1
    while True:
        found = [estimate_poses(points[parts == part], tolerance, rng) for part in range(2)]
        Ts, seen = np.stack([T for T, _ in found]), np.stack([where for _, where in found])
        if seen.sum() <= frames or not seen.all(0).any():
            break
        frames = int(seen.sum())
        parts = assign_tracks(points, parts, Ts, seen, tolerance)
    if seen.all(0).sum() < 2:
        raise UnsolvableError("poses", f"fewer than {LEAST_POINTS} tracks of each part agree in two keyframes")
    return Motion(Ts, seen, label_pixels(video, Ts, seen, points, parts))


def main(sequence: Path, out: Path, every: int = EVERY) -> None:
    """Solve one sequence folder; writes the result folder `out`."""
    run_baseline(solve, sequence, out, every, "two-motions")


if __name__ == "__main__":
    run_command(main)
