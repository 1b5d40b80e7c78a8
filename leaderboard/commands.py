"""The leaderboard's commands: tyro reads each function's signature, and the help its docstring.

Heavy imports are inside the functions, so that `freeart21 --help` is fast.
"""

from __future__ import annotations

import contextlib
import itertools
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

Positional: Any = tyro.conf.Positional
ExecutorName = Literal["local", "ray", "slurm"]


@contextlib.contextmanager
def progress_bar(text: str, counted: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar on a terminal; gives a function that updates it: text, number done, total."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    numbers = (MofNCompleteColumn(),) if counted else ()
    columns = (TextColumn("{task.description}"), BarColumn(), *numbers, TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task(text, total=None)
        yield lambda now, done, total: bars.update(task, description=now, completed=done, total=total)


def score(
    results: Annotated[Path, Positional],
    data: Path,
    protocol: str = "strict-3",
    out: Path | None = None,
    everything: Annotated[bool, tyro.conf.arg(name="all")] = False,
    truth: Path | None = None,
    workers: int = 2,
    executor: ExecutorName = "local",
) -> int:
    """Score a folder of results against the truth of a data folder.

    Joint and surfaces are measured from each result's asset/, loaded and driven in SAPIEN; without one, from
    prediction.json and parts/, and marked `files`. Masks, poses and held-out views are read from the result's files.
    The metrics are defined in docs/protocols.md. Exit code 1 when no sequence could be measured.

    Args:
        results: A method's results (RESULTS/SEQ/prediction.json), or a .zip of them.
        data: The data folder of the sequences.
        protocol: Protocol that defines the metrics: strict-3 (the ranking), strict-2 (the ranking before it), strict-1
            (joint from the asset, surfaces from parts/), paper-1 (as FreeArtGS's evaluator), itaco-1 (as iTACO's),
            arena-1 (the joint as a motion, limits included).
        out: Also write every metric to this JSON file.
        everything: Print every metric, not only the ranking ones.
        truth: The truth of a packed data folder (`freeart21 pack DATA --truth`).
        workers: Sequences scored in parallel, each by a process of up to 1.2 GiB; does not change the values.
        executor: Where they are scored: local (this machine), ray, or slurm. The last two need --out on a file system
            of all their machines.
    """
    import shutil
    import tempfile

    from freeart21.errors import FreeArtError
    from freeart21.files import atomic
    from freeart21.files.places import SCORES, check_place
    from leaderboard.archive import open_results
    from leaderboard.rows import Row
    from leaderboard.score import score_results
    from leaderboard.scores_file import write_scores
    from leaderboard.tables import print_scores

    if out is not None:
        check_place(out, SCORES, (data, *([truth] if truth else [])))
    work = None
    if executor != "local":
        if out is None:
            raise FreeArtError(f"score: --executor {executor} needs --out: rows are gathered in its folder")
        out.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}.", suffix=atomic.PART_SUFFIX))
    try:
        with open_results(results) as folder, progress_bar("Scoring") as show:
            count = itertools.count(1)

            def report(row: Row, of: int) -> None:
                show(f"Scored {row.sequence}", next(count), of)

            jobs = None if work is None else work / "jobs"
            scores = score_results(
                folder, data, protocol, report, workers=workers, executor=executor, work=jobs, truth=truth
            )
    finally:
        if work is not None:
            shutil.rmtree(work, ignore_errors=True)
    print_scores(scores, everything=everything)
    if out is not None:
        write_scores(out, scores)
    return 0 if scores.measured else 1


def compare(
    results: Annotated[tuple[Path, ...], Positional],
    data: Path,
    protocol: str | None = None,
    scores: Path | None = None,
    out: Path | None = None,
    by: Literal["type", "category", "sequence"] = "type",
    truth: Path | None = None,
) -> None:
    """Compare methods: mean and spread by joint type, and differences with confidence intervals over common sequences.

    Differences are to the first method, with paired bootstrap intervals of 95 %. Tables of different protocols,
    benchmarks or versions of the scoring code are refused.

    Args:
        results: Results folders (or .zip files), which are scored, or tables of `score --out`.
        data: The data folder of the sequences.
        protocol: Protocol; by default that of the tables, else strict-3.
        scores: Folder that caches the tables of scored results; they are scored again when something has changed.
        out: Also write the comparison to this file: .csv, .json (everything), .md, or .tex (booktabs).
        by: Group sequences by joint type or category, or list each sequence.
        truth: The truth of a packed data folder.
    """
    from freeart21.files.places import check_place
    from leaderboard.compare import compare_results
    from leaderboard.compare_files import kind_of, write_comparison
    from leaderboard.compare_tables import print_comparison
    from leaderboard.rows import Row

    if out is not None:
        check_place(out, kind_of(out), (data, *results))
    with progress_bar("Scoring") as show:
        finished: dict[Path, int] = {}

        def report(place: Path, row: Row, of: int) -> None:
            finished[place] = finished.get(place, 0) + 1
            show(f"Scored {place.name} {row.sequence}", finished[place], of)

        comparison = compare_results(results, data, protocol, scores, report, truth)
    print_comparison(comparison, by)
    if out is not None:
        write_comparison(out, comparison, by)


def validate(results: Annotated[Path, Positional], data: Path) -> int:
    """Check a folder of results without scoring it: every fault that `score` would meet, with its place and a fix.

    Exit code 1 when there is a fault. Needs the sequences of the data folder, not their truth.

    Args:
        results: A method's results (RESULTS/SEQ/prediction.json), or a .zip of them.
        data: The data folder of the sequences.
    """
    from leaderboard.archive import open_results
    from leaderboard.validate import validate_results

    with open_results(results) as folder:
        report = validate_results(folder, data)
    for fault in report.faults:
        print(f"{fault}{f'; fix: {fault.fix}' if fault.fix else ''}")
    for note in report.notes:
        print(f"note: {note}")
    if report.faults:
        n = len(report.faults)
        print(f"freeart21: {results} has {n} fault{'s' if n > 1 else ''}", file=sys.stderr)
        return 1
    print(f"{results}: {report.sequences} sequences, {report.answers} answers, {report.failures} failures: all well")
    return 0


def init_submission(data: Annotated[Path, Positional], out: Path) -> None:
    """Write a template of results to fill in: method.json and, for every sequence, each file in its format.

    Every prediction.json declares the failure "not solved yet", so that unfilled results are penalised. Its neighbour
    prediction.example.json shows an answer (with the right number of states), and poses.npz, part_mask/ and parts/ hold
    placeholders of the right shapes: replace them, then write prediction.json. `validate` lists the remaining faults.

    Args:
        data: The data folder of the sequences.
        out: New results folder, such as results/mine.
    """
    from leaderboard.skeleton import write_skeleton

    sequences = write_skeleton(data, out)
    print(f"{out}: {len(sequences)} sequences to fill in; see {out / 'README.txt'}")


def site(
    results: Annotated[tuple[Path, ...], Positional],
    out: Path,
    data: Path | None = None,
    protocol: tuple[str, ...] = (),
    scores: Path | None = None,
    title: str | None = None,
    truth: Path | None = None,
) -> None:
    """Write a static site: the ranking, a page per method and per sequence, failures, definitions, downloads.

    One folder that opens from disk or from any host and loads nothing from elsewhere. Methods are scored first, unless
    their tables are cached in the folder of --scores. A site of tables alone (scores/*.json) has every value, but
    neither videos nor answers. An older site at OUT is replaced, nothing else.

    Args:
        results: Results folders, one per method (RESULTS/SEQ/prediction.json), or tables of `score --out`.
        out: Folder of the site.
        data: The data folder of the sequences, with its truth; not needed for tables.
        protocol: Protocols, one table each; the first one orders the site. By default those of the tables, else
            strict-3.
        scores: Folder that caches the tables of scored results.
        title: Title of the site; by default the name of the data.
        truth: The truth of a packed data folder, for scoring. The site has nothing of it: answers are shown as they
            are, and joint states are scored in the means alone.
    """
    from leaderboard.site.build import write_site

    with progress_bar("Reading") as show:
        command = ["freeart21", *sys.argv[1:]]
        index = write_site(results, data, out, protocol, scores, title, command, show, truth)
    print(f"{out}: open {index}")


def import_(
    layout: Annotated[str, Positional],
    source: Annotated[Path, Positional],
    data: Path,
    out: Path,
    sequence: str | None = None,
    map: Path | None = None,
    frame: Annotated[str | None, tyro.conf.arg(metavar="camera|opengl|link|label|zup")] = None,
    axes: Annotated[str | None, tyro.conf.arg(metavar="opencv|opengl")] = None,
    anchor: int = 0,
    scale: float = 1.0,
    joint: str | None = None,
    object_poses: Path | None = None,
    name: str | None = None,
) -> None:
    """Convert the output of another project to a results folder, for scoring.

    Layouts: freeartgs, itaco, rsrd, paris, digitaltwinart, artgs, articulate-anything, bundlesdf, foundationpose,
    screwsplat. docs/adapters.md lists what each provides, lacks and means. Results are read from SOURCE/SEQ for every
    sequence of the data folder; its truth is not read. Metrics that need what a layout lacks get no value.

    Args:
        layout: Layout of the files.
        source: Folder with a result per sequence, or with one result.
        data: The data folder of the sequences.
        out: Results folder to write, such as results/NAME; an older import of the same layout is replaced.
        sequence: SOURCE is the result of this one sequence.
        map: JSON file of {"SEQ": "folder in SOURCE"}, or {"SEQ": {"folder": ..., and any of frame, axes, anchor, scale,
            joint}}.
        frame: World frame of the files, if they do not define it; by default that of the project's own evaluator.
        axes: Camera axes of the files; by default those of the project's own evaluator.
        anchor: Frame of the video that shows the state of a result without poses.
        scale: Metres per unit of length of the files.
        joint: Joint to import, by name or number, if there are several.
        object_poses: Official FreeArt-21 examples, for world frames that are fixed to the object.
        name: Name of the method; by default that of the results folder.
    """
    from leaderboard.adapters.importer import import_results
    from leaderboard.adapters.layout import Options

    options = Options(frame, axes, anchor, scale, joint, object_poses)  # type: ignore[arg-type]  # checked there
    with progress_bar("Importing") as show:
        imported = import_results(layout, source, data, out, options, sequence, map, name, show)
    for key, lines in imported.notes.items():
        for line in lines:
            print(f"{key}: {line}")
    if imported.missing:
        some = ", ".join(imported.missing[:5]) + (", ..." if len(imported.missing) > 5 else "")
        print(f"no result for {len(imported.missing)} sequences ({some}): the score will penalise them")
    lacks = f"; it lacks {', '.join(imported.lacks)}" if imported.lacks else ""
    failed = f", {len(imported.failures)} declared failures" if imported.failures else ""
    print(f"{out}: {len(imported.sequences)} answers{failed}{lacks}")


def run(
    method: Annotated[str, Positional],
    data: Annotated[Path, Positional],
    out: Path,
    home: Path | None = None,
    sequences: tuple[str, ...] = (),
    engine: str = "docker",
    truth: Path | None = None,
) -> None:
    """Run a method over a data folder, within its limits, and measure time and memory: a results folder to score.

    A descriptor (JSON, docs/adapters.md) says which commands, in which container image if any, which inputs, and which
    layout of results. The same command goes on where a run was stopped. What a method writes is read as a stranger's;
    where it fails, the failure is declared with its reason. A command without an image runs with your rights: pack the
    data (`freeart21 pack`) when its truth has to be out of reach. run.json has time, memory and versions.

    Args:
        method: Descriptor, a .json, or the name of a shipped one (two-motions, rigid-clusters, masked-icp, freeartgs,
            itaco, bundlesdf, foundationpose, articulate-anything, videoartgs).
        data: The data folder of the sequences.
        out: Results folder, such as results/NAME.
        home: The method's own checkout, if its commands name it.
        sequences: Some sequences of the data folder; by default all.
        engine: Program that runs images: docker or podman.
        truth: The truth of a packed data folder, for methods that are given part masks or meshes of it.
    """
    from leaderboard.methods.descriptor import find_descriptor
    from leaderboard.methods.run import run_method

    with progress_bar("Running", counted=True) as show:
        report = run_method(
            find_descriptor(method), data, out, home, sequences, engine, truth,
            lambda name, done, total: show(f"Running {name}", done, total),
        )  # fmt: skip
    for name, entry in report.entries.items():
        if entry.outcome == "failure":
            print(f"{name}: {entry.reason}")
    answers = sum(entry.outcome == "answer" for entry in report.entries.values())
    slowest = max((entry.seconds for entry in report.entries.values()), default=0.0)
    largest = max((entry.peak_bytes for entry in report.entries.values()), default=0)
    print(
        f"{out}: {answers} answers, {len(report.entries) - answers} declared failures, {len(report.skipped)} of them "
        f"from before; at most {slowest:.1f} s and {largest / 1e9:.2f} GB a sequence"
    )


def suite(
    data: Annotated[Path, Positional],
    out: Path,
    rows: tuple[str, ...] = (),
    sequences: tuple[str, ...] = (),
    protocols: tuple[str, ...] = ("strict-3",),
    workers: int = 1,
    executor: ExecutorName = "local",
    list_rows: Annotated[bool, tyro.conf.arg(name="list")] = False,
    dry_run: bool = False,
) -> int:
    """Run and score reference rows over a data folder: our method, our method without each of its parts, the paper's
    segmentation and its ablations, other sensors, and the truth, a static object and random numbers as checks.

    First prints a forecast of time and disk space. A stopped run continues with the same command. Exit code 1 when a
    job failed (the others are done, and the same command retries it), when the truth does not score perfectly, or when
    the static or random row does not score badly.

    Args:
        data: A data folder (with benchmark.json and its truth).
        out: Folder of the suite: results/ROW, scores/ROW.PROTOCOL.json, data/SENSOR, jobs.json.
        rows: Rows or groups of rows (see --list); by default all.
        sequences: Some sequences of the data folder; by default all.
        protocols: Protocols that the rows are scored by.
        workers: Jobs in parallel.
        executor: Where they run: local (this machine), ray (RAY_ADDRESS names a cluster), or slurm (sbatch's variables
            choose the partition). The last two need DATA and --out on a file system of all machines.
        list_rows: List the rows and exit.
        dry_run: Print the forecast and exit.
    """
    from rich.console import Console

    from freeart21 import stopping
    from freeart21.jobs.executors import executor_named
    from freeart21.jobs.progress import format_duration, job_progress
    from freeart21.jobs.run import unfinished_jobs
    from leaderboard.suite.rows import choose_rows
    from leaderboard.suite.table import print_table
    from leaderboard.suite.workflow import prepare, print_rows, run_suite

    if list_rows:
        print_rows(choose_rows(rows))
        return 0
    plan = prepare(data, out, rows, sequences or None, protocols)
    executor_named(executor, workers, out)
    seconds_by_kind: dict[str, list[float]] = {}
    for job in plan.todo:
        seconds_by_kind.setdefault(job.kind, []).append(job.seconds)
    jobs, done = len(plan.plan.jobs), len(plan.plan.jobs) - len(plan.todo)
    print(
        f"{len(plan.plan.rows)} rows over {len(plan.plan.sequences)} sequences: {jobs} jobs, "
        f"{done} of them done; the others take about {format_duration(plan.seconds / workers)} and "
        f"{plan.bytes / 1e9:.2f} GB of {plan.free_bytes / 1e9:.0f} GB free"
    )
    for kind, seconds in seconds_by_kind.items():
        print(f"  {kind}: {len(seconds)} jobs, about {format_duration(sum(seconds))} of one worker")
    if dry_run:
        return 0
    message = f"finished jobs stay in {out}: the same command continues"
    with (
        stopping.resume_hint(lambda: message if unfinished_jobs(out, plan.plan.jobs) and out.is_dir() else ""),
        job_progress(plan.todo, workers) as listener,
    ):
        outcome = run_suite(plan, workers, executor, listener=listener)
    console = Console()
    for protocol, tables in outcome.tables.items():
        print_table(protocol, tables, console)
    for failed in outcome.failed:
        print(f"freeart21: {failed.name}: {failed.reason}", file=sys.stderr)
    for objection in outcome.objections:
        print(f"freeart21: {objection}", file=sys.stderr)
    print(f"{out / 'scores'}: every value; `freeart21 compare {out / 'results'}/* --data {data}` compares rows")
    return 1 if outcome.failed or outcome.objections else 0


def pack(
    data: Annotated[Path, Positional],
    out: Path,
    public: bool = False,
    truth: bool = False,
    keep_names: bool = False,
    key: Path | None = None,
) -> None:
    """Split a data folder: the public half for methods (--public), or its truth for scoring (--truth).

    The public half has nothing of the truth: pictures and JSON are rewritten from their content, sequences have
    meaningless names, file times are equal, and benchmark.json has a salted hash of the truth. Score with
    `freeart21 score RESULTS --data PUBLIC --truth TRUTH`. Names and salt come from a key; both halves need the same.
    A recording that others can repeat is not hidden: give hidden sets a large secret seed.

    Args:
        data: A data folder (with benchmark.json).
        out: Folder to write, or a ZIP if its name ends in .zip.
        public: Write the public half.
        truth: Write the truth.
        keep_names: Keep the names of the sequences.
        key: File with the key, created when missing; by default DATA.key in the parent folder.
    """
    from freeart21.errors import FreeArtError
    from freeart21.files.places import check_place
    from leaderboard.pack import PUBLIC, TRUTH, default_key_path, pack_public, pack_truth

    if public == truth:
        raise FreeArtError("pack: name one half, --public or --truth")
    key = key or default_key_path(data)
    is_new = not key.exists()
    check_place(out, None if out.suffix == ".zip" else PUBLIC if public else TRUTH, (data, key))
    with progress_bar("Packing") as show:
        (pack_public if public else pack_truth)(data, out, key, keep_names, partial(show, "Packing"))
    print(out)
    if is_new and key.exists():
        print(f"{key}: the secret key of both halves; keep it")


def tags(out: Path, side_mm: float = 30.0) -> None:
    """Print sheets of tags to stick on a real object, so that `truth-by-markers` can measure its joint.

    Tags 0 to 24 are for the base, 25 to 49 for the moving part. Several on each part, on all sides that the camera
    sees, flat, with their white rim; the video must show tags of both parts at once.

    Args:
        out: The PDF, A4. Print it at 100 % and measure its 100 mm line.
        side_mm: Side of a tag's black square; at least 30 pixels wide in the video.
    """
    from freeart21.errors import FreeArtError
    from leaderboard.markers import print_tags

    if out.exists():
        raise FreeArtError(f"{out} exists and is not replaced; name another file by --out")
    print(f"{out}: {print_tags(out, side_mm / 1000)} pages")


def lpips(results: Annotated[Path, Positional], data: Path, alexnet: Path, out: Path | None = None) -> None:
    """Measure LPIPS of a results folder's held-out views, beside the protocols' own figures.

    AlexNet of version 0.1; the package lpips has the weights of the linear layers (pip install --no-deps lpips==0.1.4).

    Args:
        results: Results folder of a method.
        data: Data folder.
        alexnet: torchvision's alexnet-owt-7be5be79.pth, from download.pytorch.org/models.
        out: Also write the numbers to this JSON file.
    """
    import numpy as np

    from freeart21.errors import FreeArtError
    from freeart21.files import atomic
    from freeart21.files.benchmark import read_benchmark
    from leaderboard.lpips import Lpips, measure_views
    from leaderboard.score import check_results_folder

    if out is not None and out.exists():
        raise FreeArtError(f"{out} exists and is not replaced; name another file by --out")
    benchmark = read_benchmark(data)
    check_results_folder(results, benchmark.sequences)
    with progress_bar("views") as report:
        found = measure_views(results, benchmark, Lpips(alexnet), lambda done, total: report("views", done, total))
    values = [value for value in found.values() if value is not None]
    for name, value in found.items():
        print(f"{name:40} {'-' if value is None else f'{value:.4f}'}")
    mean = float(np.mean(values)) if values else None
    print(f"{'mean':40} {'-' if mean is None else f'{mean:.4f}'}")
    if out is not None:
        atomic.write_json(out, {"schema": "freeart21/lpips/1", "mean": mean, "sequences": found})


def truth_by_markers(
    sequence: Annotated[Path, Positional],
    side_mm: float,
    out: Path | None = None,
    base: tuple[int, ...] = (),
    moving: tuple[int, ...] = (),
    result: Path | None = None,
) -> int:
    """Measure the joint of a filmed object from printed tags on both parts, and compare a result with it.

    Reads the colour pictures and the camera's intrinsics alone: no depth, no mask, no solver. Exit code 3 when one
    joint does not explain the corners.

    Args:
        sequence: A sequence folder (with sequence.json), such as `convert` makes.
        side_mm: Side of the tags' black squares as measured on the print.
        out: Also write the joint, states, poses and deviations to this JSON file.
        base: Tags on the base; those of 0 to 24 when not given.
        moving: Tags on the moving part; those of 25 to 49 when not given.
        result: Result folder of any method for this video, to be compared.
    """
    import numpy as np

    from freeart21.errors import FreeArtError
    from freeart21.files.result import read_result
    from freeart21.files.sequence import read_sequence
    from freeart21.reconstruction import Failure
    from leaderboard import markers

    if out is not None and out.exists():
        raise FreeArtError(f"{out} exists and is not replaced; name another file by --out")
    if not 1 <= side_mm <= 1000:
        raise FreeArtError(f"--side-mm is {side_mm:g}, expected 1 to 1000 millimetres")
    answer = None if result is None else read_result(result)
    if isinstance(answer, Failure):
        raise FreeArtError(f"{result} is a failure, {answer.stage}: {answer.reason}; there is nothing to compare")
    recording = read_sequence(sequence)
    with progress_bar("tags") as report:
        corners = markers.find_corners(recording, lambda done, total: report("tags", done, total))
    half = markers.TAGS // 2
    base, moving = base or tuple(range(half)), moving or tuple(range(half, 2 * half))
    found = markers.measure_joint(corners, recording.camera, side_mm / 1000, base, moving)
    difference = None if answer is None else markers.compare(found, answer)
    joint = found.joint
    turn, unit = (np.degrees, "deg") if joint.type == "revolute" else (lambda metres: 1000 * metres, "mm")
    frames = f"{len(found.frames)} of {len(recording)} frames show tags of both parts"
    print(f"{joint.type}, moved by {turn(joint.upper - joint.lower):.2f} {unit}; {frames}")
    pivot = "" if found.pivot_std is None else f", pivot {1000 * found.pivot_std:.2f} mm"
    state = f"states {turn(np.median(found.state_std)):.3f} {unit}"
    print(f"standard deviations: axis {np.degrees(found.axis_std):.3f} deg{pivot}, {state}")
    errors = f"free parts {found.free_pixel_error:.2f}, the other joint type {found.other_pixel_error:.2f}"
    print(f"median error of a corner: {found.pixel_error:.2f} pixels; {errors}")
    if difference is not None:
        print(f"{result}: {_describe_difference(difference, joint.type, turn, unit)}")
    if out is not None:
        markers.write_marker_joint(out, found, side_mm / 1000, difference)
        print(out)
    if not found.explains:
        print("one joint does not explain the corners: a loose hinge, a bent print, or a tag on the wrong part")
    return 0 if found.explains else 3  # as `reconstruct` of a doubtful answer


def _describe_difference(difference: Any, kind: str, turn: Callable[[Any], Any], unit: str) -> str:
    if not difference.same_type:
        other = "prismatic" if kind == "revolute" else "revolute"
        return f"{other}, expected {kind}; its axis is {difference.axis_deg:.2f} deg off"
    pivot = "" if difference.pivot_m is None else f", pivot {1000 * difference.pivot_m:.1f} mm"
    return f"axis {difference.axis_deg:.2f} deg off{pivot}, states {turn(difference.state):.2f} {unit}"


def board(
    action: Annotated[Literal["init", "check", "score", "verify"], Positional],
    folder: Annotated[Path, Positional],
    data: tuple[str, ...] = (),
    title: str = "",
    package: str = "",
    base: str = "origin/main",
    out: Path | None = None,
) -> int:
    """A leaderboard in a git repository: write it, check a pull request, score and sign what is new, verify all.

    init writes the repository, and next to it the private key that signs. check finds what speaks against merging a
    branch: exit code 1. score scores new submissions in a container without network, or in a bounded process, and
    writes tables, the signed ledger and the site. verify checks signature and tables: exit code 1. docs/board.md.

    Args:
        action: init, check, score or verify.
        folder: The repository's folder.
        data: For init: the public half of each phase's data (one: a phase without end; two: development and test), a
            path relative to the repository or the https address of a ZIP.
        title: For init: title of the board.
        package: For init: what pip installs on the runner; by default this version of freeart21.
        base: For check: the branch to merge into.
        out: For score: folder of the site, outside of the repository.
    """
    from freeart21.errors import FreeArtError
    from leaderboard.board.ledger import verify_board
    from leaderboard.board.settings import read_settings
    from leaderboard.board.workflow import check_pull_request, init_board, score_board

    if action == "init":
        if not data:
            raise FreeArtError("board init: got no --data, expected the public half of the data (`freeart21 pack`)")
        key = init_board(folder, data, title, package)
        print(f"{folder}: `git init` it, and read its README.md\n{key}: the private key that signs; keep it secret")
        return 0
    if action == "score":
        outcome = score_board(folder, out)
        print(f"{folder}: {outcome.scored} scored, {outcome.refused} refused, {outcome.waiting} waiting")
        return 0
    settings = read_settings(folder)
    faults = check_pull_request(folder, base) if action == "check" else verify_board(folder, settings)
    for fault in faults:
        print(fault)
    if not faults:
        print(f"{folder}: all well")
    return 1 if faults else 0


def release(
    data: Annotated[tuple[Path, ...], Positional],
    out: Path,
    to: Literal["shards", "coco", "bop"] = "shards",
    per_shard: int = 64,
    doi: str = "",
) -> None:
    """Write data folders as they are published: tar shards with a manifest, COCO instances, or BOP scenes.

    shards: files of a bounded number of sequences, each a whole data folder, manifest.parquet (hash, seed, hardness,
    licence, preview of each sequence) and the card, as the Hugging Face hub shows them. coco: masks of both parts in
    one JSON file, without pictures. bop: pictures, masks, poses and models of both parts.

    Args:
        data: Data folders of one name, version and split; one for coco and bop, with its truth.
        out: New folder.
        to: Form: shards, coco or bop.
        per_shard: Most sequences in a shard.
        doi: DOI of the data set, once it has one, such as 10.5281/zenodo.123.
    """
    from freeart21.errors import FreeArtError
    from freeart21.files.places import check_place
    from leaderboard.release.bop import write_bop
    from leaderboard.release.coco import write_coco
    from leaderboard.release.shards import write_shards

    check_place(out, None, data)
    if to != "shards" and len(data) != 1:
        raise FreeArtError(f"release: got {len(data)} data folders, expected one data folder for {to}")
    with progress_bar("Writing") as show:
        if to == "shards":
            count, what = write_shards(data, out, per_shard, doi, show), "shard"
        elif to == "coco":
            count, what = write_coco(data[0], out, show), "annotation"
        else:
            count, what = write_bop(data[0], out, show), "scene"
    print(f"{out}: {count} {what}{'s' * (count != 1)}")
