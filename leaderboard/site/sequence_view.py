"""What the page of a sequence shows of its results: video with every method's parts, 3D view, joint states.

Results are aligned with the truth as the protocol does it. When the truth is hidden, a result is shown in the camera
frame of the first image, as its own poses say: nothing of the truth is in it, not even an alignment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.errors import FreeArtError
from freeart21.files.benchmark import Benchmark
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.joint import JointType
from freeart21.mesh import Mesh
from freeart21.reconstruction import Failure, Piece
from freeart21.recording import Recording
from freeart21.truth import Truth
from freeart21.view.document import Section
from freeart21.view.plots import state_section
from freeart21.view.scene import scene_section, sources_scene
from freeart21.view.source import Source, truth_source
from freeart21.view.tables import NONE
from freeart21.view.video import jpeg_url, shown_frames, video_section
from leaderboard import metrics
from leaderboard.rows import Row
from leaderboard.site.entrant import Entrant
from leaderboard.submission import read_submission
from leaderboard.surface import Surface

MAX_FRAMES, SIDES, QUALITY = 72, (480, 256), 45
FACES = 1000
"""Triangles per part."""
STATE_SAMPLES = 400
"""Most samples of a curve of joint states."""
THUMBNAIL = 176, 99
EMPTY = Mesh(np.zeros((0, 3)), np.zeros((0, 3), int))
NO_FILES = "only its table of scores was given"
HIDDEN = "The ground truth is hidden: every result is shown in the camera frame of the first image."


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


def show_sequence(
    benchmark: Benchmark | None, name: str, entrants: Sequence[Entrant], protocol: str, joint_type: JointType
) -> tuple[SequenceContent, list[Section]]:
    """Read one sequence, its truth and every method's result: facts, and the sections of its page.

    Without a benchmark nothing is read, and there are no sections.
    """
    facts: dict[str, Any] = {"joint_type": joint_type, "category": NONE, "source": {}}
    if benchmark is None:
        return SequenceContent(name, facts, absent={entrant.file: NO_FILES for entrant in entrants}), []
    recording = read_sequence(benchmark.sequence(name))
    truth = None if benchmark.hidden else read_truth(benchmark.truth(name))
    frames = shown_frames(len(recording), MAX_FRAMES)
    size = recording.camera.height, recording.camera.width
    absent: dict[str, str] = {}
    sources: list[Source] = []
    for entrant in entrants:
        row = entrant.row(protocol, name)
        found = _read_answer(entrant, name, row, truth or len(recording), frames.tolist(), size)
        if isinstance(found, str):
            absent[entrant.file] = found
            found = Source("", absent=found if len(found) <= 60 else f"{found[:57]}…")
        elif found.masks is None:
            found = replace(found, absent="makes no part masks")
        sources.append(replace(found, name=entrant.name, colours=(entrant.pale, entrant.colour)))
    if truth is not None:
        sources = [_true_source(truth), *(replace(one, Ts_camera=truth.Ts_camera_reference) for one in sources)]
    elif (first := _first_of(sources)) is not None:
        sources = [first, *(one.follow(first) if one.articulation else one for one in sources if one is not first)]
    sources = [replace(one, shown=k < 2) for k, one in enumerate(sources)]  # the truth and a method at first
    facts |= {
        "frames": len(recording),
        "seconds": float(recording.times_s[-1] - recording.times_s[0]),
        "size": f"{size[1]} \N{MULTIPLICATION SIGN} {size[0]}",
        "licence": recording.licence,
    }
    if truth is not None:
        facts |= {"diagonal_cm": 100 * truth.diagonal, "range": float(np.ptp(truth.states)), "source": truth.source}
        facts["category"] = str(truth.source.get("category") or "unknown")
    sections = [video_section(recording, sources, MAX_FRAMES, SIDES, QUALITY, with_depth=False)]
    if sources[0].articulation is not None:
        where = HIDDEN if truth is None else "Results are aligned with the ground truth as the protocol does it."
        note = f"{where} The slider moves all joints of one type. Meshes are simplified; pale: reference part."
        scene = sources_scene(sources, recording.camera)
        sections += [
            _states(recording, truth, sources),
            scene_section(scene, "Parts and joint in 3D", "right", FACES, note),
        ]
    return SequenceContent(name, facts, _thumbnail(recording), absent), sections


def _read_answer(
    entrant: Entrant, name: str, row: Row | None, truth: Truth | int, frames: list[int], size: tuple[int, int]
) -> Source | str:
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


def read_answer(
    folder: Path,
    truth: Truth | int,
    frames: Sequence[int],
    swapped: bool,
    lacks: tuple[Piece, ...],
    size: tuple[int, int],
) -> Source:
    """The result in `folder`, in the truth's canonical frame, or in the first image's camera frame.

    Args:
        folder: The result.
        truth: What it is aligned with; the number of frames when that is hidden.
        frames: Frames whose part masks are kept.
        swapped: Whether scoring exchanged its part names.
        lacks: What the method does not make.
        size: (height, width) of the masks.

    Raises FreeArtError when it cannot be shown.
    """
    given, _ = read_submission(folder, truth if isinstance(truth, int) else len(truth), *size)
    if isinstance(given, Failure):
        raise FreeArtError(f"{folder.name} is a failure: {given.reason}")
    anchor = given.anchor
    if "poses" in lacks:  # as `matching.match`: the anchor frame's only, the moving part posed by its joint
        Ts = given.Ts_camera_reference[anchor]
        moving = Ts @ given.articulation.joint.transform(given.states)
        given = replace(given, Ts_camera_reference=np.repeat(Ts[None], len(given), 0), Ts_camera_moving=moving)
    given = given.exchanged() if swapped else given
    Ts = given.Ts_camera_reference
    if isinstance(truth, int):
        T_common_pred = Ts[anchor if "poses" in lacks else 0]
    else:
        shown = [anchor] if "poses" in lacks else slice(None)
        outer = Surface(truth.articulation.reference, truth.outer[0])
        T_common_pred = metrics.align(truth.Ts_camera_reference[shown], Ts[shown], outer.centre)
    parts = [EMPTY if "meshes" in lacks else replace(given.articulation.part(name), colours=None) for name in PARTS]
    masks = {i: given.part_masks[i].copy() for i in frames}
    source = Source(
        folder.name,
        articulation=Articulation(given.articulation.joint, *parts).moved(T_common_pred),
        states=given.states,
        Ts_camera=Ts[:0] if "poses" in lacks else Ts @ se3.inverse(T_common_pred),
        masks=None if "masks" in lacks else masks.__getitem__,
        zero=anchor if "states" in lacks else None,
    )
    return source if isinstance(truth, int) else source.follow(truth_source(truth))


def _true_source(truth: Truth) -> Source:
    """The truth, with its outer surfaces."""
    outer = [truth.articulation.part(n).with_faces(f) for n, f in zip(PARTS, truth.outer, strict=True)]
    parts = Articulation(truth.articulation.joint, replace(outer[0], colours=None), replace(outer[1], colours=None))
    return truth_source(truth, articulation=parts)


def _first_of(sources: Sequence[Source]) -> Source | None:
    """The first result with the most frequent joint type; of one with states, if any."""
    there = [one for one in sources if one.articulation is not None]
    types = [one.joint.type for one in there]
    frequent = [one for one in there if types.count(one.joint.type) == max(map(types.count, types))]
    frequent = [one for one in frequent if one.joint.type == frequent[0].joint.type]
    return next((one for one in frequent if one.zero is None), next(iter(frequent), None))


def _states(recording: Recording, truth: Truth | None, sources: Sequence[Source]) -> Section:
    """The joint state of every result with the joint type of the first source."""
    frames = shown_frames(len(recording), STATE_SAMPLES)
    note = (
        "The ground truth is hidden: states have the sign and zero of the first method shown."
        if truth is None
        else "The sign of the axis and the median offset are removed, as in scoring."
    )
    seen = None if truth is None else truth.seen[frames, 1] > 0
    return state_section(sources, recording.times_s[frames] - recording.times_s[0], True, seen, frames, note)


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
    return jpeg_url(small, 72)
