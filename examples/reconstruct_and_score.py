"""Reconstruct what record.py made, and score it: `python examples/reconstruct_and_score.py OUT`, with the same OUT."""

import sys
from pathlib import Path

from freeart21.reconstruction import Failure
from leaderboard.rows import Row
from leaderboard.score import score_results
from reconstruct.pipeline import reconstruct_folder
from reconstruct.settings import GaussianSettings, ReconstructSettings

QUICK = ReconstructSettings(gaussians=GaussianSettings(refine=False))
"""Geometry alone, for a quick look: without the Gaussians."""


def main(out: Path) -> tuple[Row, ...]:
    """Solve every sequence of OUT/data from its video alone, then hold the answers to the truth."""
    for sequence in sorted((out / "data" / "sequences").iterdir()):
        answer = reconstruct_folder(sequence, out / "results" / "ours" / sequence.name, QUICK)
        if isinstance(answer, Failure):
            print(f"{sequence.name}: failed in {answer.stage}: {answer.reason}")
        else:
            print(f"{sequence.name}: a {answer.articulation.joint.type} joint, seen in {len(answer)} frames")
    scores = score_results(out / "results" / "ours", out / "data")
    for row in scores.rows:  # a sequence without an answer is a row, too, at the price of a failure
        values = ", ".join(f"{name} {value:.3g}" for name, value in row.values.items() if value is not None)
        print(f"{row.sequence} by {scores.protocol}: {row.status}; {values}")
    return scores.rows


if __name__ == "__main__":
    main(Path(sys.argv[1]))
