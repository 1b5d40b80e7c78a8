"""Whether learned priors help: matches against the true flow, and solved recordings.

    .venv/bin/python -m benchmarks.priors [--objects stapler slider_phone] [--frames 48] [--solve]

records each object clean, moved by the style `tumble` and by `human`, and asks how far every way of following points
is from the true flow (clean depth carried by the true poses) between frames 3, 10 and 30 apart. A true pixel is one
that is seen in both frames. `dis` is flow between the two frames alone, `chained` flow from frame to frame, which is
what the tracker does; `xfeat` and `lightglue` are matches at keypoints, `+ flow` the flow that starts from them. Flow
counts where its way there and back ends within 1.5 pixels (the tracker's own limit). `right` is the share of what is
given that lies within 3 pixels; `found` the share of the object's true pixels that have a right point within 6 pixels.

`--solve` then solves each object, without Gaussians, with every tracker: clean, noise2, tof and hand moved by
`tumble`, clean moved by `human`, which hides a part for long. `--sensors tof` solves those alone; the file's other rows
stay.

Prints tables, and writes benchmarks/results/priors.json.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.common import RESULTS, ROOT, format_number, make_table, run_cli, wide_console, write_report
from freeart21 import se3
from freeart21.files import checked
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.truth import Truth
from generator.recorder import record
from generator.session import RecordSettings
from leaderboard.sequence_score import score_sequence
from reconstruct.matchers import MATCHERS, Matches, make_matcher
from reconstruct.pipeline import reconstruct_folder
from reconstruct.scene import Scene, prepare_scene
from reconstruct.settings import ReconstructSettings, SceneSettings, TrackSettings
from reconstruct.trackers.dis import Dis
from reconstruct.trackers.matched import matched_flow, round_trip

FILE = "priors.json"
MOTIONS = ("tumble", "human")
CASES = (("human", "clean"), ("tumble", "clean"), ("tumble", "noise2"), ("tumble", "tof"), ("tumble", "hand"))
"""Motion and sensor of the solved recordings."""
TRACKERS = ("dis", "xfeat", "lightglue")
GAPS = (3, 10, 30)
PAIRS = 6
"""Pairs of frames for each gap, evenly spread over the video."""
NEAR = 3.0
"""Pixels up to which a match is right."""
REACH = 6.0
"""Pixels within which a right point speaks for the object's pixels."""


@dataclass(frozen=True)
class MatchRow:
    """How well one way of matching does at one gap."""

    recording: str
    way: str
    gap: int
    given: float
    """Points a pair."""
    right: float
    """Share of them within NEAR."""
    found: float
    """Share of the object's true pixels with a right point within REACH."""
    cpu_s: float
    """Processor seconds a pair. Keypoints are found once a frame: here two frames a pair, but for frames met again."""


def main(
    objects: tuple[str, ...] = ("stapler", "slider_phone"),
    frames: int = 48,
    seed: int = 3,
    solve: bool = False,
    matches: bool = True,
    sensors: tuple[str, ...] = (),
    work: Path = ROOT / "out" / "priors",
    out: Path = RESULTS / FILE,
) -> None:
    """Measure the priors.

    Args:
        objects: Of the catalog.
        frames: Length of each video.
        seed: Of shape, motion and sensor.
        solve: Solve recordings, too: some minutes of processor time each.
        matches: Measure matches; otherwise the file's own stay.
        sensors: Solve recordings of these alone; the file's rows of others stay.
        work: Where recordings are kept.
        out: The JSON file.
    """
    known = checked.read_json(out) if out.is_file() else {}
    found = {"matches": known.get("matches", []), "solved": known.get("solved", [])}
    if matches:
        rows = [row for name in objects for motion in MOTIONS for row in match_rows(name, motion, frames, seed, work)]
        print_matches(rows)
        found["matches"] = [asdict(row) for row in rows]
    if solve:
        chosen = [case for case in CASES if not sensors or case[1] in sensors]
        solved = [row for name in objects for case in chosen for row in solve_rows(name, *case, frames, seed, work)]
        print_solved(solved)
        new = {row.recording for row in solved}
        kept = [row for row in found["solved"] if sensors and row["recording"] not in new]
        found["solved"] = kept + [asdict(row) for row in solved]
    facts = {"objects": objects, "frames": frames, "seed": seed, "near": NEAR, "reach": REACH, "pairs": PAIRS}
    write_report(out, facts, **found)


def recording_of(name: str, motion: str, sensor: str, frames: int, seed: int, work: Path) -> tuple[Path, Path]:
    """Folders of one sequence and its truth, recorded unless they are there."""
    folder = work / f"{name}-{motion}-{sensor}-{frames}"
    if not (folder / "benchmark.json").is_file():
        settings = RecordSettings(frames=frames, motion=motion, sensor=sensor, seed=seed, queries=1)
        record(name, folder, settings)
    sequence = next((folder / "sequences").iterdir()).name
    return folder / "sequences" / sequence, folder / "truth" / sequence


# --- matches against the true flow ------------------------------------------------------------------------------------


def match_rows(name: str, motion: str, frames: int, seed: int, work: Path) -> list[MatchRow]:
    """A row for each way of matching and gap, of one clean recording."""
    sequence, truth = (
        f(p)
        for f, p in zip(
            (read_sequence, read_truth), recording_of(name, motion, "clean", frames, seed, work), strict=True
        )
    )
    scene = prepare_scene(sequence, SceneSettings())
    flow = TrueFlow(scene, truth)
    rows = []
    for way, give in ways(scene).items():
        for gap in GAPS:
            starts = np.unique(np.linspace(0, len(scene) - 1 - gap, PAIRS).astype(int))
            found = [measure(flow, int(a), int(a) + gap, give) for a in starts]
            given, right, covered, cpu = (float(np.mean(column)) for column in zip(*found, strict=True))
            rows.append(MatchRow(f"{name}, {motion}", way, gap, given, right, covered, cpu))
    return rows


Way = Callable[[int, int], Matches]


def ways(scene: Scene) -> dict[str, Way]:
    """The ways of matching two frames."""
    tracker = Dis(scene, TrackSettings())

    def flow_from(matcher: str | None) -> Way:
        found = None if matcher is None else make_matcher(scene, matcher)

        def give(first: int, second: int) -> Matches:
            matches = Matches.none() if found is None else found.match(first, second)
            there = matched_flow(scene, first, second, matches)
            back = matched_flow(scene, second, first, Matches(matches.there, matches.here, matches.confidence))
            at = np.argwhere(scene.valid[first])
            kept = round_trip(there, back)[tuple(at.T)] < tracker.settings.max_round_trip
            here = at[kept][:, ::-1].astype(float)
            return Matches(here, here + there[tuple(at[kept].T)], np.ones(kept.sum()))

        return give

    def chained(first: int, second: int) -> Matches:
        tracks = tracker.follow(first, second - first, pixels=np.argwhere(scene.valid[first]))
        kept = tracks.visible[:, -1]
        return Matches(tracks.pixels[kept, 0], tracks.pixels[kept, -1], tracks.confidence[kept, -1])

    found: dict[str, Way] = {"dis": flow_from(None), "chained": chained}
    for name in MATCHERS:
        found |= {name: make_matcher(scene, name).match, f"{name} + flow": flow_from(name)}
    return found


class TrueFlow:
    """Where points of the object go, by clean depth and true poses; pixels of the scene's crops."""

    def __init__(self, scene: Scene, truth: Truth) -> None:
        self.scene = scene
        self.Ts = np.stack([truth.Ts_camera_reference, truth.Ts_camera_moving], 1)
        h, w = scene.mask.shape[1:]
        steps = scene.factor * np.arange(max(h, w)) + scene.factor // 2
        self.parts = np.zeros(scene.mask.shape, np.uint8)
        for i, (x, y) in enumerate(scene.origin):
            whole = truth.part_mask(i)
            rows, columns = y + steps[:h], x + steps[:w]
            inside = (rows < whole.shape[0])[:, None] & (columns < whole.shape[1])
            self.parts[i] = np.where(
                inside, whole[np.minimum(rows, whole.shape[0] - 1)][:, np.minimum(columns, whole.shape[1] - 1)], 0
            )

    def carry(self, first: int, second: int, at: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Where columns and rows (m, 2) of `first` are in `second`, and whether they are seen in both."""
        scene = self.scene
        x, y = np.rint(at).astype(int).T
        part = self.parts[first, y, x].astype(int)
        point = scene.points[first, y, x].astype(float)
        ray = np.stack(
            [(at[:, 0] - scene.cx[first]) / scene.fx, (at[:, 1] - scene.cy[first]) / scene.fy, np.ones(len(at))], 1
        )
        point = ray * np.maximum(point[:, 2:], 1e-6)
        T = self.Ts[second] @ se3.inverse(self.Ts[first])
        moved = np.take_along_axis(
            np.stack([se3.transform(M, point) for M in T]), np.maximum(part - 1, 0)[None, :, None], 0
        )[0]
        there = np.stack(
            [
                moved[:, 0] / moved[:, 2] * scene.fx + scene.cx[second],
                moved[:, 1] / moved[:, 2] * scene.fy + scene.cy[second],
            ],
            1,
        )
        u, v = np.rint(there).astype(int).T
        seen = (
            (part > 0)
            & scene.valid[first, y, x]
            & (u >= 0)
            & (v >= 0)
            & (u < scene.mask.shape[2])
            & (v < scene.mask.shape[1])
        )
        gap = np.abs(scene.points[second, v[seen], u[seen], 2] - moved[seen, 2])
        seen[seen] &= (self.parts[second, v[seen], u[seen]] == part[seen]) & (gap < 4 * scene.footprint)
        return there, seen


def measure(flow: TrueFlow, first: int, second: int, give: Way) -> tuple[float, float, float, float]:
    """Points given, share of them that are right, share of true pixels found, processor seconds."""
    start = time.process_time()
    matches = give(first, second)
    spent = time.process_time() - start
    pixels = np.argwhere(flow.scene.valid[first])[:, ::-1].astype(float)
    pixels = pixels[flow.carry(first, second, pixels)[1]]
    if not len(matches):
        return 0.0, 0.0, 0.0, spent
    true, seen = flow.carry(first, second, matches.here)
    right = seen & (np.linalg.norm(matches.there - true, axis=1) < NEAR)
    reached = (
        cKDTree(matches.here[right]).query(pixels, distance_upper_bound=REACH)[0]
        if right.any()
        else np.inf + pixels[:, 0]
    )
    return float(len(matches)), float(right.mean()), float(np.isfinite(reached).mean()) if len(pixels) else 0.0, spent


def print_matches(rows: list[MatchRow]) -> None:
    """A table a recording: a line a way, three columns a gap."""
    console = wide_console()
    head = ["way", *(f"{what} at {gap}" for gap in GAPS for what in ("given", "right", "found")), "cpu s"]
    for recording in dict.fromkeys(row.recording for row in rows):
        lines = []
        for way in dict.fromkeys(row.way for row in rows):
            mine = [row for row in rows if (row.recording, row.way) == (recording, way)]
            cells = [cell for row in mine for cell in (f"{row.given:.0f}", f"{row.right:.2f}", f"{row.found:.2f}")]
            lines.append([way, *cells, f"{np.mean([row.cpu_s for row in mine]):.2f}"])
        console.print(make_table(recording, head, lines))


# --- solved recordings ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SolvedRow:
    """One recording, solved with one tracker."""

    recording: str
    tracker: str
    status: str
    joint_type: float | None
    axis: float | None
    state: float | None
    miou: float | None
    """As strict-2 measures them: degrees, degrees or per cent, share."""
    cpu_s: float
    """Processor seconds of the solver."""


def solve_rows(name: str, motion: str, sensor: str, frames: int, seed: int, work: Path) -> Iterator[SolvedRow]:
    """A row for each tracker."""
    sequence, truth = recording_of(name, motion, sensor, frames, seed, work)
    own = ReconstructSettings(progress=False)
    for tracker in TRACKERS:
        settings = replace(
            own, gaussians=replace(own.gaussians, refine=False), tracks=replace(own.tracks, tracker=tracker)
        )
        place = work / "results" / f"{motion}-{sensor}-{tracker}" / sequence.name
        start = time.process_time()
        reconstruct_folder(sequence, place, settings)
        spent = time.process_time() - start
        row = score_sequence(place, sequence, truth, "strict-2")
        figures = (row.values.get(metric) for metric in ("joint_type", "axis", "state", "miou"))
        solved = SolvedRow(f"{name}, {motion}, {sensor}", tracker, row.status, *figures, spent)
        print(solved, flush=True)
        yield solved


def print_solved(rows: list[SolvedRow]) -> None:
    """One line a row."""
    lines = [
        [
            row.recording,
            row.tracker,
            row.status if row.joint_type == 1 else "wrong type",
            *(format_number(value, digits) for value, digits in ((row.axis, 2), (row.state, 2), (row.miou, 3))),
            f"{row.cpu_s:.0f}",
        ]
        for row in rows
    ]
    wide_console().print(
        make_table("solved", ["recording", "tracker", "status", "axis", "state", "mIoU", "cpu s"], lines)
    )


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    run_cli(main)
