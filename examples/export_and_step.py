"""Export the answers of reconstruct_and_score.py and let them move: `python examples/export_and_step.py OUT`."""

import sys
from pathlib import Path

from export.exporter import export_result
from export.settings import CollisionSettings, ExportSettings, MeshSettings
from generator.simulate import load

ROUGH = CollisionSettings(tolerance_m=0.02, pairs=4_000)
QUICK = ExportSettings(collision=ROUGH, meshes=MeshSettings(points=6_000))
"""Rough contact, and parts closed with a quarter of the points, for a quick look."""


def main(out: Path) -> list[float]:
    """Write the answer as an asset, load it in SAPIEN, and watch half a second. Returns the joint's positions."""
    result = next((out / "results" / "ours").glob("*/prediction.json")).parent
    asset = export_result(result, result / "asset", QUICK)
    simulated, course = load(asset, timestep_s=1e-3), []
    simulated.set_state(0.5 * (simulated.lower + simulated.upper), 1.0)  # half open, and pushed; its damping is a guess
    for step in range(500):
        simulated.step()
        course.append(simulated.state()[0])
        if step % 100 == 0:
            print(f"{asset.urdf.name}, {simulated.time_s:.1f} s: joint '{asset.joint}' at {course[-1]:.3f}")
    return course


if __name__ == "__main__":
    main(Path(sys.argv[1]))
