"""KLT tracks with depth, spectral clustering of how well they keep their distances, and the closed-form joint.

    python -m baselines.rigid_clusters SEQUENCE OUT

Corners are followed through all frames; every 3rd frame is a keyframe.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from baselines.answer import Motion, run_baseline
from baselines.commands import run_command
from baselines.groups import agree, vote_by_distances
from baselines.tracks import follow_corners
from baselines.two_motions import EVERY, TOLERANCE, move_parts
from baselines.video import Video


def solve(video: Video, rng: np.random.Generator) -> Motion:
    """The parts' motion by votes of windows of keyframes."""
    points = follow_corners(video)
    parts = agree(vote_by_distances(points, TOLERANCE * video.size, rng))
    return move_parts(video, points, parts, rng)


def main(sequence: Path, out: Path, every: int = EVERY) -> None:
    """Solve one sequence folder; writes the result folder `out`."""
    run_baseline(solve, sequence, out, every, "rigid-clusters")


if __name__ == "__main__":
    run_command(main)
