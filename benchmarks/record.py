"""How fast the recorder is: frames a second beside a bare SAPIEN loop, workers, and room on disk.

    .venv/bin/python -m benchmarks.record [--objects ...] [--frames 40] [--blocks 6]

prints tables and writes benchmarks/results/record.json (commit, machine, settings, summary, a row an object and kind).

- *film*: the bare loop sets a pose, draws and fetches the three pictures that the recorder needs (Color, Position,
  Segmentation), and throws them away; the recorder's film also turns them into RGB, depth and masks, encodes and writes
  them. Same scene, same shader, same size, one process, in turns of `frames` frames; the first frame of each is left
  out of the time. `share` is the recorder's rate over the bare loop's. Objects are those of most triangles.
- *whole*: seconds of a whole small data set with 1 worker and with 2, truth and views included, and MB a sequence.
"""

from __future__ import annotations

import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import sapien

from benchmarks.common import RESULTS, print_table, run_cli, write_report
from freeart21 import catalog, se3
from generator.dataset import plan_jobs, record_jobs
from generator.object_source import find_object
from generator.scene import simulator
from generator.session import RecordSettings, Session

_AXES = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # SAPIEN's camera axes from ours


def main(
    objects: tuple[str, ...] = (),
    most: int = 2,
    frames: int = 60,
    blocks: int = 6,
    whole: tuple[str, ...] = ("stapler", "flip_lighter"),
    whole_frames: int = 60,
    out: Path = RESULTS / "record.json",
) -> None:
    """Measure the recorder.

    Args:
        objects: Objects to film; none takes the `most` built-in ones with the most triangles.
        most: How many of those.
        frames: Frames a block.
        blocks: Blocks of each kind, in turns.
        whole: Objects of the small data set that is recorded with 1 and with 2 workers; none leaves it out.
        whole_frames: Frames of each of its sequences.
        out: The JSON file.
    """
    settings = RecordSettings(frames=frames)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="freeart21-") as folder:
        place = Path(folder)
        triangles = {
            name: _triangles(name, settings, place / "look" / name) for name in objects or catalog.built_in_names()
        }
        chosen = objects or tuple(sorted(triangles, key=triangles.__getitem__)[-most:])
        for name in chosen:
            rows.append(_film(name, triangles[name], settings, place / "film" / name, blocks))
        if whole:
            rows += [_whole(whole, n, RecordSettings(frames=whole_frames), place / f"whole{n}") for n in (1, 2)]
        _print(rows)
    films, wholes = ([row for row in rows if row["kind"] == kind] for kind in ("film", "whole"))
    write_report(
        out,
        {"frames": frames, "blocks": blocks, "whole": whole, "whole_frames": whole_frames, **simulator()},
        summary={
            "share_of_bare_loop": min(row["share"] for row in films),
            "frames_per_s": min(row["frames_per_s"] for row in films),
            "two_workers_speedup": wholes[0]["seconds"] / wholes[1]["seconds"] if wholes else None,
            "mb_per_300_frames": max(row["mb_per_300_frames"] for row in films),
        },
        rows=rows,
    )


def _triangles(name: str, settings: RecordSettings, place: Path) -> int:
    return sum(len(side.surface.faces) for side in find_object(name, settings).load(place).sides)


def _film(name: str, triangles: int, settings: RecordSettings, work: Path, blocks: int) -> dict[str, Any]:
    """Rates of the bare loop and of the recorder's film, in turns."""
    loaded = find_object(name, settings).load(work / "object")
    session = Session(loaded, settings, work, lambda done, total: None)
    bare, film = [], []
    size = 0
    _bare(session)  # shaders are compiled, kernels loaded
    for block in range(blocks + 1):
        bare_s = _bare(session)
        clock = _Clock(session)
        session.film()
        film_s = time.perf_counter() - clock.began
        size = sum(path.stat().st_size for path in work.rglob("*.png") if "object" not in path.parts)
        for sub in ("sequence", "side"):
            shutil.rmtree(work / sub)
        if block > 0:  # the first of both is a rehearsal
            bare.append((settings.frames - 1) / bare_s)
            film.append((settings.frames - 1) / film_s)
    shares = [f / b for f, b in zip(film, bare, strict=True)]
    return {
        "kind": "film",
        "object": name,
        "triangles": triangles,
        "bare_frames_per_s": statistics.median(bare),
        "frames_per_s": statistics.median(film),
        "share": statistics.median(shares),
        "lowest_share": min(shares),
        "highest_share": max(shares),
        "mb_per_300_frames": size / 1e6 * 300 / settings.frames,
    }


class _Clock:
    """Starts when the first frame of a film has been drawn."""

    def __init__(self, session: Session) -> None:
        self.began = 0.0
        sensor = session.sensor
        own = type(sensor).shoot

        def shoot(i: int) -> Any:
            shot = own(sensor, i)
            if i == 0:
                self.began = time.perf_counter()
            return shot

        sensor.shoot = shoot  # type: ignore[method-assign]


def _bare(session: Session) -> float:
    """Seconds of all frames but the first, with nothing but SAPIEN's own calls in the loop."""
    scene = session.scene
    view, world, body = scene._view, scene._scene, scene._object
    names = [joint.name for joint in body.active_joints]
    roots, positions = [], []
    for T, state in zip(session.plan.Ts_camera_object, session.plan.states, strict=True):
        U = _AXES @ T
        roots.append(sapien.Pose(U[:3, 3].astype(np.float32), se3.wxyz(U).astype(np.float32)))
        at = {**session.loaded.asset.held, session.loaded.joint.name: float(state)}
        positions.append(np.array([at.get(name, 0.0) for name in names], np.float32))
    began = 0.0
    for i, (root, q) in enumerate(zip(roots, positions, strict=True)):
        body.set_root_pose(root)
        body.set_qpos(q)
        world.update_render()
        view.take_picture()
        for picture in ("Color", "Position", "Segmentation"):
            view.get_picture(picture)
        if i == 0:
            began = time.perf_counter()
    return time.perf_counter() - began


def _whole(names: tuple[str, ...], workers: int, settings: RecordSettings, data: Path) -> dict[str, Any]:
    """Seconds and room of a whole data set; every worker has to start and to compile the shaders, too."""
    jobs = plan_jobs(names, settings)
    began = time.perf_counter()
    record_jobs(data, jobs, workers)
    seconds = time.perf_counter() - began
    size = sum(path.stat().st_size for path in data.rglob("*") if path.is_file())
    return {
        "kind": "whole",
        "workers": workers,
        "sequences": len(jobs),
        "seconds": seconds,
        "mb_per_sequence": size / 1e6 / len(jobs),
    }


def _print(rows: list[dict[str, Any]]) -> None:
    for kind in ("film", "whole"):
        here = [{k: v for k, v in row.items() if k != "kind"} for row in rows if row["kind"] == kind]
        if here:
            cells = [[f"{v:.3g}" if isinstance(v, float) else v for v in row.values()] for row in here]
            print_table(kind, list(here[0]), cells)


if __name__ == "__main__":
    run_cli(main)
