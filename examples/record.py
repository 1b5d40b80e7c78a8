"""Record a folding lighter in the simulator: `python examples/record.py OUT` fills OUT/data.

OUT/data/sequences holds all that a method may see, OUT/data/truth what only the scorer reads.
"""

import sys
from pathlib import Path

from generator.recorder import RecordSettings, record

SETTINGS = RecordSettings(frames=20, seed=5, width=256, height=144, queries=2, shader="trivial")
"""Small and unlit, for a quick look; `RecordSettings()` records 300 frames of 640 x 360."""


def main(out: Path) -> str:
    """Record one object; a recording that is there already is left as it is. Returns the sequence's name."""
    sequence = record("flip_lighter", out / "data", SETTINGS)
    print(f"{out / 'data' / 'sequences' / sequence}: {SETTINGS.frames} frames")
    return sequence


if __name__ == "__main__":
    main(Path(sys.argv[1]))
