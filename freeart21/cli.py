"""The command line: the one file that sees every room. Each command is a plain function; tyro reads its signature."""

from __future__ import annotations

import inspect
import json
import math
import os
import platform
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

import freeart21
from freeart21 import stopping
from freeart21.ending import in_one_line
from freeart21.errors import FreeArtError
from leaderboard import commands as board
from reconstruct.settings import ReconstructSettings
from reconstruct.stages import STAGES, KeptStage

if TYPE_CHECKING:
    from freeart21.reconstruction import Reconstruction

Positional = tyro.conf.Positional
DESCRIPTION = "FreeArt-21: from RGB-D videos of articulated objects to simulation-ready assets, and their score."
DOUBTFUL = 3
"""Exit code when there is an answer, and it says itself that something is wrong: of `reconstruct` one that it does not
trust, of `export` an asset made of such a one or with contact far from what is seen, of `check-asset` a failed rule."""
STOP_AFTER = "Stop after this stage; what it found is kept for the next call. " + " ".join(
    f"{stage.name}: {stage.does}." for stage in STAGES if stage.kept
)


def doctor(as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> int:
    """Say what this machine has (Vulkan, GPU, packages), and how to mend what it lacks.

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
        table = Table("what", "", "found", title="freeart21 doctor")
        marks = {"ok": "[green]ok[/]", "note": "[dim]note[/]", "missing": "[bold red]missing[/]"}
        for f in findings:
            table.add_row(f.name, marks[f.status], escape(f.detail))
        console = Console()
        console.print(table)
        for f in findings:
            if f.mend:
                print(f"To mend {f.name}: {f.mend}")
    return 1 if any(f.status == "missing" for f in findings) else 0


def demo(
    name: Annotated[str, Positional] = "stapler",
    out: Path = Path("out/demo"),
    frames: int = 120,
    seed: int = 0,
    partnet_root: Path | None = None,
    joint: str | None = None,
) -> None:
    """Take one object all the way: simulator, video, reconstruction, URDF, simulator, score, and a page to look at.

    Args:
        name: Object of the catalog, or a PartNet-Mobility id.
        out: Folder for everything that the demo makes; an older demo there is replaced.
        frames: Frames of the video.
        seed: Seed of shape, motion and views.
        partnet_root: Folder that holds PartNet-Mobility objects, as ROOT/41083/mobility.urdf.
        joint: Joint of a PartNet-Mobility object that moves.
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
    settings = RecordSettings(frames=frames, seed=seed, partnet_root=partnet_root, joint=joint)
    plan_jobs((name,), settings)  # what cannot be recorded is said before anything is made
    with only_writer(out), new_folder(out, DEMO) as aside:
        data, results = aside / "data", aside / "results" / "ours"
        print(f"Recording {frames} frames of {name} in the simulator", flush=True)
        sequence = record(name, data, settings)
        print("Reconstructing it from the video alone", flush=True)
        answer = reconstruct_folder(data / "sequences" / sequence, results / sequence)
        if not isinstance(answer, Failure):
            print("Exporting it as an asset for simulators, with the video's print; reloading it", flush=True)
            try:
                video = data / "sequences" / sequence
                export_result(results / sequence, results / sequence / "asset", video=video)
            except FreeArtError as error:  # the score and the page say that there is no asset
                print(f"No asset: {error}", file=sys.stderr)
        print("Scoring the reloaded asset, and the answer's masks, poses and views, against the truth", flush=True)
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
    print(f"Everything is in {out}; open {out / 'index.html'} to look at it.")


def objects(as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """List the catalog: name, category, joint type, size, source.

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
    """Record objects in SAPIEN: the video that a method may see, and the truth apart from it.

    May be stopped at any moment: the same command goes on, and the data are the same to the last byte.

    Args:
        names: Objects of the catalog (`freeart21 objects`), URDFs as PATH.urdf, PartNet-Mobility ids, or `all`:
            freeart21-v1 or, with --partnet-root, the 21 of the official FreeArt-21. With --seed or --motion: the
            built-in 21.
        out: Data folder; sequences are added to it.
        frames: Frames a sequence; 300 when not given, or as many as a take lasts.
        seed: Seed of shape, motion, sensor and views; 0 when not given.
        partnet_root: Folder that holds PartNet-Mobility objects, as ROOT/41083/mobility.urdf or ROOT/dataset/41083.
        joint: Joint that moves, of a URDF or of a PartNet-Mobility object where the catalog names none.
        skip_missing: Leave out meshes that an object names but does not have and, with `all`, objects that are not in
            --partnet-root.
        root: Folder that bounds what a URDF names; its own, or its package's.
        motion: tumble (when not given), inspect, wave, turntable, static_base, release, human, or track:FILE, a take
            (or teleop:FILE).
        carry: Factor on a take's way, 1 for its metres; by the objects' sizes when not given.
        preset: handheld (real size, filling the picture) or paper (PartNet scale, 3 m away).
        sensor: clean, noise2, tof, blur, hand, or several joined by '+'.
        camera: camera.json of `gap`: a real camera's faults, besides the sensor's.
        effects: effects.json of the joint that is let go, for the motion release.
        let_go: Share of its range, 0 to 1, at which it is let go; drawn when not given.
        procedural: Instead of names: a category of which --count fresh objects are drawn from the seed.
        count: How many fresh objects.
        split: Of freeart21-v1: public, to tune on, or test, which is only scored.
        workers: Processes that record, each a sequence at a time.
        queries: Held-out views a sequence.
        width: Of the pictures, pixels.
        height: Of the pictures, pixels.
        shader: SAPIEN's camera shader: default, or trivial (unlit, fast).
        executor: Where they record: local (this machine), ray or slurm (--out on a file system that all machines see).
    """
    from freeart21.files import checked
    from freeart21.formats.captured import read_track
    from generator import v1
    from generator.dataset import is_unfinished, official_names, plan_jobs, procedural_jobs, record_jobs
    from generator.motion.track import count_frames, describe_changes
    from generator.recorder import RecordSettings, built_in_names

    track = None
    if motion is not None and motion.startswith(("track:", "teleop:")):
        file = motion.partition(":")[2]
        motion, track = "track", Path(file) if file else None
    if track is not None:
        lasts = count_frames(read_track(track), RecordSettings.fps)
        if frames is not None and frames < lasts:
            print(f"{track} lasts {lasts} frames; the {frames} over which its joint moves most are recorded")
        frames = lasts if frames is None else min(frames, lasts)
    settings = RecordSettings(
        frames=300 if frames is None else frames,
        seed=seed or 0,
        width=width,
        height=height,
        queries=queries,
        motion=motion or "tumble",
        track=track,
        carry=carry,
        preset=preset,
        sensor=sensor,
        camera=camera,
        effects=effects,
        let_go=let_go,
        partnet_root=partnet_root,
        joint=joint,
        skip_missing=skip_missing,
        root=root,
        shader=shader,
    )
    if procedural is not None and names:
        raise FreeArtError(f"record: name objects or a category, not both; got {', '.join(names)} and {procedural}")
    frozen = names == ("all",) and partnet_root is None and seed is None and motion is None
    if split != "public" and not frozen:
        raise FreeArtError(
            f"record: --split {split} is of freeart21-v1, which `all` records when neither seed nor motion is given"
        )
    label = None
    if frozen:
        jobs, label = v1.jobs(split, settings), v1.label(split, settings)
    elif procedural is not None:
        jobs = procedural_jobs(procedural, count, settings.seed, settings)
    else:
        if "all" in names and len(names) > 1:
            raise FreeArtError(f"record: `all` stands alone; got {' '.join(names)}")
        if names == ("all",):
            names = built_in_names() if partnet_root is None else official_names(partnet_root, skip_missing)
        if not names:
            raise FreeArtError(f"record: no object was named; name some of {', '.join(built_in_names())}, or all")
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

    with stopping.explained(
        lambda: f"what is done is kept in {out}: the same command goes on" if is_unfinished(out) else ""
    ):
        made = record_jobs(out, jobs, workers, label, done, executor)
    if not made:
        print(f"{out} holds {'this sequence' if len(jobs) == 1 else f'these {len(jobs)} sequences'} already")
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
) -> None:
    """Move an object and its joint by hand, live in a browser, and record it as a take.

    Prints an address with a secret token: who has it drives, or watches. `freeart21 record NAME --motion track:TAKE`
    replays a take at full quality. Needs the extra `teleop`.

    Args:
        name: Object of the catalog (`freeart21 objects`), a URDF as PATH.urdf, or a PartNet-Mobility id.
        out: File of the take; nothing is replaced, and further takes are numbered.
        seed: Seed of the object's shape and colours.
        partnet_root: Folder that holds PartNet-Mobility objects, as ROOT/41083/mobility.urdf or ROOT/dataset/41083.
        joint: Joint that moves, of a URDF or of a PartNet-Mobility object where the catalog names none.
        skip_missing: Leave out meshes that the object names but does not have.
        root: Folder that bounds what a URDF names; its own, or its package's.
        host: Address to listen at; 0.0.0.0 is all that this machine has. Beyond 127.0.0.1 the page is served by https,
            with a certificate that is made for this machine and kept.
        port: Port to listen at; 0 takes a free one.
        width: Of the live picture, pixels; a page of another shape gets as many.
        height: Of the live picture, pixels.
    """
    from generator.session import RecordSettings
    from generator.teleop.start import TeleopSettings, serve

    record = RecordSettings(seed=seed, partnet_root=partnet_root, joint=joint, skip_missing=skip_missing, root=root)
    record.check()
    serve(name, out, TeleopSettings(host, port, width, height), record)


def verify(data: Annotated[Path, Positional], deep: bool = False, truth: Path | None = None) -> int:
    """Check a data folder: every hash, every format, and that video and truth agree.

    One that was packed without its truth is looked through for traces of it.

    Args:
        data: A data folder (with benchmark.json).
        truth: Where the truth of a packed data folder lies (`freeart21 pack DATA --truth`).
        deep: Also cast the truth's meshes anew and render its objects anew, without trusting the recorder.
    """
    from freeart21.files.verify import verify as look_through

    report = look_through(data, truth)
    if deep and not report.findings:
        from generator.golden import verify_deep

        report.findings.extend(verify_deep(data, apart=truth))
    for finding in report.findings:
        print(finding)
    if report.findings:
        return 1
    print(f"{data}: {report.files} files, {report.sequences} sequences: all well")
    return 0


def reconstruct(
    sequence: Annotated[Path, Positional],
    out: Path,
    until: Annotated[KeptStage | None, tyro.conf.arg(help=STOP_AFTER)] = None,
    keep_work: bool = False,
    segmentation: Literal["ours", "paper"] | None = None,
    settings_file: Annotated[Path | None, tyro.conf.arg(name="settings", metavar="FILE.json")] = None,
    settings: ReconstructSettings = ReconstructSettings(),  # noqa: B008 (frozen)
) -> int:
    """Solve one sequence: two parts, their poses, the joint between them, and meshes, from the video alone.

    May be stopped at any moment: the same command goes on after the last finished stage, to the same result. An older
    result at --out is replaced, and with it the asset that was made of it; anything else there is left alone. The last
    line says whether to trust the answer; if it is doubtful, the exit code is 3.

    Args:
        sequence: A sequence folder (with sequence.json).
        out: Result folder, such as results/ours/SEQ.
        keep_work: Keep what the stages found when the result is written, too, for calls with other settings.
        segmentation: Short for --settings.segmentation: ours, or the paper's with features made by hand.
        settings_file: Settings of every stage to start from; what the file does not name keeps its default. The
            `settings` of a method.json, or such a file itself.
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
    check_place(out, RESULT, (sequence,))
    work = work_folder(out)
    kept_too = f"finished stages are kept in {work}: the same command goes on"
    with stopping.explained(lambda: kept_too if work.is_dir() else ""), only_writer(out):
        if until is not None:
            kept = reconstruct_until(sequence, out, until, settings)
            if isinstance(kept, Path):
                size = kept.stat().st_size / 1e6
                print(
                    f"{kept}: what was found until {until} ({size:.1f} MB); the next call for {out} goes on from here"
                )
                return 0
            print(f"{out}: failed in {kept.stage}: {kept.reason}", file=sys.stderr)
            return 1
        result = reconstruct_folder(sequence, out, settings, keep_work)
    code = f"freeart21 {freeart21.__version__}, solver {VERSION}"
    home = out.absolute().parent
    write_own_method(home, Method(home.name, code, settings.to_json(), _hardware()))
    if isinstance(result, Failure):
        print(f"{out}: failed in {result.stage}: {result.reason}", file=sys.stderr)
        return 1
    return _say_answer(result, out)


def _say_answer(result: Reconstruction, out: Path) -> int:
    """Prints what was found, how well it is known and, last, whether to trust it; 0 when sound, 3 when doubtful."""
    joint = result.articulation.joint
    low, high = _shown(joint.lower, joint.type), _shown(joint.upper, joint.type)
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
    mass: float | None = None,
    material: Literal["plastic", "wood", "steel", "aluminium", "glass", "rubber", "cardboard"] | None = None,
    wall: float | None = None,
    dynamics: Literal["guessed", "none"] = "guessed",
    scale: float = 1.0,
    up: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")] = None,
    gravity: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")] = None,
    zero: Literal["first", "closed", "lower", "upper"] = "closed",
    video: Path | None = None,
    base: Literal["free", "fixed"] = "free",
    usd: Literal["auto", "yes", "no"] = "auto",
) -> int:
    """Write a result as a simulation-ready asset (URDF, MJCF, USD, meshes, loaders), reload it, and check it.

    The last line says whether the result trusts itself, as the asset's files do. The exit code is 3 if it is doubtful,
    or if collision shapes are far from what is seen.

    Args:
        result: A result folder (with prediction.json).
        out: Asset folder to write.
        density: kg/m^3 of both parts, that of the material when not given: video tells no mass.
        mass: kg of the whole object instead; the parts share it by their volumes.
        material: What both parts are made of, plastic (1050 kg/m^3) when not given.
        wall: Metres: the parts are hollow, with walls this thick; solid when not given.
        dynamics: A joint of which nothing is known gets a little damping and friction, marked as guessed, or none.
        scale: Factor for all lengths. An asset of another scale than 1 is not scored: it is not the video's object.
        up: Direction in the result's canonical frame (ours: the camera's of the first frame, right, down, forward)
            that becomes z; when not given, that of gravity or of the likeliest pose in which the object rests.
        gravity: Which way gravity pulls in the camera's axes (right, down, forward) of the first frame, 0 9.81 0 of a
            level camera; only when the reference part stood still before the camera.
        zero: Where the joint is at zero: in the first frame, at the end where both parts fill the least space (closed),
            or at its lower or upper end.
        video: Sequence folder that was reconstructed, for textures from its sharpest frames.
        base: The reference part moves freely, or stands fixed in the world (in URDF on a link named world).
        usd: Write object.usdc too; auto where usd-core is installed.
    """
    from export.check.contact_rule import contact_row
    from export.checklist import check_asset
    from export.delivered import delivered_shapes
    from export.exporter import ExportSettings, export_result
    from export.losses import given_up
    from export.placement import PlacementSettings
    from freeart21.reconstruction import describe_trust

    settings = ExportSettings(
        density=density,
        mass=mass,
        material=material,
        wall=wall,
        dynamics=dynamics,
        scale=scale,
        placement=PlacementSettings(up, gravity, zero),
        base=base,
        usd={"auto": None, "yes": True, "no": False}[usd],
    )
    asset = export_result(result, out, settings, video=video)
    print(asset.urdf)
    findings = check_asset(out)
    for finding in findings:
        print(f"  {finding}", file=sys.stderr)
    for line in given_up(asset):
        print(line, file=sys.stderr)
    contact = contact_row(*delivered_shapes(asset.urdf), asset.urdf.parent)
    if contact.verdict == "fail":
        print(f"{contact.rule} fails: {contact.reason}", file=sys.stderr)
    print(describe_trust(asset.trust))
    if findings:
        return 1
    doubtful = asset.trust is not None and asset.trust.verdict == "doubtful"
    return DOUBTFUL if doubtful or contact.verdict == "fail" else 0


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
    """Write an asset of one joint from a few numbers, for `gap`: a recording of a joint, and no URDF of it.

    Args:
        out: URDF file to write.
        mass: kg of the moving part.
        kind: A pendulum turns about y and hangs down at 0, a door turns about z, a drawer slides along x; z is up.
        length: Metres from the joint's axis to the centre of mass; 0 for a rotor (of --kind door).
        inertia: kg*m^2 about the joint's axis; that of the mass at its length when not given.
        period: Seconds of a small free swing of the pendulum, there and back: tells the length, or, beside a length,
            the inertia.
        lower: Lower limit of the joint, rad or m; no limits when not given.
        upper: Upper limit.
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
) -> int:
    """Check any URDF or MJCF, not only ours: named rules on its files, and trials in every installed engine.

    It is loaded in each engine, compared with the file's own numbers, pushed through its range, let go, and left to
    rest on a plane. The exit code is 0 when all rules pass, 3 when one fails or could not be judged in time (unknown),
    1 when there is no asset.

    Args:
        path: An asset folder, a folder with one URDF or MJCF, or such a file.
        root: Folder that bounds what a URDF names; its own, or its package's.
        engines: Engines to try it in: sapien, mujoco, pybullet, drake; all that are installed when not given.
        simcheck: Run the public checker of that name, too.
        as_json: File for the report: every rule with its verdict, reason, measured number and what it is good for.
        limit_s: Seconds of processor time that the files, and each engine, may take; three times that by the clock.
    """
    from export.check.checking import check
    from export.check.report import print_report, write_report

    report = check(path, engines, simcheck=simcheck, root=root, limit_s=limit_s)
    print_report(report)
    if as_json is not None:
        write_report(as_json, report)
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
        sources: Files of a joint's position against time (each a run), with --asset; or one result folder
            (RESULTS/SEQ) whose reference part stood fixed, with --gravity; or truth folders of one object
            (DATA/truth/SEQ, each recorded with --motion release).
        out: Folder for the measured set (OUT/measured) and, of truths, the object without effects (OUT/asset).
        gravity: m/s^2. Of files: in the asset's reference link, 0 0 -9.81 when not given. Of a result: in the camera's
            axes (right, down, forward) of the first frame, 0 9.81 0 of a level camera.
        rate_hz: Rows a second of files without a time; frames a second of a result [30].
        asset: Asset folder or URDF that the recordings are of.
        joint: Joint of the URDF; may be left out when only one can move.
        columns: Of t, q, qd, effort, q_command, voltage, enabled, base_x, base_y, base_z, base_ax, base_ay, base_az,
            base_angle, such as t=time q=angle; or a JSON file of such. Without a header columns are 1, 2, ...
        unit_t: Of times: s, ms, us or ns; guessed when not given.
        unit_q: Of positions and commands: rad, deg, turns, counts=N (N a turn), m, cm, mm; when not given, what the
            joint's limits and the asset's motion tell.
        unit_effort: Of efforts: N*m, N*cm or mN*m, N or mN; N*m or N when not given.
        zero: Position as recorded, in its unit, at the URDF's 0.
        reverse: The recording counts against the URDF's joint axis.
        effort: Asked of the actuator, or pushing the part from outside.
        actuator: Of force = STIFFNESS (q_command - q) - DAMPING qd, in N*m/rad and N*m*s/rad (N/m, N*s/m).
        interpolation: Of efforts and commands between their rows; unknown when not given.
        circumstances: JSON of actuator, base, prescribed runs, units, wrapped.
        inertia_relative: By which the asset's inertia may be off, 0.1 when not given.
        gravity_relative: By which its weight's torque or force may be off, 0.05 when not given.
        held_out: Runs that a fit must never see: names, numbers from 1, or files.
        noise_mm: Standard deviation, mm, of a tracker's shifts.
        noise_deg: Standard deviation, degrees, of a tracker's turns.
        seed: Seed of the tracker's errors.
        partnet_root: Folder that holds PartNet-Mobility objects, for truths of such.
        urdf: The object's URDF as it was recorded, for truths of one.
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
            raise FreeArtError("measure: files need --asset FOLDER or URDF: whose joint was measured?")
        told = SeriesSettings(
            columns_from(columns),
            unit_t,
            unit_q,
            unit_effort,
            zero,
            reverse,
            rate_hz,
            gravity,
            effort,
            actuator,
            interpolation,
            inertia_relative,
            gravity_relative,
            held_out,
            Circumstances() if circumstances is None else read_circumstances(circumstances),
        )
        for note in measure_series(files, out, asset, joint, told):
            print(f"- {note}")
        _say_next(asset, out)
        return
    if results and (len(sources) > 1 or gravity is None):
        raise FreeArtError(
            "measure: a result stands alone and needs --gravity X Y Z in the camera's axes of its first frame "
            f"(0 9.81 0 for a level camera); got {len(sources)} folders, gravity {gravity}"
        )
    if results and gravity is not None:
        from simgap.measure.reconstruction import measure_result

        measure_result(results[0], out, gravity, 30.0 if rate_hz is None else rate_hz)
        _say_next(results[0] / "asset", out)
    else:
        from generator.measure import TrackerNoise, measure_truths

        noise = TrackerNoise(1e-3 * noise_mm, math.radians(noise_deg), seed=seed)
        measure_truths(sources, out, noise, partnet_root, urdf, root)
        _say_next(out / "asset", out)


def gap(
    asset: Annotated[Path, Positional],
    measured: Annotated[Path, Positional],
    out: Path,
    seconds: float = 120.0,
    replay_seconds: float = 120.0,
    poses: Path | None = None,
    root: Path | None = None,
) -> None:
    """Find what the simulation of an asset lacks, from measured runs or an RGB-D video: name it, or say why not.

    Args:
        asset: An asset folder or a URDF.
        measured: A measured set (with measured.json), or a sequence folder: a video of the asset.
        out: Folder for verdict.json, what was named (the repaired asset, or camera.json for `record --camera`) and a
            page; an older one there is replaced.
        seconds: Of a measured set: processor time after which nothing further is looked for; the answer then says so.
        replay_seconds: Of a measured set: seconds after which SAPIEN's replay is given up; the answer then says so.
        poses: Of a video: the result or truth folder that says where the asset was; the result that holds the asset, or
            the truth beside the sequence, when not given.
        root: Folder that bounds what a URDF names; its own, or its package's.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    if not (measured / "sequence.json").is_file() and poses is not None:
        raise FreeArtError(f"gap: --poses goes with a video; {measured} has no sequence.json")
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    verdict: Any
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("Looking for what is missing", total=None)

        def told(what: str) -> Callable[[int, int], None]:
            return lambda done, total: bars.update(task, description=what, completed=done, total=total)

        if (measured / "sequence.json").is_file():
            from simgap.film.workflow import film_gap_folder

            verdict = film_gap_folder(asset, measured, out, poses, told("Comparing the films"), root)
        else:
            from simgap.settings import GapSettings
            from simgap.workflow import gap_folder

            settings, replayed = GapSettings(seconds=seconds), told("Replaying in SAPIEN")
            verdict = gap_folder(asset, measured, out, settings, replay_seconds, replayed, root)
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
    """Simulate measured runs from an asset's files alone, and say how far the simulation is from each.

    Only the state in which a run starts is free; it is fitted to the run and reported. `gap` has these very numbers.

    Args:
        asset: An asset folder or a URDF, with what lies beside it (effects.json; MJCF for MuJoCo).
        runs: Measured sets (with measured.json), or files of runs in such.
        out: New folder for replay.json, a curve of every run and a page.
        engine: What simulates: sapien, or mujoco, whose format cannot say all effects.
        holding: Of inputs of which the set does not say how they go on between their rows: 0 smoothly, 1 held [0].
        without_guesses: Leave out effects that asset.json calls guessed, as `gap` does.
        seconds: Seconds after which what is not replayed is given up.
        root: Folder that bounds what a URDF names; its own, or its package's.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from simgap.replay import format_table, replay_folder

    if not seconds > 0 or not (holding is None or 0 <= holding <= 1):
        raise FreeArtError(
            f"replay: --seconds is {seconds:g}, expected above 0, and --holding {holding}, expected 0 to 1"
        )
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task(f"Replaying in {engine}", total=None)

        def told(done: int, total: int) -> None:
            bars.update(task, completed=done, total=total)

        done = replay_folder(asset, runs, out, engine, holding, not without_guesses, seconds, told, root)
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
    """Write a self-contained page of a sequence, a result, an asset, a file of Gaussians or a data folder.

    Args:
        path: A sequence, result, truth, asset or data folder, a URDF, or a PLY of Gaussians.
        out: The page; NAME.html in the working folder when not given.
        truth: Truth folder to show beside a sequence or a result.
        sequence: Sequence folder of a result, for its video.
        root: Folder that bounds what a URDF names; its own, or its package's.
    """
    from freeart21.view import write_page

    page = out or Path(f"{path.resolve().name}.html")
    write_page(path, page, truth=truth, sequence=sequence, root=root)
    print(page)


def convert(
    source: Annotated[Path, Positional],
    out: Path,
    to: Literal["official", "native", "maniskill"],
    layout: Annotated[
        Literal["native", "rgbd", "official", "video2articulation", "maniskill"] | None, tyro.conf.arg(name="from")
    ] = None,
    partnet_root: Path | None = None,
    joint: str | None = None,
    meta: Path | None = None,
    hold_out: bool = False,
    skip_missing: bool = False,
    depth_unit: float = 0.001,
    fps: float | None = None,
) -> None:
    """Convert recordings between layouts: a camera's pictures, official, Video2Articulation-S, ManiSkill, our own.

    Args:
        source: A recording, or a folder of them.
        out: Folder to add to: a data folder (native), or one that gets examples/ and data/, or .h5 files.
        to: Layout to write.
        layout: Layout of the source; recognised by its files when not given.
        partnet_root: Folder that holds PartNet-Mobility objects, as ROOT/41083/mobility.urdf: truth needs their meshes.
        joint: Joint that moves, where neither the layout nor the catalog names one.
        meta: Video2Articulation's new_partnet_mobility_dataset_correct_intr_meta.json, for the joint's limits.
        hold_out: Write the official split: 5 % of the frames go to eval/.
        skip_missing: Leave out meshes that a PartNet-Mobility object names but does not have.
        depth_unit: Metres per depth unit of a plain folder of pictures (rgb/, depth/, masks/, cam_K.txt).
        fps: Frames a second of such a folder; by the time stamps in its names, or 30, when not given.
    """
    from functools import partial

    from freeart21.formats import convert as formats
    from generator.foreign import truth_of
    from generator.progress import progress_board

    maker = partial(truth_of, joint=joint, skip_missing=skip_missing)
    with progress_board(1, 0) as board:
        for done in formats.convert(
            source, out, to, layout, maker, partnet_root, meta, hold_out, depth_unit, fps, board.update
        ):
            board.finished(done.name)
            print(done.folder)
            for note in done.notes:
                print(f"{done.name}: {note}", file=sys.stderr)


def known_commands() -> dict[str, Callable[..., Any]]:
    """Every command by its name, in the order in which help names them: those of this file and of the rooms'."""
    commands = (
        doctor,
        demo,
        objects,
        record,
        teleop,
        verify,
        convert,
        reconstruct,
        export,
        joint_asset,
        check_asset,
        view,
        board.init_submission,
        board.import_,
        board.validate,
        board.score,
        board.compare,
        board.site,
        board.suite,
        board.pack,
        measure,
        gap,
        replay,
    )
    return {f.__name__.strip("_").replace("_", "-"): f for f in commands}


def main() -> None:
    """Run a command; every fault is one line on standard error (`in_one_line`), a known one with exit code 1."""
    commands = known_commands()
    if _told(sys.argv[1:], commands):
        return
    stopping.listen()
    with in_one_line():
        code = tyro.extras.subcommand_cli_from_dict(
            _with_settings_file(commands, sys.argv), prog="freeart21", description=DESCRIPTION
        )
    sys.exit(code or 0)


def _check_options(kind: str, given: dict[str, Any]) -> None:
    """FreeArtError when `measure` was given an option that is not of its kind of source."""
    from freeart21.help import OPTION_GROUPS

    defaults = inspect.signature(measure).parameters
    for heading, names in OPTION_GROUPS["measure"].items():
        whose = "truths" if "truths" in heading else "files"
        for name in names:
            if whose != kind and given[name] != defaults[name].default:
                sources = ", ".join(str(source) for source in given["sources"])
                raise FreeArtError(
                    f"measure: --{name.replace('_', '-')} is of {whose}, but this was taken for {kind}: {sources}"
                )


def _say_next(asset: Path, out: Path) -> None:
    """How a measured set is used."""
    print(f"{out / 'measured'}: now `freeart21 gap {asset} {out / 'measured'} --out GAP`")


def _told(argv: list[str], commands: dict[str, Callable[..., Any]]) -> bool:
    """Answer `--version` and `--help`, if that is what was asked for."""
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
    """`commands`, in which `reconstruct` starts from the settings of the file that `argv` names; `--settings.help` is
    turned into what prints them all."""
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


def _shown(state: float, joint_type: str) -> str:
    return f"{math.degrees(state):.1f} deg" if joint_type == "revolute" else f"{100 * state:.2f} cm"
