"""What a path is, and the page that shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from freeart21.asset import Asset
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset import read_asset, read_effects
from freeart21.files.benchmark import is_unfinished, unfinished_error
from freeart21.files.certificate import read_certificate
from freeart21.files.diagnostics import Diagnostics, confidence_file, read_confidence, read_diagnostics
from freeart21.files.gaussians import GAUSSIANS, read_gaussians
from freeart21.files.places import PAGE, check_place
from freeart21.files.result import read_appearance, read_result
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.files.urdf import MAX_URDF_BYTES
from freeart21.reconstruction import Failure, Reconstruction, describe_trust
from freeart21.recording import Recording
from freeart21.truth import Truth
from freeart21.view.asset_scene import asset_scene
from freeart21.view.data_page import data_page
from freeart21.view.diagnosis import diagnosis_section, warnings_section
from freeart21.view.document import Markup, Section, document
from freeart21.view.link_shapes import read_shown
from freeart21.view.plots import state_section
from freeart21.view.scene import gaussians_scene, scene_section, sources_scene, without_outliers
from freeart21.view.source import AXIS, LAYERS, PartMasks, Source, align_truth, matched, truth_source
from freeart21.view.tables import (
    certificate_section,
    compared_rows,
    joint_rows,
    joint_section,
    limits_text,
    link_section,
    recording_rows,
    score_section,
    seconds_section,
    source_rows,
    table,
    table_section,
)
from freeart21.view.video import MAX_FRAMES, shown_frames, video_section

ALIGNMENT_NOTE = (
    "The ground truth is aligned with the estimate by the reference part's poses over all frames; the sign of the axis "
    "and the median offset of the states are removed."
)
MARKERS = {
    "sequence.json": "sequence",
    "prediction.json": "result",
    "truth.json": "truth",
    "asset.json": "asset",
    "benchmark.json": "data",
}
"""The file by which a folder is recognised, and what it then is."""


def page(
    path: Path,
    truth: Path | None = None,
    sequence: Path | None = None,
    scores: Mapping[str, Mapping[str, Any]] | None = None,
    score_note: str = "",
    root: Path | None = None,
) -> str:
    """One self-contained HTML page of a sequence, a result, a truth, an asset, a file of Gaussians or a data folder.

    Args:
        path: What to show.
        truth: Truth folder of a sequence or a result.
        sequence: Sequence folder of a result or a truth, for its images.
        scores: As for `score_section`.
        score_note: A sentence under the scores.
        root: Folder that bounds what a URDF refers to.

    Raises FreeArtError when `path` is none of these, or when the inputs do not fit together.
    """
    path = Path(path)
    kind = recognised(path)
    name = _title_of(path.resolve())
    if kind == "data":
        return data_page(path, name)
    if kind == "gaussians":
        for what, other in (("truth", truth), ("sequence", sequence)):
            if other is not None:
                raise FreeArtError(f"{path} is a file of Gaussians, shown without a {what} (given: {other})")
        return _gaussians_page(name, path)
    extra = [score_section(scores, score_note, "small" if kind == "asset" else "right")] if scores else []
    if kind == "asset":
        sections, chips, notices = _asset_sections(path, root)
        return document(name, [*sections, *extra], "asset", chips, notices)
    truth, video = path if kind == "truth" else truth, path if kind == "sequence" else sequence
    true = read_truth(truth) if truth is not None else None
    recording = read_sequence(video) if video is not None else None
    if kind in ("sequence", "truth"):
        return _sequence_page(name, recording, true, extra, "sequence" if recording is not None else "truth")
    answer = read_result(path, appearance=False)
    if isinstance(answer, Failure):
        rows = [("Stage", answer.stage), ("Reason", answer.reason)]
        extra = [table_section("No reconstruction", rows), *extra]
        extra += [seconds_section(answer.seconds)] if answer.seconds else []
        notice = f"The method failed in the stage '{answer.stage}': {answer.reason}"
        return _sequence_page(name, recording, true, extra, "result", [notice])
    return _result_page(name, path, answer, true, recording, extra)


def write_page(path: Path, out: Path, truth: Path | None = None, sequence: Path | None = None, **options: Any) -> None:
    """Write `page(...)` to the file `out`, completely or not at all; FreeArtError if another file is there."""
    check_place(out, PAGE, [given for given in (path, truth, sequence) if given is not None])
    atomic.write_bytes(Path(out), page(path, truth, sequence, **options).encode())


def recognised(path: Path) -> str:
    """'sequence', 'result', 'truth', 'asset', 'data' or 'gaussians'; FreeArtError names what was expected and found."""
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
    for name, kind in MARKERS.items():
        if checked.is_there(path / name):
            return kind
    if list(path.glob("*.urdf")):
        return "asset"
    if is_unfinished(path):
        raise unfinished_error(path)
    names = sorted(p.name + "/" * p.is_dir() for p in path.iterdir())
    there = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "") or "nothing"
    raise FreeArtError(f"{path} is nothing to show: looked for {', '.join(MARKERS)} or a .urdf file, found {there}")


def _title_of(path: Path) -> str:
    """A folder's name, or a file's stem; of asset/, gaussians.ply and `film`'s result/ that of the folder around."""
    if path.is_file() and path.name != GAUSSIANS:
        return path.stem
    while path.name in ("asset", "result", GAUSSIANS):
        path = path.parent
    return path.name


def _gaussians_page(name: str, path: Path) -> str:
    gaussians = read_gaussians(path, root=checked.ANYWHERE)
    n, moving = len(gaussians), int((gaussians.part_weights < 0.5).sum())
    if not n:
        raise FreeArtError(f"{path} has no Gaussians, expected at least one")
    size = " x ".join(f"{x:.3g}" for x in np.ptp(without_outliers(gaussians.means), 0))
    rows = [("Gaussians", f"{n:,}"), ("Extent, units of the file", size)]
    if (gaussians.part_weights < 1).any():
        rows.append(("Of the moving part, at state zero", f"{moving:,}"))
    if gaussians.supposed is not None:
        rows.append(("On surface that nobody saw", f"{int(gaussians.supposed.sum()):,}"))
    light = "none" if gaussians.light is None else f"{len(gaussians.light)} spherical harmonics, fixed to the viewer"
    facts = table_section("Gaussians", [*rows, ("Light", light)])
    return document(
        name, [scene_section(gaussians_scene(gaussians), "3D view", "full"), facts], "Gaussians", [f"{n:,} Gaussians"]
    )


def _sequence_page(
    name: str,
    recording: Recording | None,
    true: Truth | None,
    extra: list[Section],
    kind: str = "sequence",
    notices: Sequence[str] = (),
) -> str:
    """The page of a sequence, of a truth, or of both."""
    _check_lengths(sequence=recording, truth=true)
    chips = _recording_chips(recording)
    sections = [video_section(recording)] if true is None and recording is not None else []
    if true is not None:
        source = truth_source(true, layers=LAYERS)
        joint, states = source.joint, true.states
        sections += [
            video_section(recording, [source]),
            scene_section(sources_scene([source], _camera(recording)), "True parts and joint"),
            state_section([source], *_abscissa(recording, len(true))),
            table_section("True joint", joint_rows(joint, states), place="right"),
            table_section("Source", source_rows(true.source)),
        ]
        chips.append(f"{joint.type} joint")
    if recording is not None:
        rows = recording_rows(recording)
        sections.append(table_section("Recording", rows, (), "small" if true is not None else "right"))
    return document(name, [*sections, *extra], kind, chips, notices)


def _result_page(
    name: str,
    path: Path,
    result: Reconstruction,
    true: Truth | None,
    recording: Recording | None,
    extra: list[Section],
) -> str:
    """The page of a reconstruction, with its diagnostics and asset."""
    result, diagnostics, confidence, notices = _read_extras(path, result)
    _check_lengths(sequence=recording, truth=true, result=result)
    alternatives = []
    for other in result.alternatives:
        cost = "Cost of a pixel, difference", f"{other.cost_difference:+.3f}"  # beyond that under the result's joint
        alternatives.append(table_section("Alternative joint", [*joint_rows(other.joint, other.states), cost]))
    if true is not None:
        given, result = result, matched(result, true)
        if diagnostics is not None and result is not given:
            diagnostics = diagnostics.exchanged()
    joint, states = result.articulation.joint, result.states
    estimate = Source(
        "estimate",
        axis_colour=AXIS,
        articulation=result.articulation,
        states=states,
        Ts_camera=result.Ts_camera_reference,
        state_std=result.state_std,
        masks=result.part_masks.__getitem__,
        confidence=confidence,
        layers=LAYERS,
    )
    sources = [estimate]
    side: Literal["left", "right"] = "left" if extra else "right"
    facts = table_section("Joint", joint_rows(joint, states), (), side)
    if true is not None:
        over = align_truth(true, result, estimate)
        sources.append(over)
        aligned = over.joint_of_first
        angle = np.arctan2(np.linalg.norm(np.cross(joint.axis, aligned.axis)), abs(joint.axis @ aligned.axis))
        note = f"{ALIGNMENT_NOTE} Angle between the axes: {np.degrees(angle):.2f}°."
        rows = compared_rows(joint, states, aligned, over.states_of_first)
        facts = table_section("Joint", rows, ("", "estimate", "ground truth"), side, note)
    abscissa, timed = _abscissa(recording, len(result))
    scene = sources_scene(sources, _camera(recording), result.appearance)
    sections = [
        video_section(recording, sources),
        scene_section(scene, "Parts and joint"),
        state_section(sources, abscissa, timed, result.seen[:, 1]),
        warnings_section(result, diagnostics),
        *extra,
        facts,
        *alternatives,
        diagnosis_section(result, diagnostics, abscissa, timed),
    ]
    if result.seconds:
        sections.append(seconds_section(result.seconds, diagnostics.peak_bytes if diagnostics else None))
    if recording is not None:
        sections.append(table_section("Recording", recording_rows(recording)))
    if (path / "asset").is_dir():
        try:
            more, _, warnings = _asset_sections(path / "asset")
            sections, notices = sections + more, [*notices, *warnings]
        except FreeArtError as error:
            notices.append(f"The asset cannot be shown: {error}")
    moved = limits_text(joint.type, float(states.min()), float(states.max()))
    return document(name, sections, "result", [f"{joint.type} joint", moved, *_recording_chips(recording)], notices)


def _read_extras(
    path: Path, result: Reconstruction
) -> tuple[Reconstruction, Diagnostics | None, PartMasks | None, list[str]]:
    """The result with its Gaussians, its diagnostics and confidence maps, and notices of what cannot be read."""
    diagnostics, confidence, notices = None, None, []
    try:
        result = replace(result, appearance=read_appearance(path))
    except FreeArtError as error:
        notices.append(f"The Gaussians cannot be shown: {error}")
    try:
        diagnostics = read_diagnostics(path, len(result))
        if confidence_file(path, 0).exists():
            height, width = result.part_masks.shape[1:]
            frames = shown_frames(len(result), MAX_FRAMES).tolist()
            confidence = {i: read_confidence(path, i, (height, width)) for i in frames}.__getitem__
    except FreeArtError as error:
        notices.append(f"The diagnostics cannot be shown: {error}")
    return result, diagnostics, confidence, notices


def _asset_sections(path: Path, root: Path | None = None) -> tuple[list[Section], list[str], list[str]]:
    """Sections, chips and notices of an asset folder or URDF file."""
    asset: Asset | None = None
    urdf = path
    if path.is_dir() and checked.is_there(path / "asset.json"):
        asset = read_asset(path, root=root)
        urdf = asset.urdf
    elif path.is_dir():
        urdfs = sorted(path.glob("*.urdf"))
        original = [p for p in urdfs if p.name == "mobility.urdf"] or urdfs
        if len(original) != 1:
            raise FreeArtError(f"{path} has {len(urdfs)} URDFs, name one of them: {', '.join(p.name for p in urdfs)}")
        urdf = checked.require_file(original[0], MAX_URDF_BYTES)
    shown = read_shown(urdf, root if asset is None else asset.root)
    model = shown.urdf
    effects = asset.effects if asset is not None else read_effects(urdf)
    missing, notices = shown.missing, []
    if missing:
        names = ", ".join(missing[:5]) + " ..." * (len(missing) > 5)
        notices = [f"{len(missing)} mesh files that {urdf.name} names are missing: {names}"]
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
        scene_section(asset_scene(shown, asset), "Asset", "full"),
        joint_section(model, effects),
        link_section(model),
    ]
    certificate = None if asset is None else read_certificate(urdf.parent)
    if certificate is not None:
        sections.insert(1, certificate_section(certificate))
    if asset is not None and asset.source:
        rows = table([("trust", describe_trust(asset.trust)), *source_rows(asset.source)])
        html = Markup("<details><summary>All that asset.json states</summary>{}</details>").format(rows)
        sections.append(Section("Source of the asset", html, place="full"))
    return sections, chips, notices


def _check_lengths(**given: Recording | Truth | Reconstruction | None) -> None:
    lengths = {name: len(what) for name, what in given.items() if what is not None}
    if len(set(lengths.values())) > 1:
        texts = ", ".join(f"the {name} has {n} frames" for name, n in lengths.items())
        raise FreeArtError(f"these do not belong together: {texts}")


def _abscissa(recording: Recording | None, n: int) -> tuple[np.ndarray, bool]:
    """Times, s, or frame numbers (n,), and whether they are times."""
    return (recording.times_s, True) if recording is not None else (np.arange(n, dtype=float), False)


def _camera(recording: Recording | None) -> Camera | None:
    return None if recording is None else recording.camera


def _recording_chips(recording: Recording | None) -> list[str]:
    if recording is None:
        return []
    span = float(recording.times_s[-1] - recording.times_s[0])
    return [f"{len(recording)} frames", f"{span:.3g} s", f"{recording.camera.width} x {recording.camera.height}"]
