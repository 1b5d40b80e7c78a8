"""What many sequences cost: hours, disk and money, from the measured rates of `leaderboard/suite/rates.json`.

    .venv/bin/python -m benchmarks.scale [--sequences 100000] [--frames 300] [--price 0.04] [--storage 0.02]

prints the tables of docs/scale.md, which a test compares with what stands there.
"""

from __future__ import annotations

from collections.abc import Mapping

from benchmarks.common import run_cli
from freeart21.files.checked import MAX_JSON_BYTES
from leaderboard.suite.rates import Rate, read_rates

STEPS = {
    "record": "record, shader default",
    "record-trivial": "record, shader trivial",
    "reconstruct": "reconstruct, ours",
    "reconstruct-paper": "reconstruct, the paper's segmentation",
    "export": "export",
    "score": "score by strict-2",
}
LISTED_BYTES = 156_156
"""Of benchmark.json a sequence of 300 frames and 20 views: 3,279,283 bytes for the 21 of freeart21-v1."""
LISTED_FILES = 1_347
"""Files a sequence: 28,283 for these 21."""


def hours(rate: Rate, sequences: int, frames: int) -> float:
    """Hours of one worker."""
    return rate.seconds_per_frame * frames * sequences / 3600


def terabytes(rate: Rate, sequences: int, frames: int) -> float:
    """Left on the disk, 1e12 bytes."""
    return rate.bytes_per_frame * frames * sequences / 1e12


def cost_table(rates: Mapping[str, Rate], sequences: int, frames: int, price: float, storage: float) -> list[str]:
    """Markdown: a line a step, at `price` a worker hour and `storage` a gigabyte and month."""
    lines = [
        "| step | s a sequence | MB a sequence | worker hours | TB | days with 64 workers | at p | kept a month at s |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind, what in STEPS.items():
        rate = rates[kind]
        h, tb = hours(rate, sequences, frames), terabytes(rate, sequences, frames)
        lines.append(
            f"| {what} | {rate.seconds_per_frame * frames:.1f} | {rate.bytes_per_frame * frames / 1e6:.2f} | "
            f"{h:,.0f} | {tb:.2f} | {h / 64 / 24:.1f} | {h * price:,.0f} | {tb * 1e3 * storage:,.0f} |"
        )
    return lines


def shards(sequences: int) -> tuple[int, int]:
    """Sequences that one data folder holds at most, and folders for all, at a round number below that."""
    most = MAX_JSON_BYTES // LISTED_BYTES
    return most, -(-sequences // (most // 100 * 100))


def main(sequences: int = 100_000, frames: int = 300, price: float = 0.04, storage: float = 0.02) -> None:
    """Print the tables.

    Args:
        sequences: How many.
        frames: Of each.
        price: p, of a worker's hour: an example, nobody's price.
        storage: s, of a gigabyte kept for a month: an example, nobody's price.
    """
    print("\n".join(cost_table(read_rates(), sequences, frames, price, storage)))
    most, folders = shards(sequences)
    files = LISTED_FILES * sequences / 1e6
    print(f"\nat most {most} sequences a data folder; {folders} folders; {files:.0f} million files")


if __name__ == "__main__":
    run_cli(main)
