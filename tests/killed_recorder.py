"""Records a small data set again and again, killed at random moments, and goes on each time until it is whole.

    python tests/killed_recorder.py FOLDER --kills 20 [--objects stapler flip_lighter] [--frames 12] [--seed 0]

FOLDER/whole/data is made without interruption, FOLDER/killed_K/data by recorders that were killed with SIGKILL: half of
them after a random time, half when a random number of files was there. Prints one JSON list: for every kill, what of
the data set stood at that moment. The recorders are forked from one process that has the libraries loaded already.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from freeart21.doctor import require_rendering
from generator import scene
from generator.dataset import Job, plan_jobs, record_jobs
from generator.session import RecordSettings


def load_libraries() -> None:
    """What every recorder would load anew: the simulator, without its renderer, and the compiled loops."""
    import sapien

    assert sapien.__version__
    picture = np.zeros((2, 2, 4), np.float32)
    scene._depth_and_side(picture, picture.astype(np.uint32), np.zeros(2, np.uint8))


def start(data: Path, jobs: list[Job]) -> int:
    """The process id of a recorder that records `jobs` into `data` and ends with 0 when it is done."""
    child = os.fork()
    if child == 0:
        try:
            record_jobs(data, jobs)
        except BaseException as error:
            print(f"the recorder failed: {error!r}", flush=True)
            os._exit(1)
        os._exit(0)
    return child


def finish(data: Path, jobs: list[Job]) -> float:
    """Let a recorder run to its end; seconds it took."""
    began = time.monotonic()
    _, status = os.waitpid(start(data, jobs), 0)
    assert status == 0, status
    return time.monotonic() - began


def count(folder: Path) -> int:
    """Files in a folder, hidden ones too."""
    return sum(len(files) for _, _, files in os.walk(folder))


def killed_at(child: int, data: Path, after_s: float, at_files: float) -> bool:
    """Kill a recorder after a time or when there are so many files; False when it ended by itself before that."""
    deadline = time.monotonic() + after_s
    while time.monotonic() < deadline and count(data) < at_files:
        if os.waitpid(child, os.WNOHANG) != (0, 0):
            return False
        time.sleep(0.005)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--kills-a-folder", type=int, default=5)
    parser.add_argument("--objects", nargs="+", default=["stapler", "flip_lighter"])
    parser.add_argument("--frames", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--track", type=Path, help="a take that is replayed")
    given = parser.parse_args()
    settings = RecordSettings(frames=given.frames, width=160, height=120, queries=2, shader="trivial", edge=0.5)
    if given.track is not None:
        settings = replace(settings, motion="track", track=given.track)
    jobs, rng = plan_jobs(given.objects, settings), np.random.default_rng(given.seed)
    require_rendering()
    load_libraries()
    duration = finish(given.folder / "whole" / "data", jobs)
    most = count(given.folder / "whole" / "data")
    moments: list[dict[str, int]] = []
    folder = 0
    while len(moments) < given.kills:
        if sum(moment["folder"] == folder for moment in moments) == given.kills_a_folder:
            folder += 1
        data = given.folder / f"killed_{folder}" / "data"
        by_time = len(moments) % 2 == 0
        child = start(data, jobs)
        seconds = rng.uniform(0.1, duration) if by_time else np.inf
        files = np.inf if by_time else count(data) + rng.integers(1, max(2, most - count(data)))
        if killed_at(child, data, seconds, files):
            moments.append(
                {
                    "folder": folder,
                    "files": count(data),
                    "frames": len(list(data.glob(".recording/*/side/*.png"))),
                    "sequences": len(list(data.glob("sequences/*"))),
                    "truths": len(list(data.glob("truth/*"))),
                }
            )
        else:
            folder += 1
    for k in range(folder + 1):
        finish(given.folder / f"killed_{k}" / "data", jobs)
    print(json.dumps(moments))


if __name__ == "__main__":
    main()
