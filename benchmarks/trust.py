"""Does an answer say whether to trust it? Good and bad videos, solved, judged by their own signs and by the truth.

    .venv/bin/python -m benchmarks.trust [--partnet-root /data/partnet_mobility]
    .venv/bin/python -m benchmarks.trust --answers out/reconstruct/public/results/ours --data out/freeart21-v1

records what is missing of the videos, solves each that was not solved, asks the answer's own signs (`freeart21.trust`)
and the truth (strict-1, from the files), prints the table and writes benchmarks/results/trust.json: how many wrong
answers are doubted, how many are not, and how many right ones are doubted all the same; and which share of the errors
of axis, pivot and states is within k of the standard deviations that the right answers give them (`WITHIN`). Videos of
PartNet-Mobility objects are left out without --partnet-root. The surfaces of right answers that are sound are then
spoilt, a part and a fault at a time (`FAULTS`), and judged again.

With --answers, those of somebody's results folder are judged instead, from their files, and trust_answers.json is
written.

An answer is WRONG when it names the other joint type, when its axis is 5 degrees or its pivot 5 % of the diagonal off,
when its states are off by a tenth of their range on average, when the Chamfer distance of a part is over 1 % of the
diagonal, or when two joints moved and it tells of one.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from benchmarks.common import RESULTS, ROOT, format_number, print_table, run_cli, write_report
from freeart21.articulation import PARTS
from freeart21.errors import FreeArtError
from freeart21.files.benchmark import read_benchmark
from freeart21.files.diagnostics import read_diagnostics
from freeart21.files.result import read_result
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Reconstruction, describe_trust
from freeart21.trust import judge, object_size
from freeart21.truth import Truth
from generator import sensor, session
from generator.motion import Plan
from generator.recorder import record
from generator.sensor import Sensor
from generator.session import RecordSettings
from leaderboard.protocol import Case
from leaderboard.protocols.strict import Strict, measure
from reconstruct import VERSION
from reconstruct.pipeline import reconstruct_folder
from reconstruct.scene import prepare_scene
from reconstruct.settings import GaussianSettings, ReconstructSettings, SceneSettings
from reconstruct.surface_check import check_surfaces
from reconstruct.surfaces import vertex_normals

WRONG_AXIS_DEG, WRONG_PIVOT_PERCENT, WRONG_STATES, WRONG_SURFACE_PERCENT = 5.0, 5.0, 0.1, 1.0
"""An answer that is farther off is wrong; states by this share of their range, surfaces by the share of the diagonal
within which strict-1's F-score counts a point as met."""
WITHIN = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
"""Standard deviations k of the calibration curve. Normal errors: 38, 68, 87, 95, 99 and 100 % are within."""
VALUES = ("joint_type", "axis", "position", "state", "miou", "chamfer_s", "chamfer_m")
"""What is asked of strict-1."""


@dataclass(frozen=True)
class Video:
    """One recording: an object of the catalog or of PartNet-Mobility, and what is done to its scripted motion."""

    name: str
    object: str
    seed: int
    sensor: str = "clean"
    frames: int = 48
    joint: str | None = None
    """The scored one of a PartNet-Mobility object of several."""
    partnet: bool = False
    share: float = 1.0
    """Of its range, about its middle, that the joint moves over."""
    every: int = 1
    """Only every so many frames of a longer plan are filmed: all moves so much faster."""
    second_joint: tuple[str, float, float] | None = None
    """A joint that moves, too, and between which positions, rad or m."""
    held_out: bool = False
    """Not looked at when the signs were made."""


VIDEOS = (
    Video("stapler", "stapler", 1),
    Video("tilt_monitor", "tilt_monitor", 2),
    Video("drawer_unit", "drawer_unit", 3),
    Video("flip_lighter-noise2", "flip_lighter", 4, "noise2"),
    Video("slider_phone-tof", "slider_phone", 5, "tof"),
    Video("office_scissors", "office_scissors", 6),
    Video("long_arm_stapler-hand", "long_arm_stapler", 7, "hand"),
    Video("folding_display", "folding_display", 8),
    Video("faucet-hand", "1488", 1, "hand", partnet=True),
    Video("fan", "101450", 1, partnet=True),
    Video("bucket", "448", 1, partnet=True),
    Video("two_doors", "9128", 1, joint="joint_1", partnet=True, second_joint=("joint_2", 0.0, 1.2)),
    Video("door_and_drawer", "40147", 1, joint="joint_0", partnet=True, second_joint=("joint_1", 0.0, 0.5)),
    Video("hinge-4percent", "stapler", 11, share=0.04),
    Video("slide-4percent", "drawer_unit", 12, share=0.04),
    Video("hinge-fast", "office_scissors", 13, frames=20, every=8),
    Video("slide-fast", "nightstand", 14, frames=20, every=8),
    # the thresholds of freeart21.trust were set by those above, without these
    Video("mini_stapler", "mini_stapler", 21, held_out=True),
    Video("keyboard_phone", "keyboard_phone", 22, held_out=True),
    Video("swivel_usb-blur", "swivel_usb", 23, "blur", held_out=True),
    Video("craft_scissors", "craft_scissors", 24, held_out=True),
    Video("kettle", "1305", 21, partnet=True, held_out=True),
    Video(
        "door_and_drawer_2",
        "45940",
        21,
        joint="joint_0",
        partnet=True,
        second_joint=("joint_2", 0.0, 0.5),
        held_out=True,
    ),
    Video("two_drawers", "41083", 21, joint="joint_2", partnet=True, second_joint=("joint_3", 0.0, 0.5), held_out=True),
    Video("phone-4percent", "slider_phone", 25, share=0.04, held_out=True),
    Video("stapler-fast", "stapler", 26, frames=20, every=8, held_out=True),
    Video("drawer_unit-phone", "drawer_unit", 27, "phone", held_out=True),
    Video("slider_phone-phone", "slider_phone", 28, "phone", held_out=True),
)


def _half(mesh: Mesh) -> Mesh:
    """What lies beyond the median along its longest side."""
    longest = int(np.argmax(np.ptp(mesh.vertices, axis=0)))
    along = mesh.vertices[mesh.faces].mean(1)[:, longest]
    return mesh.with_faces(along > np.median(along))


def _near_joint(mesh: Mesh, joint: Joint, share: float) -> Mesh:
    """That share of the area that is nearest to the axis of a hinge, or farthest along a slide."""
    middles, areas = mesh.vertices[mesh.faces].mean(1), mesh.areas()
    off = middles - joint.pivot
    far = np.linalg.norm(np.cross(off, joint.axis), axis=1) if joint.type == "revolute" else -off @ joint.axis
    order = np.argsort(far)
    near = np.zeros(len(far), bool)
    near[order[np.cumsum(areas[order]) <= share * areas.sum()]] = True
    return mesh.with_faces(near)


def _with_far_vertex(mesh: Mesh) -> Mesh:
    vertices = mesh.vertices.copy()
    vertices[mesh.faces[0, 0]] += [0, 0, 65.5]
    return replace(mesh, vertices=vertices)


def _scale(mesh: Mesh, factor: float) -> Mesh:
    middle = (mesh.vertices.max(0) + mesh.vertices.min(0)) / 2
    return replace(mesh, vertices=middle + factor * (mesh.vertices - middle))


FAULTS: dict[str, Callable[[Mesh, float, Joint], Mesh]] = {
    "shifted by 5 %": lambda m, size, _: replace(m, vertices=m.vertices + 0.05 * size * np.array([0.6, 0.48, 0.64])),
    "larger by 15 %": lambda m, size, _: _scale(m, 1.15),
    "smaller by 20 %": lambda m, size, _: _scale(m, 0.8),
    "inflated by 3 %": lambda m, size, _: replace(
        m, vertices=m.vertices + 0.03 * size * vertex_normals(m.vertices, m.faces)
    ),
    "half is missing": lambda m, size, _: _half(m),
    "the half far from the joint is missing": lambda m, size, joint: _near_joint(m, joint, 0.5),
    "all but 30 % is missing": lambda m, size, joint: _near_joint(m, joint, 0.3),
    "a tenth is missing": lambda m, size, joint: _near_joint(m, joint, 0.9),
    "a vertex at 65.5 m": lambda m, size, _: _with_far_vertex(m),
    "colours inverted": lambda m, size, _: replace(m, colours=None if m.colours is None else 255 - m.colours),
}
"""What is done to one part's mesh, given the object's size in metres and its joint; per cent are of that size, or of
the part."""


@dataclass(frozen=True)
class Judged:
    """One answer as it judges itself, and as the truth does."""

    video: str
    status: str
    """'ok', or 'failed': an answer that is refused deceives nobody."""
    wrong: bool
    doubtful: bool
    reasons: tuple[str, ...]
    values: dict[str, float | None]
    """Of the joint, miou and the parts' Chamfer distances: strict-1, from the files."""
    state_range: float
    """Of the truth, deg or % of the diagonal."""
    axis_over_std: float | None
    """Error of the axis in its standard deviations; None where the type is wrong or none is given."""
    pivot_over_std: float | None
    states_within: tuple[float, ...] | None
    """Shares of the states whose error, against the mean error, is within k standard deviations, k of WITHIN."""
    seconds: float
    held_out: bool


def main(
    work: Path = ROOT / "out" / "trust",
    partnet_root: Path | None = None,
    videos: tuple[str, ...] = (),
    out: Path | None = None,
    refine: bool = True,
    answers: Path | None = None,
    data: Path = ROOT / "out" / "freeart21-v1",
) -> None:
    """Record, solve and judge.

    Args:
        answers: Results folder of a method whose answers are judged instead.
        data: Its data folder.
        work: Where videos and results are kept; what is there already is used.
        partnet_root: Folder that holds PartNet-Mobility objects.
        videos: These alone, by name.
        out: The JSON file. When not given: benchmarks/results/trust.json, and only when all videos are judged.
        refine: Solve with the Gaussians; a third of the time without.
    """
    if answers is not None:
        judged = judge_folder(answers, data)
        _print(judged)
        facts = {"protocol": "strict-1", "data": data.name, "videos": [one.video for one in judged]}
        write_report(
            out or RESULTS / "trust_answers.json",
            facts,
            summary=count_verdicts(judged),
            rows=[asdict(one) for one in judged],
        )
        return
    chosen = [v for v in VIDEOS if (not videos or v.name in videos) and (partnet_root is not None or not v.partnet)]
    if not chosen:
        raise FreeArtError(f"no such videos: {', '.join(videos)}; there are {', '.join(v.name for v in VIDEOS)}")
    judged, faults = [], dict[str, str]()
    for video in chosen:
        data, results = work / "data" / video.name, work / "results" / video.name
        sequence = _record(video, data, partnet_root)
        if not (results / sequence / "prediction.json").is_file():
            settings = ReconstructSettings(progress=False, gaussians=GaussianSettings(refine=refine))
            reconstruct_folder(data / "sequences" / sequence, results / sequence, settings)
        judged.append(_judge_video(video, data, results, sequence))
        _say(judged[-1])
        if judged[-1].status == "ok" and not judged[-1].wrong and not judged[-1].doubtful:
            faults |= _judge_spoilt(video, data / "sequences" / sequence, results / sequence)
    _print(judged)
    print(json.dumps(count_faults(faults), indent=1))
    if out is None and len(chosen) < len(VIDEOS):
        return
    write_report(
        out or RESULTS / "trust.json",
        {"solver": VERSION, "protocol": "strict-1", "refine": refine, "videos": [v.name for v in chosen]},
        summary=summary(judged),
        faults_doubted_of=count_faults(faults),
        rows=[asdict(one) for one in judged],
        faults=faults,
    )


# ---------------------------------------------------------------- videos


def _record(video: Video, data: Path, partnet_root: Path | None) -> str:
    settings = RecordSettings(
        frames=video.frames,
        seed=video.seed,
        width=320,
        height=180,
        queries=2,
        sensor=video.sensor,
        partnet_root=partnet_root if video.partnet else None,
        joint=video.joint,
        skip_missing=video.partnet,
    )
    with _stage(video):
        return record(video.object, data, settings)


@contextmanager
def _stage(video: Video) -> Iterator[None]:
    """Recordings made inside follow the changed plan, and move the second joint."""
    plan_recording, draw = session.plan_recording, Sensor._draw

    def changed(loaded: Any, settings: RecordSettings, model: Any = None) -> Any:
        camera, plan = plan_recording(loaded, replace(settings, frames=video.every * settings.frames), model)
        states = plan.states[:: video.every]
        middle = (states.max() + states.min()) / 2
        states = middle + video.share * (states - middle)
        return camera, Plan(plan.Ts_camera_object[:: video.every], states, plan.Ts_camera_world[:: video.every])

    def draw_changed(self: Sensor, t: float) -> None:
        assert video.second_joint is not None
        name, low, high = video.second_joint
        sweep = 0.5 - 0.5 * np.cos(2 * np.pi * 1.5 * t / (video.frames - 1))
        with mock.patch.dict(self._loaded.asset.held, {name: low + (high - low) * sweep}):
            draw(self, t)

    with mock.patch.object(session, "plan_recording", changed):
        if video.second_joint is None:
            yield
        else:
            with mock.patch.object(sensor.Sensor, "_draw", draw_changed):
                yield


# ---------------------------------------------------------------- verdicts


def judge_folder(results: Path, data: Path) -> list[Judged]:
    """The answers of a results folder to the sequences of a data folder; those that it lacks are left out."""
    names = [name for name in read_benchmark(data).sequences if (results / name / "prediction.json").is_file()]
    if not names:
        raise FreeArtError(f"{results} has no answer to any sequence of {data}")
    return [_judge_answer(results / name, data / "truth" / name, name) for name in names]


def _judge_video(video: Video, data: Path, results: Path, sequence: str) -> Judged:
    found = _judge_answer(results / sequence, data / "truth" / sequence, video.name, video.held_out)
    return replace(found, wrong=found.status == "ok" and (found.wrong or video.second_joint is not None))


def _judge_answer(result: Path, truth_folder: Path, name: str, held_out: bool = False) -> Judged:
    answer, truth = read_result(result), read_truth(truth_folder)
    turns = truth.articulation.joint.type == "revolute"
    span = float(np.ptp(truth.states)) * (180 / np.pi if turns else 100 / truth.diagonal)
    seconds = sum(answer.seconds.values())
    if isinstance(answer, Failure):
        return Judged(name, "failed", False, True, (answer.reason,), {}, span, None, None, None, seconds, held_out)
    trust = judge(answer, read_diagnostics(result, len(answer)))  # as the solver asks them, by today's signs
    values = measure(Case(truth, answer, []), Strict(1, samples=2000)).values
    values = {name: values.get(name) for name in VALUES}
    ratios = (*_over_std(answer, values, truth.diagonal), states_within(answer, truth))
    doubtful = trust.verdict == "doubtful"
    return Judged(name, "ok", is_wrong(values, span), doubtful, trust.reasons, values, span, *ratios, seconds, held_out)


def _judge_spoilt(video: Video, sequence: Path, result: Path) -> dict[str, str]:
    """How a sound answer with a fault in either surface judges itself, by video, part and fault."""
    answer = read_result(result)
    assert isinstance(answer, Reconstruction)
    diagnostics = read_diagnostics(result, len(answer))
    assert diagnostics is not None
    scene, parts, found = prepare_scene(read_sequence(sequence), SceneSettings()), answer.articulation, dict[str, str]()
    for part in PARTS:
        for name, spoil in FAULTS.items():
            mesh = spoil(parts.part(part), object_size(answer), parts.joint)
            wrong = replace(answer, articulation=replace(parts, **{part: mesh}))
            trust = judge(wrong, replace(diagnostics, **check_surfaces(scene, wrong)))
            found[f"{video.name}, {part}, {name}"] = describe_trust(trust)
    return found


def count_faults(faults: dict[str, str]) -> dict[str, str]:
    """Of every fault, how many surfaces were doubted, of how many."""
    judged = {name: [judgement for key, judgement in faults.items() if key.endswith(name)] for name in FAULTS}
    return {
        name: f"{sum(text.startswith('doubtful') for text in of_name)} of {len(of_name)}"
        for name, of_name in judged.items()
    }


def is_wrong(values: dict[str, float | None], state_range: float) -> bool:
    """Whether the answer is wrong by the truth; `state_range` in the unit of the state: deg, or % of the diagonal."""
    if values["joint_type"] != 1:
        return True
    limits = {
        "axis": WRONG_AXIS_DEG,
        "position": WRONG_PIVOT_PERCENT,
        "state": WRONG_STATES * max(state_range, 1e-9),
        "chamfer_s": WRONG_SURFACE_PERCENT,
        "chamfer_m": WRONG_SURFACE_PERCENT,
    }
    return any((values[name] or 0.0) > most for name, most in limits.items())


def _over_std(
    answer: Reconstruction, values: dict[str, float | None], diagonal: float
) -> tuple[float | None, float | None]:
    axis, position = values["axis"], values["position"]
    return (
        float(np.radians(axis) / answer.axis_std) if answer.axis_std and axis is not None else None,
        position / 100 * diagonal / answer.pivot_std if answer.pivot_std and position is not None else None,
    )


def states_within(answer: Reconstruction, truth: Truth) -> tuple[float, ...] | None:
    """See `Judged.states_within`; None where the type is wrong or no state has a standard deviation."""
    joint, std = truth.articulation.joint, answer.state_std
    if std is None or answer.articulation.joint.type != joint.type:
        return None
    known = answer.seen.all(1) & np.isfinite(std)
    errors = [(sign * answer.states - truth.states)[known] for sign in (1, -1)]
    errors = [e - (np.angle(np.exp(1j * e).mean()) if joint.type == "revolute" else e.mean()) for e in errors]
    if joint.type == "revolute":
        errors = [np.angle(np.exp(1j * e)) for e in errors]
    error = np.abs(min(errors, key=lambda e: float(np.abs(e).sum())))
    return tuple(float(np.mean(error <= k * std[known])) for k in WITHIN) if known.any() else None


def calibration(right: list[Judged]) -> dict[str, list[float | None]]:
    """By kind, the share of right answers' errors within each of WITHIN standard deviations; a video counts as one."""
    axis, pivot = (
        [[value <= k for k in WITHIN] for j in right if (value := getattr(j, name)) is not None]
        for name in ("axis_over_std", "pivot_over_std")
    )
    states = [j.states_within for j in right if j.states_within is not None]
    kinds = {"axis": axis, "pivot": pivot, "states": states}
    return {
        kind: [round(float(share), 3) for share in np.mean(shares, 0)] if shares else [None] * len(WITHIN)
        for kind, shares in kinds.items()
    }


def summary(judged: list[Judged]) -> dict[str, Any]:
    """`count_verdicts` of the videos by which the signs were made, and of those held out."""
    return {
        name: count_verdicts([one for one in judged if one.held_out == held_out])
        for name, held_out in (("seen", False), ("held_out", True))
    }


def count_verdicts(judged: list[Judged]) -> dict[str, Any]:
    """The confusion table, and the calibration curve of the right answers."""
    answers = [one for one in judged if one.status == "ok"]
    wrong, right = [j for j in answers if j.wrong], [j for j in answers if not j.wrong]

    return {
        "wrong_doubted": sum(j.doubtful for j in wrong),
        "wrong_unnoticed": sum(not j.doubtful for j in wrong),
        "right_doubted": sum(j.doubtful for j in right),
        "right_sound": sum(not j.doubtful for j in right),
        "refused": len(judged) - len(answers),
        "errors_within": {"standard_deviations": list(WITHIN), **calibration(right)},
    }


def _say(one: Judged) -> None:
    print(f"{one.video}: {'wrong' if one.wrong else 'right'}, {'doubtful' if one.doubtful else 'sound'}", flush=True)


def _print(judged: list[Judged]) -> None:
    head = ("video", "by the truth", "by itself", "axis", "state", "reasons")
    cells = []
    for one in judged:
        truth = "refused" if one.status != "ok" else "wrong" if one.wrong else "right"
        errors = (format_number(one.values.get(name)) for name in ("axis", "state"))
        cells.append((one.video, truth, "doubtful" if one.doubtful else "sound", *errors, "; ".join(one.reasons)))
    print_table("trust", head, cells)
    print(json.dumps(summary(judged), indent=1))


if __name__ == "__main__":
    run_cli(main)
