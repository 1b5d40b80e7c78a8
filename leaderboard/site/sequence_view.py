"""What the page of a sequence shows of its results: video with every method's parts, 3D view, joint states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.files.benchmark import Benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.joint import JointType
from freeart21.recording import Recording
from freeart21.truth import Truth
from freeart21.view.document import TRUTH, Section, data_url
from freeart21.view.parts import articulation_scene, axis_in_images, axis_place, with_articulation
from freeart21.view.plots import Curve, state_section
from freeart21.view.scene import Layer, scene_section
from freeart21.view.tables import NONE
from freeart21.view.video import Overlay, VideoSettings, encode_jpeg, shown_frames, video_section
from leaderboard.rows import Row
from leaderboard.site.answers import Answer, align_states, read_answer
from leaderboard.site.entrant import Entrant

SETTINGS = VideoSettings(max_frames=72, mask_side=256, rgb_bytes=640 << 10, depth_bytes=0)
FACES = 1000
"""Triangles per part."""
STATE_SAMPLES = 400
"""Most samples of a curve of joint states."""
THUMBNAIL = 176, 99
NO_FILES = "only its table of scores was given"


@dataclass(frozen=True)
class SequenceContent:
    """One sequence, for all pages but its own."""

    name: str
    facts: dict[str, Any]
    """Joint type, category, frames, seconds, size, source, licence; diagonal and range of a known truth. From tables
    alone, the joint type only."""
    thumb: str = ""
    """Address of a JPEG; empty when only tables were given."""
    absent: dict[str, str] = field(default_factory=dict)
    """Method's file name to why nothing of its result can be shown."""


def show_table(name: str, joint_type: JointType, entrants: Sequence[Entrant]) -> SequenceContent:
    """What is shown of a sequence without its data folder: numbers alone."""
    absent = dict.fromkeys((entrant.file for entrant in entrants), NO_FILES)
    return SequenceContent(name, {"joint_type": joint_type, "category": NONE, "source": {}}, absent=absent)


def show_sequence(
    benchmark: Benchmark, name: str, entrants: Sequence[Entrant], protocol: str, joint_type: JointType
) -> tuple[SequenceContent, list[Section]]:
    """Read one sequence, its truth and every method's result: facts, and the sections of its page.

    Nothing of a hidden truth is read: results are shown as they are, in the camera frame of the first image.
    """
    recording = read_sequence(benchmark.sequence(name))
    truth = None if benchmark.hidden else read_truth(benchmark.truth(name))
    frames = shown_frames(len(recording), SETTINGS.max_frames)
    size = recording.camera.height, recording.camera.width
    answers: dict[str, Answer] = {}
    absent: dict[str, str] = {}
    for entrant in entrants:
        row = entrant.row(protocol, name)
        answer = _read_answer(entrant, name, row, truth or len(recording), frames.tolist(), size)
        if isinstance(answer, Answer):
            answers[entrant.file] = answer
        else:
            absent[entrant.file] = answer
    base = _truth_as_answer(truth) if truth else _first_of(list(answers.values()))
    if base is not None and truth is None:
        joint = base.articulation.joint
        answers = {file: align_states(one, joint, base.states) for file, one in answers.items()}
    facts: dict[str, Any] = {
        "joint_type": joint_type,
        "category": NONE,
        "frames": len(recording),
        "seconds": float(recording.times_s[-1] - recording.times_s[0]),
        "size": f"{size[1]} \N{MULTIPLICATION SIGN} {size[0]}",
        "source": {},
        "licence": recording.licence,
    }
    if truth is not None:
        facts |= {"diagonal_cm": 100 * truth.diagonal, "range": float(np.ptp(truth.states)), "source": truth.source}
        facts["category"] = str(truth.source.get("category") or "unknown")
    sections = [_video(recording, truth, base, entrants, answers, absent)]
    if base is not None:
        sections += [
            _states(recording, truth, base, entrants, answers),
            _scene(recording, truth, base, entrants, answers),
        ]
    return SequenceContent(name, facts, _thumbnail(recording), absent), sections


def _read_answer(
    entrant: Entrant, name: str, row: Row | None, truth: Truth | int, frames: list[int], size: tuple[int, int]
) -> Answer | str:
    """A method's result, or why it cannot be shown; `truth` as in `read_answer`."""
    if row is None:
        return "its table has no such row"
    if entrant.folder is None:
        return NO_FILES
    if row.status != "ok":
        return f"{row.status}: {row.reason}"
    try:
        return read_answer(entrant.folder / name, truth, frames, row.swapped, entrant.method.lacks, size)
    except Exception as error:  # hostile files reach parsers of many libraries; each has exceptions of its own
        reason = str(error) if isinstance(error, FreeArtError) else type(error).__name__
        return f"its files cannot be shown: {reason}"


def _truth_as_answer(truth: Truth) -> Answer:
    """The truth as a perfect result, with its outer surfaces and no masks."""
    outer = [truth.articulation.part(n).with_faces(f) for n, f in zip(PARTS, truth.outer, strict=True)]
    parts = Articulation(truth.articulation.joint, replace(outer[0], colours=None), replace(outer[1], colours=None))
    return Answer(
        parts, truth.states, 1.0, 0.0, True, None, truth.Ts_camera_reference, np.zeros((0, 1, 1), np.uint8), ()
    )


def _first_of(answers: Sequence[Answer]) -> Answer | None:
    """The first result with the most frequent joint type; of one with states, if any."""
    types = [one.articulation.joint.type for one in answers]
    frequent = [one for one, kind in zip(answers, types, strict=True) if kind == max(types, key=types.count)]
    return next((one for one in frequent if one.zero is None), next(iter(frequent), None))


def _video(
    recording: Recording,
    truth: Truth | None,
    base: Answer | None,
    entrants: Sequence[Entrant],
    answers: Mapping[str, Answer],
    absent: Mapping[str, str],
) -> Section:
    """The player; with a hidden truth, axes by each result's own poses."""
    frames = shown_frames(len(recording), SETTINGS.max_frames).tolist()
    overlays = []
    if truth is not None:
        overlays.append(Overlay("ground truth", truth.part_mask, ("#7fcfb6", TRUTH), _axis(base, base, recording)))
    for entrant in entrants:
        answer, line, masks = answers.get(entrant.file), None, None
        if answer is not None:
            line = _axis(answer, base if truth is not None else answer, recording)
            masks = dict(zip(frames, answer.masks, strict=True)).__getitem__ if len(answer.masks) else None
        why = absent.get(entrant.file) or "makes no part masks" * (masks is None)
        brief = why if len(why) <= 60 else f"{why[:57]}…"
        shown = len(overlays) < (1 if truth is None else 2)  # the truth and the first method are shown at first
        overlays.append(Overlay(entrant.name, masks, (entrant.pale, entrant.colour), line, shown=shown, absent=brief))
    return video_section(recording, overlays, settings=SETTINGS)


def _axis(answer: Answer | None, posed: Answer | None, recording: Recording) -> NDArray[np.float64] | None:
    """A result's axis in all images by the poses of `posed`; None without any."""
    if answer is None or posed is None or not len(posed.Ts_camera_articulation):
        return None
    place = axis_place(posed.articulation, posed.states)
    return axis_in_images(answer.articulation.joint, *place, posed.Ts_camera_articulation, recording.camera)


def _scene(
    recording: Recording, truth: Truth | None, base: Answer, entrants: Sequence[Entrant], answers: Mapping[str, Answer]
) -> Section:
    """The 3D view of all results, moved by one slider where their joints are of one type."""
    shown, others = "ground truth", list(entrants)
    colours = "#7fcfb6", TRUTH
    if truth is None:
        first = next(
            entrant for entrant in entrants if entrant.file in answers and answers[entrant.file].states is base.states
        )
        shown, colours = first.name, (first.pale, first.colour)
        others.remove(first)
    Ts = base.Ts_camera_articulation if len(base.Ts_camera_articulation) else np.eye(4)[None]
    scene = articulation_scene(base.articulation, base.states, Ts, recording.camera, None, _layers(shown, colours))
    for k, entrant in enumerate(others):
        answer = answers.get(entrant.file)
        if answer is not None:
            layers = _layers(entrant.name, (entrant.pale, entrant.colour), shown=k == 0)
            aligned = (answer.sign, answer.offset) if answer.comparable else None
            scene = with_articulation(scene, layers, answer.articulation, answer.states, aligned)
    where = (
        "The ground truth is hidden: every result is shown in the camera frame of the first image."
        if truth is None
        else "Results are aligned with the ground truth as the protocol does it."
    )
    note = f"{where} The slider moves all joints of one type. Meshes are simplified; pale: reference part."
    return scene_section(scene, "Parts and joint in 3D", "right", FACES, note)


def _layers(name: str, colours: tuple[str, str], shown: bool = True) -> tuple[Layer, Layer, Layer]:
    pale, colour = colours
    return Layer(name, pale, shown=shown), Layer(name, colour, shown=shown), Layer(name, colour, "axis", shown)


def _states(
    recording: Recording, truth: Truth | None, base: Answer, entrants: Sequence[Entrant], answers: Mapping[str, Answer]
) -> Section:
    """The joint state of every result with the true, or the first one's, joint type."""
    frames = shown_frames(len(recording), STATE_SAMPLES)
    curves = [Curve("ground truth", TRUTH, base.states[frames], "wide")] if truth is not None else []
    for entrant in entrants:
        answer = answers.get(entrant.file)
        if answer is not None and answer.comparable and "states" not in answer.lacks:
            curves.append(Curve(entrant.name, entrant.colour, answer.states_as_true[frames]))
    note = (
        "The ground truth is hidden: states have the sign and zero of the first method shown."
        if truth is None
        else "The sign of the axis and the median offset are removed, as in scoring."
    )
    seen = None if truth is None else truth.seen[frames, 1] > 0
    x = recording.times_s[frames] - recording.times_s[0]
    return state_section(base.articulation.joint.type, x, True, curves, seen, frames, note)


def _thumbnail(recording: Recording) -> str:
    """A 16:9 image of the object, from the frame with the most of it, as the address of a JPEG."""
    some = [recording.frame(int(i)) for i in shown_frames(len(recording), 8)]
    frame = max(some, key=lambda one: int(one.mask.sum()))
    rows, cols = np.flatnonzero(frame.mask.any(1)), np.flatnonzero(frame.mask.any(0))
    image = frame.rgb
    if len(rows):
        half = max(0.62 * np.ptp(cols), 0.62 * np.ptp(rows) * 16 / 9, 8.0)
        x, y = (cols[0] + cols[-1]) / 2, (rows[0] + rows[-1]) / 2
        size = round(2 * half), round(2 * half * 9 / 16)
        image = cv2.getRectSubPix(image, size, (float(x), float(y))).astype(np.uint8)
    small = cv2.resize(image, THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.uint8)
    return data_url("image/jpeg", encode_jpeg(small, 72))
