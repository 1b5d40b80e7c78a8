"""Export the answers of reconstruct_and_score.py and let them move: `python examples/export_and_step.py OUT`."""

import sys
from pathlib import Path

from export.exporter import export_result
from generator.simulate import load


def main(out: Path) -> dict[str, list[float]]:
    """Write each answer as an asset, load it in SAPIEN, and watch half a second. Returns every asset's positions."""
    courses = {}
    for result in sorted((out / "results" / "ours").glob("*/prediction.json")):
        folder = result.parent / "asset"
        asset = export_result(result.parent, folder, replace_old=True)
        simulated = load(asset, timestep_s=1e-3)
        simulated.set_state(0.5 * (simulated.lower + simulated.upper))  # half open, at rest; gravity does the rest
        course = []
        for step in range(500):
            if step % 100 == 0:
                print(
                    f"{asset.urdf.name}, {simulated.time_s:.1f} s: joint '{asset.joint}' at {simulated.state()[0]:.3f}"
                )
            simulated.step()
            course.append(simulated.state()[0])
        courses[result.parent.name] = course
    return courses


if __name__ == "__main__":
    main(Path(sys.argv[1]))
