"""Runs every long command again and again, told to stop (Ctrl-C) at random moments, and looks at what that leaves.

    python tests/stopped_commands.py FOLDER --moments 20 [--commands record demo ...] [--data DATA --results RESULTS]

DATA and RESULTS (RESULTS/SEQ with its asset) are made, small, in FOLDER when they are not given. Every second signal
goes to the command alone, the others, as from a terminal, to all of its processes; every fourth comes twice. Prints one
JSON list: for every moment, the command, when it was told, its exit code, what it said, how long it took to go, and
what was wrong: not one line, processes or files left, or (once a command) the same command failing when run again.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
SMALL = ["--width", "160", "--height", "120", "--queries", "2", "--shader", "trivial"]


@dataclass(frozen=True)
class Place:
    """Where the inputs are."""

    data: Path
    results: Path
    measured: Path

    @property
    def sequence(self) -> str:
        """The first one."""
        return sorted(path.name for path in (self.data / "sequences").iterdir())[0]


COMMANDS: dict[str, tuple[float, Callable[[Place, Path], list[str]]]] = {
    "record": (9, lambda p, out: ["record", "stapler", "--frames", "60", *SMALL, "--out", f"{out}/data"]),
    "record_lit": (
        12,
        lambda p, out: ["record", "stapler", "--frames", "30", "--queries", "2", "--out", f"{out}/data"],
    ),
    "record_2": (
        20,
        lambda p, out: [
            *("record", "stapler", "flip_lighter", "drawer_unit", "--workers", "2", "--frames", "40"),
            *(*SMALL, "--out", f"{out}/data"),
        ],
    ),
    "demo": (60, lambda p, out: ["demo", "--frames", "20", "--out", f"{out}/demo"]),
    "reconstruct": (
        8,
        lambda p, out: ["reconstruct", f"{p.data}/sequences/{p.sequence}", "--out", f"{out}/r/{p.sequence}"],
    ),
    "export": (12, lambda p, out: ["export", f"{p.results}/{p.sequence}", "--out", f"{out}/asset"]),
    "score": (12, lambda p, out: ["score", f"{p.results}", "--data", f"{p.data}", "--out", f"{out}/scores.json"]),
    "suite": (
        30,
        lambda p, out: ["suite", f"{p.data}", "--rows", "truth", "static", "--workers", "2", "--out", f"{out}/suite"],
    ),
    "gap": (
        8,
        lambda p, out: ["gap", f"{p.measured}/asset", f"{p.measured}/measured", "--out", f"{out}/gap"],
    ),
    "verify": (4, lambda p, out: ["verify", f"{p.data}", "--deep"]),
    "convert": (
        2.5,
        lambda p, out: ["convert", f"{p.data}/sequences/{p.sequence}", "--to", "official", "--out", f"{out}/official"],
    ),
    "measure": (3, lambda p, out: ["measure", f"{p.measured}/films/truth/flip_lighter-s0", "--out", f"{out}/set"]),
    "view": (2, lambda p, out: ["view", f"{p.results}/{p.sequence}", "--out", f"{out}/page.html"]),
}
"""Name to how long it takes at most, seconds, and its arguments."""


def start(arguments: list[str], out: Path) -> subprocess.Popen[str]:
    """A command in a session of its own, with its temporary files in out/tmp."""
    (out / "tmp").mkdir(parents=True, exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", "freeart21", *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(out / "tmp")},
        cwd=out,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def of_session(session: int) -> list[str]:
    """The command lines of the processes of a session that live."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, here = stat.read_text().rpartition(")")[2].split()[:4]
            if int(here) == session and state != "Z":
                found.append((stat.parent / "cmdline").read_text().replace("\0", " ")[:100])
        except OSError:
            continue
    return found


def gone(session: int, patience_s: float = 3.0) -> list[str]:
    """What lives of a session when it has had a moment to end."""
    deadline = time.monotonic() + patience_s
    while (left := of_session(session)) and time.monotonic() < deadline:
        time.sleep(0.1)
    return left


def halves(out: Path) -> list[str]:
    """Files and folders left half-written: but for what a recording is to go on from."""
    bad = []
    for path in out.rglob("*"):
        if {".recording", ".jobs"} & {*path.parts} or path == out / "tmp":
            continue
        if path.name.endswith((".part", ".old", ".lock")) or (out / "tmp") in path.parents:
            bad.append(str(path.relative_to(out)))
    return bad


def stopped(name: str, place: Place, out: Path, after_s: float, to_all: bool, twice: bool) -> dict[str, object]:
    """One moment."""
    running = start(COMMANDS[name][1](place, out), out)
    tell = os.killpg if to_all else os.kill
    wrong: list[str] = []
    try:
        _, errors = running.communicate(timeout=after_s)
        told = False
    except subprocess.TimeoutExpired:
        told = True
        tell(running.pid, signal.SIGINT)
        began = time.monotonic()
        if twice:
            time.sleep(0.1)
            if running.poll() is None:
                tell(running.pid, signal.SIGINT)
        try:
            _, errors = running.communicate(timeout=90)
        except subprocess.TimeoutExpired:
            wrong.append("did not end")
            os.killpg(running.pid, signal.SIGKILL)
            _, errors = running.communicate()
    lines = [line for line in errors.splitlines() if line.strip()]
    if told and running.returncode == 130 and (len(lines) != 1 or not lines[0].startswith("freeart21: stopped")):
        wrong.append("not one line")
    if running.returncode not in ((130, 0) if told else (0, 3)):  # it may have been done when it was told
        wrong.append("exit code")
    if left := gone(running.pid):
        wrong.append(f"left running: {left}")
        os.killpg(running.pid, signal.SIGKILL)
    wrong += [f"left: {name}" for name in halves(out)]
    return {
        "command": name,
        "after_s": round(after_s, 2),
        "told": told,
        "seconds": round(time.monotonic() - began, 2) if told else None,
        "code": running.returncode,
        "said": errors[-2000:] if wrong else (lines or [""])[-1],
        "wrong": wrong,
    }


def again(name: str, place: Place, out: Path) -> list[str]:
    """Run the command to its end where it was stopped; what is wrong then."""
    done = start(COMMANDS[name][1](place, out), out)
    _, errors = done.communicate()
    return [] if done.returncode in (0, 3) else [f"again: exit code {done.returncode}: {errors[-1000:]}"]


def prepared(folder: Path, data: Path | None, results: Path | None, commands: list[str]) -> Place:
    """The inputs of `commands`, made where they are not given."""
    from export.exporter import export_result
    from freeart21.files.result import write_result
    from freeart21.files.sequence import read_sequence
    from freeart21.files.truth import read_truth
    from freeart21.reconstruction import Reconstruction
    from generator.dataset import plan_jobs, record_jobs
    from generator.measure import measure_truths
    from generator.session import RecordSettings

    small = RecordSettings(frames=12, width=160, height=120, queries=2, shader="trivial", edge=0.5)
    place = Place(data or folder / "data", results or folder / "results", folder / "measured")
    if not place.data.is_dir():
        record_jobs(place.data, plan_jobs(["drawer_unit"], small))
    if not place.results.is_dir() and {"export", "score", "view"} & set(commands):
        name = place.sequence
        truth = read_truth(place.data / "truth" / name)
        views = len(read_sequence(place.data / "sequences" / name).queries)
        answer = Reconstruction(
            truth.articulation,
            truth.states,
            truth.Ts_camera_reference,
            truth.Ts_camera_moving,
            np.stack([truth.part_mask(i) for i in range(len(truth))]),
            truth.seen > 0,
        )
        write_result(place.results / name, answer, renders=[truth.query_rgb(i) for i in range(views)])
        export_result(place.results / name, place.results / name / "asset")
    if not place.measured.is_dir() and {"gap", "measure"} & set(commands):
        swung = RecordSettings(
            frames=90, width=160, height=120, queries=0, shader="trivial", edge=0.5, motion="release"
        )
        films = folder / "films"
        record_jobs(films, plan_jobs(["flip_lighter"], swung))
        measure_truths([films / "truth" / "flip_lighter-s0"], place.measured)
        films.rename(place.measured / "films")
    return place


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--moments", type=int, default=20)
    parser.add_argument("--commands", nargs="+", default=list(COMMANDS), choices=list(COMMANDS))
    parser.add_argument("--data", type=Path)
    parser.add_argument("--results", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--no-again", action="store_true", help="do not run the stopped commands to their end")
    given = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's '&' would have the commands ignore it
    folder, rng = given.folder.resolve(), np.random.default_rng(given.seed)
    place = prepared(folder, given.data, given.results, given.commands)
    moments: list[dict[str, object]] = []
    for name in given.commands:
        for k in range(given.moments):
            out = folder / "outs" / name / (str(k) if name not in ("record", "record_lit", "record_2") else "same")
            after_s = float(rng.uniform(0.15, COMMANDS[name][0]))
            moment = stopped(name, place, out, after_s, bool(k % 2), k % 4 == 3)
            moments.append(moment)
            print(json.dumps(moment), file=sys.stderr, flush=True)
            if not moment["told"] and out.name == "same":
                subprocess.run(["rm", "-rf", out], check=True)
        if not given.no_again:
            wrong = again(name, place, out)
            moments.append({"command": name, "again": True, "wrong": wrong})
    print(json.dumps(moments))


if __name__ == "__main__":
    main()
