"""The paper's segmentation, made again from its text, with our poses, joint and surfaces behind it.

    python -m baselines.paper SEQUENCE OUT

Its labels stay as they are. Its learned features are replaced by `paper_features`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from baselines.commands import run_command
from baselines.paper_segmentation import MIN_WEIGHT, segment
from freeart21.files.result import write_result
from freeart21.files.sequence import read_sequence
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.se3 import Array
from reconstruct.cache import SolverState
from reconstruct.evidence import Evidence
from reconstruct.joint_type import frames_with_both_parts
from reconstruct.pipeline import SOLVERS, PreparedVideo, reconstruct, solve_joint
from reconstruct.propagation import PartEstimate, Propagation
from reconstruct.renders import render_queries
from reconstruct.seeds import Seed
from reconstruct.segmentation import add_frames
from reconstruct.settings import GaussianSettings, ReconstructSettings
from reconstruct.tracks import Tracker

SETTINGS = ReconstructSettings(gaussians=GaussianSettings(refine=False), progress=False)
"""Geometry alone."""


def solve_segmentation(
    video: PreparedVideo, state: SolverState, settings: ReconstructSettings, rng: np.random.Generator
) -> SolverState:
    """Poses of both parts in every frame under the paper's labels, and the joint.

    The "off-the-shelf pose estimators" (Sec. 3.3) are here our registration, started from the segmentation's motions,
    too. The joint is chosen on all frames by `settings.joint`. Raises UnsolvableError when fewer than 4 frames show two
    parts.
    """
    assert video.tracker is not None
    weights, motions = segment(video.evidence, video.tracker, rng)
    found = _GivenLabels(video.evidence, video.tracker, weights, motions, settings, rng)
    add_frames(found, len(video.scene))
    frames_with_both_parts(found.seen, found.done)
    found.set_joint(found.choose_joint())
    return SolverState(PartEstimate(found.current_poses(), found.labels, found.logodds, found.seen))


class _GivenLabels(Propagation):
    """Propagation from frame 0 with given labels: poses only."""

    def __init__(
        self,
        evidence: Evidence,
        tracker: Tracker,
        weights: NDArray[np.float32],
        motions: Array,
        settings: ReconstructSettings,
        rng: np.random.Generator,
    ) -> None:
        """`weights` and `motions` of `segment`."""
        w = np.clip(weights, MIN_WEIGHT, 1 - MIN_WEIGHT)
        self.given = np.where(evidence.scene.mask, np.log(w / (1 - w)), 0).astype(np.float32)
        self.motions = motions
        start = Seed(0, np.zeros(0, np.int64), np.zeros((0, 2, 4, 4)), self.given[0], 0.0, 0)
        super().__init__(evidence, tracker, start, settings, rng)

    def label_frame(self, frame: int) -> None:
        self.set_labels(frame, self.given[frame])

    def carry_labels(self, frame: int, neighbour: int) -> NDArray[np.uint8]:
        return np.where(self.evidence.scene.mask[frame], np.where(self.given[frame] > 0, 2, 1), 0).astype(np.uint8)

    def predict_part_poses(self, k: int, frame: int, neighbour: int) -> list[Array]:
        ahead = [self.motions[neighbour, k] @ self.Ts[k, neighbour]] if frame > neighbour else []
        return super().predict_part_poses(k, frame, neighbour) + ahead


def solve_joint_under_labels(
    video: PreparedVideo, state: SolverState, settings: ReconstructSettings, rng: np.random.Generator
) -> SolverState:
    """Our joint stage without new labels."""
    return solve_joint(video, state, settings, rng, relabel=False)


def main(sequence: Path, out: Path) -> Reconstruction | Failure:
    """Solve one sequence folder; writes the result folder `out`."""
    recording = read_sequence(sequence)
    solvers = SOLVERS | {"segmentation": solve_segmentation, "joint": solve_joint_under_labels}
    result = reconstruct(recording, SETTINGS, solvers)
    views = ([], []) if isinstance(result, Failure) else render_queries(result, recording, SETTINGS.renders)
    write_result(out, result, {"method": "paper"}, views[0] or None, renders_other=views[1] or None)
    return result


if __name__ == "__main__":
    run_command(main)
