"""What a path is, and the page that shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset import read_asset, read_effects
from freeart21.files.benchmark import is_unfinished, unfinished_error
from freeart21.files.diagnostics import Diagnostics, confidence_file, read_confidence, read_diagnostics
from freeart21.files.gaussians import GAUSSIANS, read_gaussians
from freeart21.files.places import PAGE, check_place
from freeart21.files.result import read_appearance, read_result
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.files.urdf import MAX_URDF_BYTES
from freeart21.reconstruction import Failure, Reconstruction, describe_trust
from freeart21.recording import Recording
from freeart21.se3 import Array
from freeart21.truth import Truth
from freeart21.view.asset_scene import asset_scene
from freeart21.view.benchmark_page import benchmark_page
from freeart21.view.diagnosis import diagnosis_section, remarks_section
from freeart21.view.document import TRUTH, Section, document
from freeart21.view.gaussian_page import gaussians_page
from freeart21.view.link_shapes import read_shown
from freeart21.view.losses import losses_sections
from freeart21.view.parts import AXIS, align, articulation_scene, axis_in_pictures, matched, with_truth
from freeart21.view.plot import StateSeries, plot_section
from freeart21.view.scene import scene_section
from freeart21.view.tables import (
    compared_rows,
    joint_rows,
    joint_section,
    limits_text,
    link_section,
    recording_rows,
    score_section,
    seconds_section,
    source_rows,
    table_section,
)
from freeart21.view.video import AxisLine, PartMasks, VideoSettings, shown_frames, video_section

ALIGNMENT_NOTE = (
    "The truth is moved into the prediction's frame by the reference part's poses over all frames; one sign and the "
    "median offset of its states are taken out."
)


def page(
    path: Path,
    truth: Path | None = None,
    sequence: Path | None = None,
    scores: Mapping[str, Any] | None = None,
    asset: Path | None = None,
    title: str | None = None,
    score_note: str = "",
    root: Path | None = None,
) -> str:
    """One self-contained HTML page of a sequence, a result, a truth, an asset, a file of Gaussians or a data folder.

    A result is shown with its asset (`asset`, else its own folder asset/), over the pictures of its `sequence` and
    beside its `truth` when these folders are given; a sequence is shown with its truth. `scores` and their note are as
    in `score_section`. What a URDF names is read inside `root` (`urdf_files.find_root`). Raises FreeArtError in one
    line when `path` is none of these, or when what is given does not fit together.
    """
    path = Path(path)
    kind = recognised(path)
    name = title or _name(path.resolve())
    if kind == "data":
        return benchmark_page(path, name)
    if kind == "gaussians":
        for what, other in (("truth", truth), ("sequence", sequence), ("asset", asset)):
            if other is not None:
                raise FreeArtError(f"{path} is a file of Gaussians, shown without a {what} (given: {other})")
        gaussians = read_gaussians(path, root=checked.ANYWHERE)
        if not len(gaussians):
            raise FreeArtError(f"{path} has no Gaussians, expected at least one")
        return gaussians_page(name, gaussians)
    true = read_truth(truth) if truth is not None and kind != "truth" else None
    extra = [score_section(scores, score_note, "small" if kind == "asset" else "right")] if scores else []
    if kind == "sequence":
        return _sequence_page(name, read_sequence(path), true, extra)
    if kind == "truth":
        return _sequence_page(name, read_sequence(sequence) if sequence is not None else None, read_truth(path), extra)
    if kind == "result":
        recording = read_sequence(sequence) if sequence is not None else None
        answer = read_result(path, appearance=False)
        if isinstance(answer, Failure):
            return _failure_page(name, answer, true, recording, extra)
        inside = path / "asset"
        asset = asset or (inside if inside.is_dir() else None)
        diagnostics, confidence, notices = None, None, []
        try:
            answer = replace(answer, appearance=read_appearance(path))
        except FreeArtError as error:
            notices = [f"The Gaussians cannot be shown: {error}"]
        try:
            diagnostics = read_diagnostics(path, len(answer))
            confidence = _confidence(path, answer)
        except FreeArtError as error:
            notices.append(f"The diagnostics cannot be shown: {error}")
        return _result_page(name, answer, true, recording, asset, diagnostics, confidence, extra, notices)
    sections, chips, notices = _asset_sections(path, None, root)
    return document(name, [*sections, *extra], "asset", chips, notices)


def write_page(
    path: Path,
    out: Path,
    truth: Path | None = None,
    sequence: Path | None = None,
    scores: Mapping[str, Any] | None = None,
    asset: Path | None = None,
    title: str | None = None,
    score_note: str = "",
    root: Path | None = None,
) -> None:
    """Write `page(...)` to the file `out`, whole or not at all; FreeArtError unless only an older page stands there."""
    inputs = [given for given in (path, truth, sequence, asset) if given is not None]
    check_place(out, PAGE, inputs)
    atomic.write_bytes(Path(out), page(path, truth, sequence, scores, asset, title, score_note, root).encode())


def recognised(path: Path) -> str:
    """'sequence', 'result', 'truth', 'asset', 'data' or 'gaussians'.

    FreeArtError says what was looked for and what is there.
    """
    if not path.exists():
        raise FreeArtError(f"{path} does not exist")
    if not path.is_dir():
        if path.suffix.lower() in (".urdf", ".xacro"):
            return "asset"
        if path.suffix == ".ply":
            return "gaussians"
        raise FreeArtError(
            f"{path} is a file, expected a URDF, a PLY of Gaussians, or the folder of a sequence, a result, a truth, "
            "an asset or a data set"
        )
    for name, kind in (
        ("sequence.json", "sequence"),
        ("prediction.json", "result"),
        ("truth.json", "truth"),
        ("asset.json", "asset"),
        ("benchmark.json", "data"),
    ):
        if checked.is_there(path / name):
            return kind
    if list(path.glob("*.urdf")):
        return "asset"
    if is_unfinished(path):
        raise unfinished_error(path)
    names = sorted(p.name + "/" * p.is_dir() for p in path.iterdir())
    there = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "") or "nothing"
    patterns = ("*/sequence.json", "*/*/sequence.json", "*/prediction.json", "*/asset.json")
    inner = sorted(str(p.parent.relative_to(path)) for pattern in patterns for p in path.glob(pattern))
    hint = f"; what can be shown in it: {', '.join(inner[:8])}{' ...' * (len(inner) > 8)}" if inner else ""
    raise FreeArtError(
        f"{path} is nothing to show: looked for sequence.json, prediction.json, truth.json, asset.json, "
        f"benchmark.json or a .urdf file, found {there}{hint}"
    )


def _name(path: Path) -> str:
    """What a page is called after: a folder; of asset/ and gaussians.ply the one they stand in; a file's stem."""
    if path.is_file() and path.name != GAUSSIANS:
        return path.stem
    return path.parent.name if path.name in ("asset", GAUSSIANS) else path.name


def _sequence_page(name: str, recording: Recording | None, true: Truth | None, extra: list[Section]) -> str:
    """The page of a sequence, of a truth, or of both together."""
    _check_lengths(recording=recording, truth=true)
    chips = _recording_chips(recording)
    sections = []
    if true is None:
        sections.append(video_section(recording))
    else:
        joint, states = true.articulation.joint, true.states
        camera = recording.camera if recording is not None else None
        sections += [
            video_section(recording, truth=true.part_mask, n=len(true), states=states, joint_type=joint.type),
            scene_section(
                articulation_scene(true.articulation, states, true.Ts_camera_reference, camera), "True parts and joint"
            ),
            plot_section(StateSeries(joint.type, *_abscissa(recording, len(true)), truth=states)),
            table_section("True joint", joint_rows(joint, states), place="right"),
            table_section("Source", source_rows(true.source)),
        ]
        chips.append(f"{joint.type} joint")
    if recording is not None:
        place: Literal["right", "small"] = "small" if true is not None else "right"
        sections.append(table_section("Recording", recording_rows(recording), place=place))
    return document(name, [*sections, *extra], "sequence" if recording is not None else "truth", chips)


def _result_page(
    name: str,
    result: Reconstruction,
    true: Truth | None,
    recording: Recording | None,
    asset: Path | None,
    diagnostics: Diagnostics | None,
    confidence: PartMasks | None,
    extra: list[Section],
    notices: list[str],
) -> str:
    """The page of a reconstruction, with whatever belongs to it."""
    _check_lengths(recording=recording, truth=true, result=result)
    if true is not None:
        given, result = result, matched(result, true)
        if diagnostics is not None and result is not given:
            diagnostics = diagnostics.exchanged()
    Ts = result.Ts_camera_reference
    joint, states, masks = result.articulation.joint, result.states, result.part_masks
    camera = recording.camera if recording is not None else None
    scene = articulation_scene(result.articulation, states, Ts, camera, result.appearance)
    axes = []
    if camera is not None:
        axes.append(AxisLine("found", AXIS, axis_in_pictures(result.articulation, states, Ts, camera)))
    series = StateSeries(joint.type, *_abscissa(recording, len(result)), states, result.state_std, result.seen[:, 1])
    place: Literal["left", "right"] = "left" if extra else "right"
    facts = table_section("Joint", joint_rows(joint, states), place=place)
    if true is not None:
        alignment = align(result, true)
        scene = with_truth(scene, true, alignment)
        if alignment.comparable:
            series = replace(series, truth=alignment.states(true))
        if camera is not None:
            lines = axis_in_pictures(true.articulation, true.states, true.Ts_camera_reference, camera)
            axes.append(AxisLine("truth", TRUTH, lines if alignment.sign > 0 else lines[:, ::-1]))
        true_axis = alignment.joint(true).axis
        angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(joint.axis, true_axis)), abs(joint.axis @ true_axis)))
        apart = f"The axes are {angle:.2f}° apart."
        rows = compared_rows(joint, states, alignment.joint(true), alignment.states(true))
        facts = table_section("Joint", rows, ("", "found", "true"), place, f"{ALIGNMENT_NOTE} {apart}")
    sections = [
        video_section(
            recording,
            lambda i: masks[i],
            true.part_mask if true else None,
            len(result),
            states,
            joint.type,
            axes=axes,
            confidence=confidence,
        ),
        scene_section(scene, "Parts and joint"),
        plot_section(series),
        remarks_section(result, diagnostics),
        *extra,
        facts,
        diagnosis_section(result, diagnostics, series.frames_or_times, series.timed),
    ]
    if result.seconds:
        sections.append(seconds_section(result.seconds, diagnostics.peak_bytes if diagnostics else None))
    if recording is not None:
        sections.append(table_section("Recording", recording_rows(recording)))
    if asset is not None:
        try:
            more, _, told = _asset_sections(asset, Ts[0])
            sections, notices = sections + more, [*notices, *told]
        except FreeArtError as error:
            notices = [*notices, f"The asset cannot be shown: {error}"]
    moved = limits_text(joint.type, float(states.min()), float(states.max()))
    return document(name, sections, "result", [f"{joint.type} joint", moved, *_recording_chips(recording)], notices)


def _confidence(path: Path, result: Reconstruction) -> PartMasks | None:
    """The maps of a result folder, all there and of the right size, or None when it has none; raises FreeArtError."""
    if not confidence_file(path, 0).exists():
        return None
    height, width = result.part_masks.shape[1:]
    shown = shown_frames(len(result), VideoSettings().max_frames).tolist()
    return {i: read_confidence(path, i, (height, width)) for i in shown}.__getitem__


def _failure_page(
    name: str, failure: Failure, true: Truth | None, recording: Recording | None, extra: list[Section]
) -> str:
    """The page of a failure: where the method gave up, and on what video."""
    _check_lengths(recording=recording, truth=true)
    sections = []
    if recording is not None:
        sections.append(video_section(recording, None, true.part_mask if true else None))
    sections += [table_section("No reconstruction", [("Stage", failure.stage), ("Reason", failure.reason)]), *extra]
    if failure.seconds:
        sections.append(seconds_section(failure.seconds))
    notice = f"The method gave up in the stage '{failure.stage}': {failure.reason}"
    return document(name, sections, "result", ["failed", *_recording_chips(recording)], [notice])


def _asset_sections(
    path: Path, T_camera_canonical: Array | None, root: Path | None = None
) -> tuple[list[Section], list[str], list[str]]:
    """Sections, chips and notices of an asset folder or URDF file."""
    asset: Asset | None = None
    if path.is_dir() and checked.is_there(path / "asset.json"):
        asset = read_asset(path, root=root)
        urdf = asset.urdf
    else:
        urdf = _one_urdf(path)
    shown = read_shown(urdf, root if asset is None else asset.root)
    model = shown.urdf
    effects = asset.effects if asset is not None else read_effects(urdf)
    missing, notices = shown.missing, []
    if missing:
        some = ", ".join(missing[:5]) + " ..." * (len(missing) > 5)
        notices = [f"{len(missing)} mesh files that {urdf.name} names are missing: {some}"]
    if asset is not None and asset.trust is not None and asset.trust.verdict == "doubtful":
        notices.append(f"The reconstruction that the asset was made of is {describe_trust(asset.trust)}")
    movable = [joint for joint in model.joints.values() if joint.joint_type]
    if not movable:
        raise FreeArtError(f"{urdf} has no movable joint, expected a revolute or prismatic one")
    masses = [link.inertial.mass for link in model.links.values() if link.inertial is not None]
    chips = [
        f"{len(model.links)} links",
        f"{len(movable)} movable joint{'s' * (len(movable) != 1)}",
        *([f"{sum(masses):.3g} kg"] if masses else []),
    ]
    sections = [
        scene_section(asset_scene(shown, asset, T_camera_canonical), "Asset", "full"),
        joint_section(model, effects),
        link_section(model),
    ]
    if asset is not None and asset.source:
        rows = [("trust", describe_trust(asset.trust)), *source_rows(asset.source)]
        sections.append(table_section("Where the asset came from", rows))
    if path.is_dir():
        sections += losses_sections(path)
    return sections, chips, notices


def _one_urdf(path: Path) -> Path:
    if not path.is_dir():
        return path
    urdfs = sorted(path.glob("*.urdf"))
    original = [p for p in urdfs if p.name == "mobility.urdf"] or urdfs
    if len(original) != 1:
        raise FreeArtError(f"{path} has {len(urdfs)} URDFs, name one of them: {', '.join(p.name for p in urdfs)}")
    return checked.require_file(original[0], MAX_URDF_BYTES)


def _check_lengths(
    recording: Recording | None = None, truth: Truth | None = None, result: Reconstruction | None = None
) -> None:
    lengths = {
        name: len(what)
        for name, what in (("sequence", recording), ("truth", truth), ("result", result))
        if what is not None
    }
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"the {name} has {n} frames" for name, n in lengths.items())
        raise FreeArtError(f"these do not belong together: {told}")
    if truth is not None and result is not None and truth.part_mask(0).shape != result.part_masks.shape[1:]:
        raise FreeArtError(
            f"the part masks of the result are {result.part_masks.shape[1:]}, those of the truth "
            f"{truth.part_mask(0).shape}"
        )


def _abscissa(recording: Recording | None, n: int) -> tuple[np.ndarray, bool]:
    return (recording.times_s, True) if recording is not None else (np.arange(n, dtype=float), False)


def _recording_chips(recording: Recording | None) -> list[str]:
    if recording is None:
        return []
    span = float(recording.times_s[-1] - recording.times_s[0])
    return [f"{len(recording)} frames", f"{span:.3g} s", f"{recording.camera.width} x {recording.camera.height}"]
