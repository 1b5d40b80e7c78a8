"""How people move articulated objects, beside our scripted styles: the same figures of both.

    .venv/bin/python -m benchmarks.motion_styles [--mocap FOLDER] [--seeds 2] [--fitted]

measures takes of ARCTIC's motion capture (SUBJECT_OBJECT_use_TAKE.object.npy; people use an object, its joint too) and
every scripted style on an object of each category, in stretches of 300 frames at 30 a second. The style `human` draws
from the takes of the subjects in `DRAWN_FROM`; the others are held out, and the table says which of its figures lie
within the middle nine tenths of theirs. `--fitted` prints what the style draws from (`generator/motion/human_hand.py`),
measured anew. Written to benchmarks/results/motion_styles.json: figures only, nothing of the data.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from benchmarks.common import RESULTS, ROOT, make_table, run_cli, write_report
from freeart21 import catalog, sphere
from freeart21.errors import FreeArtError
from freeart21.files.take import Take
from freeart21.formats.captured import read_track
from freeart21.se3 import Array
from freeart21.submovements import Movement, find_submovements
from generator.motion.body import Body
from generator.session import RecordSettings, load_object, plan_recording

SCHEMA = "freeart21/benchmark-motion-styles/1"
SHARED = ROOT.parent / "shared"
FRAMES = 300
"""Of a stretch: as many as a sequence has by default."""
STYLES = ("tumble", "inspect", "wave", "turntable", "static_base", "human")
DRAWN_FROM = ("s1", "s4")
"""Subjects whose takes `human` draws from; those of all others are held out."""
DIAGONALS = {"laptop": 0.388, "mixer": 0.321, "ketchup": 0.239}
"""Of the objects that were moved, m: of their meshes' boxes, as their URDFs have them."""
WORKED = 0.5
"""Share of the take's range that the joint must pass in a stretch: what is not worked is no motion of a joint."""

FIGURES = {
    "median_degrees": "turn a frame, deg: median",
    "p90_degrees": "90th percentile",
    "p99_degrees": "99th percentile",
    "max_degrees": "largest",
    "median_shift": "shift a frame, % of the diagonal: median",
    "p90_shift": "90th percentile",
    "max_shift": "largest",
    "pose_rests": "share of frames: object at rest",
    "joint_rests": "joint at rest",
    "both_rest": "both at rest",
    "hold_s": "rest of the object, s: median",
    "longest_hold_s": "longest",
    "joint_hold_s": "rest of the joint, s: median",
    "longest_joint_hold_s": "longest",
    "sweeps": "a minute: sweeps of 5 deg or more",
    "regrasps": "of these, rest in between",
    "sweep_degrees": "a sweep, deg: median",
    "p90_sweep_degrees": "90th percentile",
    "sweep_s": "its time, s: median",
    "joint_strokes": "a minute: submovements of the joint",
    "reversals": "turned round",
    "joint_way": "a joint's stroke, % of the range: median",
    "joint_stroke_s": "its time, s: median",
    "together": "object moves while the joint does, times usual",
    "speed_correlation": "correlation of their speeds",
    "smoothness": "spectral arc length",
    "coverage": "views covered, %",
}


@dataclass(frozen=True)
class Stretch:
    """Some frames of a motion."""

    source: str
    """A style, or a take's file."""
    movement: Movement
    views: Array
    """(n, 3) unit vectors from the object to the camera."""


def main(
    mocap: Path = SHARED / "mocap",
    seeds: int = 2,
    fitted: bool = False,
    out: Path = RESULTS / "motion_styles.json",
) -> None:
    """Measure takes and styles.

    Args:
        mocap: Folder of captured motion.
        seeds: Of every style and object.
        fitted: Print what `human` draws from, measured in the takes of its subjects, and do no more.
        out: The JSON file.
    """
    takes = [read_track(path) for path in sorted(mocap.glob("*_use_*.object.npy"))]
    if not takes:
        raise FreeArtError(f"{mocap} holds no take, expected SUBJECT_OBJECT_use_TAKE.object.npy")
    if fitted:
        print("\n".join(f"{name} = {value}" for name, value in fit_draws(takes).items()))
        return
    groups: dict[str, list[Stretch]] = {"drawn from": [], "held out": []}
    for take in takes:
        groups["drawn from" if subject(take) in DRAWN_FROM else "held out"] += stretches(take)
    for style in STYLES:
        groups[style] = list(record_scripted(style, range(seeds)))
    tables = {name: {key: spread(values) for key, values in columns(group).items()} for name, group in groups.items()}
    inside = {key: within(tables["human"][key], tables["held out"][key]) for key in FIGURES}
    _print(tables, inside, {name: len(group) for name, group in groups.items()})
    write_report(
        out,
        {"frames": FRAMES, "seeds": seeds, "drawn_from": DRAWN_FROM, "worked": WORKED},
        schema=SCHEMA,
        takes={name: sorted({s.source for s in groups[name]}) for name in ("drawn from", "held out")},
        stretches={name: len(group) for name, group in groups.items()},
        figures=FIGURES,
        spread=tables,
        human_median_within_held_out=inside,
        human_within_held_out=share_within(groups["human"], groups["held out"]),
    )


# --- takes and plans --------------------------------------------------------------------------------------------------


def subject(take: Take) -> str:
    """Who moved the object."""
    return take.name.split("_")[0]


def of_take(take: Take) -> Movement:
    """A whole take."""
    places = take.Ts[:, :3, 3] / DIAGONALS[take.name.split("_")[1]]
    opening = (take.states - take.states.min()) / np.ptp(take.states)
    return Movement.of(take.Ts[:, :3, :3], places, opening, 1 / float(np.median(np.diff(take.times))))


def stretches(take: Take) -> Iterator[Stretch]:
    """Those of `FRAMES` frames, one after the other from the first, in which the joint is worked."""
    for first in range(0, len(take.times) - FRAMES + 1, FRAMES):
        part = slice(first, first + FRAMES)
        if np.ptp(take.states[part]) < WORKED * np.ptp(take.states):
            continue
        places = take.Ts[part, :3, 3] / DIAGONALS[take.name.split("_")[1]]
        shares = (take.states[part] - take.states.min()) / np.ptp(take.states)
        yield Stretch(take.name, Movement.of(take.Ts[part, :3, :3], places, shares, 30.0), -take.Ts[part, 2, :3])


def record_scripted(style: str, seeds: range) -> Iterator[Stretch]:
    """The plans of a style for the first object of every category."""
    first = {catalog.find(name).category: name for name in reversed(catalog.built_in_names())}
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        for name in first.values():
            for seed in seeds:
                settings = RecordSettings(frames=FRAMES, seed=seed, motion=style)
                loaded = load_object(catalog.find(name), settings, Path(place) / str(seed))
                body = Body.of((loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()), loaded.joint)
                plan = plan_recording(loaded, settings)[1]
                Rs, centre = plan.Ts_camera_object[:, :3, :3], body.centre
                places = (plan.Ts_camera_object[:, :3, 3] + Rs @ centre) / (2 * body.radius)
                opening = (plan.states - body.lower) / (body.upper - body.lower)
                views = sphere.view_directions(plan.Ts_camera_object, centre)
                yield Stretch(style, Movement.of(Rs, places, opening, settings.fps), views)


# --- figures ----------------------------------------------------------------------------------------------------------


def figures(stretch: Stretch) -> dict[str, float]:
    """The `FIGURES` of a stretch; NaN where there is nothing to measure."""
    m = stretch.movement
    joint = np.abs(np.diff(m.opening))
    sweeps_s, submovements_s = (np.diff(s, axis=1)[:, 0] / m.fps for s in (m.sweeps, m.joint_submovements))
    known = m.degrees.std() > 0 and joint.std() > 0
    return {
        "median_degrees": float(np.median(m.degrees)),
        "p90_degrees": float(np.percentile(m.degrees, 90)),
        "p99_degrees": float(np.percentile(m.degrees, 99)),
        "max_degrees": float(m.degrees.max()),
        "median_shift": 100 * float(np.median(m.shifts)),
        "p90_shift": 100 * float(np.percentile(m.shifts, 90)),
        "max_shift": 100 * float(m.shifts.max()),
        "pose_rests": float(np.mean(~m.pose_moves)),
        "joint_rests": float(np.mean(~m.joint_moves)),
        "both_rest": float(np.mean(~m.pose_moves & ~m.joint_moves)),
        "hold_s": _middle(m.holds_s),
        "longest_hold_s": float(m.holds_s.max(initial=0.0)),
        "joint_hold_s": _middle(m.joint_holds_s),
        "longest_joint_hold_s": float(m.joint_holds_s.max(initial=0.0)),
        "sweeps": m.sweeps_a_minute,
        "regrasps": m.regrasps_a_minute,
        "sweep_degrees": _middle(m.sweep_degrees),
        "p90_sweep_degrees": _middle(m.sweep_degrees, 90),
        "sweep_s": _middle(sweeps_s),
        "joint_strokes": m.joint_submovements_a_minute,
        "reversals": m.reversals_a_minute,
        "joint_way": 100 * _middle(np.abs(m.joint_ways)),
        "joint_stroke_s": _middle(submovements_s),
        "together": m.together,
        "speed_correlation": float(np.corrcoef(m.degrees, joint)[0, 1]) if known else float("nan"),
        "smoothness": m.smoothness,
        "coverage": 100 * sphere.coverage(stretch.views),
    }


def columns(group: list[Stretch]) -> dict[str, Array]:
    """Figure to its values over stretches, those known."""
    rows = [figures(stretch) for stretch in group]
    return {key: np.array([row[key] for row in rows if np.isfinite(row[key])]) for key in FIGURES}


def spread(values: Array) -> list[float] | None:
    """5th percentile, median, 95th; None where there is nothing."""
    return [float(v) for v in np.percentile(values, [5, 50, 95])] if len(values) else None


def within(own: list[float] | None, others: list[float] | None) -> bool | None:
    """Whether the median of one lies in the middle nine tenths of the other."""
    return None if own is None or others is None else others[0] <= own[1] <= others[2]


def share_within(group: list[Stretch], others: list[Stretch]) -> dict[str, float | None]:
    """Figure to the share of a group's stretches that lie in the middle nine tenths of others."""
    own, known = columns(group), columns(others)
    found: dict[str, float | None] = {}
    for key in FIGURES:
        ends = spread(known[key])
        inside = (own[key] >= ends[0]) & (own[key] <= ends[2]) if ends and len(own[key]) else None
        found[key] = None if inside is None else float(inside.mean())
    return found


def _middle(values: Array, percent: float = 50) -> float:
    return float(np.percentile(values, percent)) if len(values) else float("nan")


# --- what `human` draws from ------------------------------------------------------------------------------------------


def law(x: Array, y: Array) -> str:
    """The law of y by x, by least squares, as `human_hand` writes it."""
    about = float(np.log(x).mean())
    slope, at = np.polyfit(np.log(x) - about, np.log(y), 1)
    spread = np.std(np.log(y) - at - slope * (np.log(x) - about))
    return f"Law({at:.2f}, {slope:.2f}, {about:.2f}, {spread:.2f})"


def fit_draws(takes: list[Take]) -> dict[str, str]:
    """The measures that `generator/motion/human_hand.py` holds, of the takes of `DRAWN_FROM`, as it writes them."""
    moves = [of_take(take) for take in takes if subject(take) in DRAWN_FROM]
    sweeps = [np.log(m.sweep_degrees) for m in moves if len(m.sweeps) > 2]
    degrees = np.exp(np.concatenate(sweeps))
    seconds = np.concatenate([np.diff(m.sweeps, axis=1)[:, 0] / m.fps for m in moves if len(m.sweeps) > 2])
    ways = np.concatenate([[m.shifts[a:b].sum() for a, b in m.sweeps] for m in moves if len(m.sweeps) > 2])
    gaps = np.concatenate([(m.sweeps[1:, 0] - m.sweeps[:-1, 1]) / m.fps for m in moves])
    bends = np.concatenate([_bends(m) for m in moves])
    shares = np.concatenate([np.abs(m.joint_ways) for m in moves])
    joint_s = np.concatenate([np.diff(m.joint_submovements, axis=1)[:, 0] / m.fps for m in moves])
    rests = np.concatenate([(m.joint_submovements[1:, 0] - m.joint_submovements[:-1, 1]) / m.fps for m in moves])
    turned = np.concatenate([np.diff(np.sign(m.joint_ways)) != 0 for m in moves])
    holds = [m.degrees[~m.pose_moves] for m in moves]
    still = [m.shifts[~m.pose_moves] for m in moves]
    puts = [len(find_submovements(np.where(m.pose_moves, 0.0, 1.0), 0.5)) for m in moves]
    begins, ends = (np.concatenate([m.opening[m.joint_submovements[:, k]] for m in moves]) for k in (0, 1))
    room, left = (np.where(ends > begins, 1 - at, at) for at in (begins, ends))
    to_end, far = left < 0.1, room >= 0.8
    part = 1 - (left / room)[~to_end]
    return {
        "SWEEP_DEGREES": f"({np.mean([s.mean() for s in sweeps]):.2f}, {np.std([s.mean() for s in sweeps]):.2f}, "
        f"{np.sqrt(np.mean([s.var() for s in sweeps])):.2f})",
        "SWEEP_SECONDS": law(degrees, seconds),
        "SWEEP_WAY": law(degrees, np.maximum(ways, 1e-3)),
        "AT_ONCE": f"{np.mean(gaps <= 0.1):.2f}",
        "PAUSE_SECONDS": _log(gaps[gaps > 0.1]),
        "ON, BACK": f"{np.mean(bends > 0.5):.2f}, {np.mean(bends < -0.5):.2f}",
        "TO_END": f"({np.mean(to_end[far]):.2f}, {np.mean(to_end[~far]):.2f})",
        "PARTWAY": f"({np.percentile(part, 5):.2f}, {np.percentile(part, 95):.2f})",
        "JOINT_SECONDS": law(shares, joint_s),
        "JOINT_AT_ONCE": f"{np.mean(rests <= 0.1):.2f}",
        "JOINT_REST_SECONDS": _log(rests[rests > 0.1]),
        "TURNED_ROUND": f"{np.mean(turned):.2f}",
        "HELD_DEGREES": f"{np.median(np.concatenate(holds)):.3f}",
        "HELD_SHIFT": f"{np.median(np.concatenate(still)):.5f}",
        "rests_a_minute": f"{np.sum(puts) / sum(len(m.degrees) for m in moves) * 1800:.1f}",
        "together": f"{np.nanmedian([m.together for m in moves]):.2f}",
    }


def _bends(m: Movement) -> Array:
    """Cosines of the directions of sweeps next to each other."""
    turns = np.array([m.turns[a:b].sum(0) for a, b in m.sweeps]).reshape(-1, 3)
    turns /= np.maximum(np.linalg.norm(turns, axis=1, keepdims=True), 1e-9)
    return np.asarray((turns[1:] * turns[:-1]).sum(1))


def _log(values: Array) -> str:
    return f"({np.log(values).mean():.2f}, {np.log(values).std():.2f})"


# --- tables -----------------------------------------------------------------------------------------------------------


def _print(tables: dict[str, dict[str, list[float] | None]], inside: dict[str, bool | None], n: dict[str, int]) -> None:
    head = ["median (5 to 95 %)", *(f"{name}, {n[name]}" for name in tables), "human in held out"]
    rows = []
    for key, label in FIGURES.items():
        cells = [_cell(row[key], name not in STYLES or name == "human") for name, row in tables.items()]
        rows.append([label, *cells, {True: "yes", False: "NO", None: "-"}[inside[key]]])
    Console(width=220).print(make_table("", head, rows, texts=head[1:]))


def _cell(values: list[float] | None, wide: bool) -> str:
    if values is None:
        return "-"
    low, middle, high = (f"{v:.3g}" for v in values)
    return f"{middle} ({low} to {high})" if wide else middle


if __name__ == "__main__":
    run_cli(main)
