"""How fast the recorder is: frames a second beside a bare SAPIEN loop, shaders, workers, and room on disk.

    .venv/bin/python -m benchmarks.record [--objects ...] [--frames 40] [--blocks 6]

prints tables and writes benchmarks/results/record.json (commit, machine, settings, summary, a row an object and kind).

- *film*: the bare loop sets a pose, draws and fetches the three pictures that the recorder needs (Color, Position,
  Segmentation), and throws them away; the recorder's film also turns them into RGB, depth and masks, encodes and writes
  them. Same scene, same shader, same size, one process, in turns of `frames` frames; the first frame of each is left
  out of the time. `share` is the recorder's rate over the bare loop's. Objects are those of most triangles.
- *shader*: milliseconds a frame of the bare loop, and whether the depth is good.
- *whole*: seconds of a whole small data set with 1 worker and with 2, truth and views included, and MB a sequence.
"""

from __future__ import annotations

import os
import platform
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import sapien
import tyro
from rich.console import Console
from rich.table import Table

from freeart21 import catalog, se3
from freeart21.errors import FreeArtError
from freeart21.files.atomic import write_json
from generator.dataset import plan_jobs, record_jobs
from generator.scene import Scene, simulator
from generator.session import RecordSettings, Session, load_object

ROOT = Path(__file__).resolve().parents[1]
SHADERS = ("default", "minimal", "trivial")
_AXES = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # SAPIEN's camera axes from ours


def main(
    objects: tuple[str, ...] = (),
    most: int = 2,
    frames: int = 60,
    blocks: int = 6,
    whole: tuple[str, ...] = ("stapler", "flip_lighter"),
    whole_frames: int = 60,
    out: Path = ROOT / "benchmarks" / "results" / "record.json",
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
        for shader in SHADERS:
            rows.append(_shader(chosen[-1], shader, settings, place / "shader" / shader))
        if whole:
            rows += [_whole(whole, n, RecordSettings(frames=whole_frames), place / f"whole{n}") for n in (1, 2)]
        _print(rows)
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    films, wholes = ([row for row in rows if row["kind"] == kind] for kind in ("film", "whole"))
    write_json(
        out,
        {
            "summary": {
                "share_of_bare_loop": min(row["share"] for row in films),
                "frames_per_s": min(row["frames_per_s"] for row in films),
                "two_workers_speedup": wholes[0]["seconds"] / wholes[1]["seconds"] if wholes else None,
                "mb_per_300_frames": max(row["mb_per_300_frames"] for row in films),
            },
            "rows": rows,
            "commit": commit.stdout.strip(),
            "machine": {
                "processor": platform.machine(),
                "cores": os.cpu_count(),
                "python": platform.python_version(),
                **simulator(),
            },
            "settings": {"frames": frames, "blocks": blocks, "whole": whole, "whole_frames": whole_frames},
        },
    )


def _triangles(name: str, settings: RecordSettings, place: Path) -> int:
    return sum(len(side.surface.faces) for side in load_object(catalog.find(name), settings, place).sides)


def _film(name: str, triangles: int, settings: RecordSettings, work: Path, blocks: int) -> dict[str, Any]:
    """Rates of the bare loop and of the recorder's film, in turns."""
    loaded = load_object(catalog.find(name), settings, work / "object")
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


def _shader(name: str, shader: str, settings: RecordSettings, work: Path) -> dict[str, Any]:
    """Milliseconds a frame of a shader, with the pictures that it has."""
    loaded = load_object(catalog.find(name), settings, work / "object")
    session = Session(loaded, RecordSettings(frames=20), work, lambda done, total: None)
    scene = Scene(loaded.asset.urdf, [s.links for s in loaded.sides], session.camera, 0.01, 10.0, shader)
    wanted = [p for p in ("Color", "Position", "Segmentation", "PositionSegmentation") if _has(scene, p)]
    began = 0.0
    for i in range(20):
        T = _AXES @ session.plan.Ts_camera_object[i]
        scene._object.set_root_pose(sapien.Pose(T[:3, 3].astype(np.float32), se3.wxyz(T).astype(np.float32)))
        scene._scene.update_render()
        scene._view.take_picture()
        kinds = [f"{picture} {scene._view.get_picture(picture).dtype}" for picture in wanted]
        if i == 0:
            began = time.perf_counter()
    return {
        "kind": "shader",
        "object": name,
        "shader": shader,
        "ms_per_frame": 1000 * (time.perf_counter() - began) / 19,
        "pictures": ", ".join(kinds),
    }


def _has(scene: Scene, picture: str) -> bool:
    scene._scene.update_render()
    scene._view.take_picture()
    try:
        scene._view.get_picture(picture)
    except (RuntimeError, IndexError):
        return False
    return True


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
    console = Console()
    for kind in ("film", "shader", "whole"):
        here = [{k: v for k, v in row.items() if k != "kind"} for row in rows if row["kind"] == kind]
        if here:
            table = Table(*here[0], title=kind)
            for row in here:
                table.add_row(*(f"{v:.3g}" if isinstance(v, float) else str(v) for v in row.values()))
            console.print(table)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except FreeArtError as error:
        raise SystemExit(f"record: {error}") from error
