"""The commands of the leaderboard, each a plain function; tyro reads its signature, and help its docstring.

What a command needs is imported inside it: `freeart21 --help` needs nothing heavy.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

Positional = tyro.conf.Positional
ExecutorName = Literal["local", "ray", "slurm"]


def score(
    results: Annotated[Path, Positional],
    data: Path,
    protocol: str = "strict-2",
    out: Path | None = None,
    everything: Annotated[bool, tyro.conf.arg(name="all")] = False,
    truth: Path | None = None,
    workers: int = 2,
    executor: ExecutorName = "local",
) -> int:
    """Score a folder of results against the truth of a data folder.

    Joint and surfaces are measured from each result's asset/, loaded and driven in SAPIEN; without one, from
    prediction.json and parts/ and marked `files`. Masks, poses and held-out views are read from the result's files.
    What each number means: docs/protocols.md. Exit code 1 when no sequence could be measured.

    Args:
        results: A method's results (RESULTS/SEQ/prediction.json), or a .zip of them.
        data: The data folder they answer.
        protocol: Named protocol, what each number means: strict-2 (the ranking), strict-1 (joint from the asset,
            surfaces from parts/), paper-1 (as FreeArtGS's evaluator), itaco-1 (as iTACO's), arena-1 (the joint as a
            motion, limits included).
        out: Write every number as JSON here, too.
        everything: Print every number, not only the ranking ones.
        truth: Where the truth of a packed data folder lies (`freeart21 pack DATA --truth`).
        workers: Sequences that are scored at a time, each by a process of up to 1.2 GiB; the numbers do not depend on
            it.
        executor: Where they are scored: local (this machine), ray, or slurm, which need --out on a file system that all
            their machines see.
    """
    import shutil
    import tempfile

    from rich.console import Console
    from rich.progress import Progress

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
            raise FreeArtError(f"score: --executor {executor} needs --out: rows are gathered beside it")
        out.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}.", suffix=atomic.PART_SUFFIX))
    console = Console(stderr=True)
    with (
        open_results(results) as folder,
        Progress(console=console, transient=True, disable=not console.is_terminal) as bars,
    ):
        task = bars.add_task("Scoring", total=None)

        def scored(row: Row, of: int) -> None:
            bars.update(task, description=f"Scored {row.sequence}", advance=1, total=of)

        try:
            rows = None if work is None else work / "jobs"
            scores = score_results(
                folder, data, protocol, scored, workers=workers, executor=executor, work=rows, truth=truth
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
    """Compare methods: mean and spread by joint type, and how sure their differences are, over the same sequences.

    Differences are to the method that is named first, with paired bootstrap intervals of 95 %. Numbers of different
    protocols, benchmarks or versions of the scoring code are refused, never set side by side.

    Args:
        results: Results folders (or .zip of them), which are scored, or tables of `score --out`.
        data: The data folder that they answer.
        protocol: Named protocol; that of the tables, or strict-2, when not given.
        scores: Keep the tables of scores of results folders here, and score them again only when something changed.
        out: Write the comparison here, too: .csv, .json (everything), .md, or .tex (booktabs).
        by: What is summed up together: sequences of a joint type, of a category, or each for itself.
        truth: Where the truth of a packed data folder lies.
    """
    from rich.console import Console
    from rich.progress import Progress, TaskID

    from freeart21.files.places import check_place
    from leaderboard.compare import compare_results
    from leaderboard.compare_files import kind_of, write_comparison
    from leaderboard.compare_tables import print_comparison
    from leaderboard.rows import Row

    if out is not None:
        check_place(out, kind_of(out), (data, *results))
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks: dict[Path, TaskID] = {}

        def scored(place: Path, row: Row, of: int) -> None:
            if place not in tasks:
                tasks[place] = bars.add_task("", total=of)
            bars.update(tasks[place], description=f"Scored {place.name} {row.sequence}", advance=1, total=of)

        comparison = compare_results(results, data, protocol, scores, scored, truth)
    print_comparison(comparison, by)
    if out is not None:
        write_comparison(out, comparison, by)


def validate(results: Annotated[Path, Positional], data: Path) -> int:
    """Check a folder of results as `score` will read it, without measuring: every fault, with its place and its cure.

    Exit code 1 when there is a fault. Needs the sequences of the data folder, not their truth.

    Args:
        results: A method's results (RESULTS/SEQ/prediction.json), or a .zip of them.
        data: The data folder they answer.
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
    """Write a skeleton of results to fill in: method.json and, for every sequence, each file in its format.

    Every prediction.json declares the failure "not solved yet": what is not filled in is priced, never scored as an
    answer. Beside it prediction.example.json shows an answer (of the right number of states), and poses.npz, part_mask/
    and parts/ hold placeholders of the right shapes: replace them, then write prediction.json. `validate` says what is
    still wrong.

    Args:
        data: The data folder to answer.
        out: Results folder to make, such as results/mine; it must not exist.
    """
    from leaderboard.skeleton import write_skeleton

    sequences = write_skeleton(data, out)
    print(f"{out}: {len(sequences)} sequences to fill in; {out / 'README.txt'} says how")


def site(
    results: Annotated[tuple[Path, ...], Positional],
    out: Path,
    data: Path | None = None,
    protocol: tuple[str, ...] = (),
    scores: Path | None = None,
    title: str | None = None,
    truth: Path | None = None,
) -> None:
    """Write a static site: the ranking, a page a method and a sequence, failures, definitions, downloads.

    One folder that opens from disk or from any host and fetches nothing from elsewhere. Methods are scored first,
    unless their tables are kept in the folder of --scores; of tables alone (scores/*.json) the site has every number,
    and neither videos nor answers. An older site at the place is replaced, nothing else.

    Args:
        results: Folders of results, one a method (RESULTS/SEQ/prediction.json), or tables of `score --out`.
        out: Folder of the site.
        data: The data folder that they answer, with its truth; tables need none.
        protocol: Named protocols, a table each, the first one orders the site; those of the tables, or strict-2, when
            not given.
        scores: Folder in which tables of scores are kept.
        title: What the site is called; the name of the data when not given.
        truth: Where the truth of a packed data folder lies, to score against. Nothing of it is in the site: answers
            stand as they are, and joint states are scored in the means alone.
    """
    from rich.console import Console
    from rich.progress import Progress

    from leaderboard.site.build import write_site

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("Reading", total=None)

        def done(what: str, count: int, of: int) -> None:
            bars.update(task, description=what, completed=count, total=of)

        command = ["freeart21", *sys.argv[1:]]
        index = write_site(results, data, out, protocol, scores, title, command, done, truth)
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
    """Make a results folder of what another project wrote, to be scored beside the others.

    Layouts: freeartgs, itaco, rsrd, paris, digitaltwinart, artgs, articulate-anything, bundlesdf, foundationpose,
    screwsplat. What each gives, lacks and means: docs/adapters.md. Results are looked for in SOURCE/SEQ for every
    sequence of the data folder, whose truth is not read. What a layout does not give is left out of its score.

    Args:
        layout: Whose files these are.
        source: Folder with a result a sequence, or with one result.
        data: The data folder that they answer.
        out: Results folder to make, such as results/NAME; an older import of the same layout is replaced.
        sequence: SOURCE is the result of this one sequence.
        map: JSON file of {"SEQ": "folder in SOURCE"}, or {"SEQ": {"folder": ..., and any of frame, axes, anchor, scale,
            joint}}.
        frame: Where the world of the files stands, if they do not say; else as in the project's own evaluator.
        axes: Axes of the cameras in the files; else as in the project's own evaluator.
        anchor: Frame of the video at which a result without poses stands.
        scale: Metres in one unit of length of the files.
        joint: Which joint, by name or number, if there are several.
        object_poses: Official FreeArt-21 examples, for frames that hang on the object.
        name: Of the method; else as the results folder is called.
    """
    from rich.console import Console
    from rich.progress import Progress

    from leaderboard.adapters.importer import import_results
    from leaderboard.adapters.toolbox import Options

    options = Options(frame, axes, anchor, scale, joint, object_poses)  # type: ignore[arg-type]  # checked there
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("Importing", total=None)

        def begun(sequence: str, done: int, total: int) -> None:
            bars.update(task, description=f"Importing {sequence}", completed=done, total=total)

        report = import_results(layout, source, data, out, options, sequence, map, name, begun)
    for key, lines in report.notes.items():
        for line in lines:
            print(f"{key}: {line}")
    if report.missing:
        some = ", ".join(report.missing[:5]) + (", ..." if len(report.missing) > 5 else "")
        print(f"nothing of {len(report.missing)} sequences ({some}): the score will price them")
    lacks = f"; it lacks {', '.join(report.lacks)}" if report.lacks else ""
    failed = f", {len(report.failures)} declared failures" if report.failures else ""
    print(f"{out}: {len(report.sequences)} answers{failed}{lacks}")


def suite(
    data: Annotated[Path, Positional],
    out: Path,
    rows: tuple[str, ...] = (),
    sequences: tuple[str, ...] = (),
    protocols: tuple[str, ...] = ("strict-2",),
    workers: int = 1,
    executor: ExecutorName = "local",
    list_rows: Annotated[bool, tyro.conf.arg(name="list")] = False,
    dry_run: bool = False,
) -> int:
    """Run and score reference rows over a data folder: ours, ours without each of its pieces, the paper's segmentation
    and its ablations, other sensors, the truth, nothing that moves, a dice.

    Says first how long it will take and how much room it needs. May be stopped at any moment: the same command goes on,
    nothing is done twice. Exit code 1 when a job failed (the others are done, and it is tried again next time), or when
    the truth does not score perfect, or luck does not score badly.

    Args:
        data: A data folder (with benchmark.json and its truth).
        out: Folder of the suite: results/ROW, scores/ROW.PROTOCOL.json, data/SENSOR, jobs.json.
        rows: Rows or groups of rows (--list names them); all when not given.
        sequences: Some of the data folder's; all when not given.
        protocols: By which the rows are scored.
        workers: Jobs at a time.
        executor: Where they run: local (this machine), ray (RAY_ADDRESS names a cluster), or slurm (sbatch's variables
            choose the partition); for these, DATA and --out lie on a file system that all machines see.
        list_rows: List the rows, and do nothing.
        dry_run: Say what would be done and what it would cost, and do nothing.
    """
    from rich.console import Console

    from freeart21 import stopping
    from freeart21.jobs.executors import executor_named
    from freeart21.jobs.progress import format_duration, job_progress
    from freeart21.jobs.run import unfinished_jobs
    from leaderboard.suite.rows import chosen_rows
    from leaderboard.suite.table import print_table
    from leaderboard.suite.workflow import prepare, print_rows, run_suite

    if list_rows:
        print_rows(chosen_rows(rows))
        return 0
    plan = prepare(data, out, rows, sequences or None, protocols)
    executor_named(executor, workers, out)
    kinds: dict[str, list[float]] = {}
    for job in plan.todo:
        kinds.setdefault(job.kind, []).append(job.seconds)
    jobs, done = len(plan.plan.jobs), len(plan.plan.jobs) - len(plan.todo)
    print(
        f"{len(plan.plan.rows)} rows over {len(plan.plan.sequences)} sequences: {jobs} jobs, "
        f"{done} of them done; the others take about {format_duration(plan.seconds / workers)} and "
        f"{plan.bytes / 1e9:.2f} GB of {plan.free_bytes / 1e9:.0f} GB free"
    )
    for kind, seconds in kinds.items():
        print(f"  {kind}: {len(seconds)} jobs, about {format_duration(sum(seconds))} of one worker")
    if dry_run:
        return 0
    kept = f"what is done is kept in {out}: the same command goes on"
    with (
        stopping.resume_hint(lambda: kept if unfinished_jobs(out, plan.plan.jobs) and out.is_dir() else ""),
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
    print(
        f"{out / 'scores'}: every number; `freeart21 compare {out / 'results'}/* --data {data}` sets rows side by side"
    )
    return 1 if outcome.failed or outcome.objections else 0


def pack(
    data: Annotated[Path, Positional],
    out: Path,
    public: bool = False,
    truth: bool = False,
    keep_names: bool = False,
    key: Path | None = None,
) -> None:
    """Split a data folder: what methods may see, to hand out (--public), or its truth, to score against (--truth).

    The public half holds nothing of the truth: pictures and JSON are written anew from what they show, sequences have
    names that tell nothing, times are all the same, and benchmark.json has a salted hash of the truth. Score with
    `freeart21 score RESULTS --data PUBLIC --truth TRUTH`. Names and salt come from a key; both halves need the same.
    Nothing hides a recording that others can make again: give hidden sets a large seed that nobody knows.

    Args:
        data: A data folder (with benchmark.json).
        out: Folder to make, or a ZIP where its name ends in .zip.
        public: Write what methods may see.
        truth: Write the truth.
        keep_names: Leave the names of sequences as they are.
        key: File with the key, made where there is none; DATA.key beside the data folder when not given.
    """
    from rich.console import Console
    from rich.progress import Progress

    from freeart21.errors import FreeArtError
    from freeart21.files.places import check_place
    from leaderboard.pack import PUBLIC, TRUTH, default_key_path, pack_public, pack_truth

    if public == truth:
        raise FreeArtError("pack: say which half, --public or --truth; it takes one of them")
    key = key or default_key_path(data)
    made = not key.exists()
    check_place(out, None if out.suffix == ".zip" else PUBLIC if public else TRUTH, (data, key))
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("Packing", total=None)

        def told(done: int, of: int) -> None:
            bars.update(task, completed=done, total=of)

        (pack_public if public else pack_truth)(data, out, key, keep_names, told)
    print(out)
    if made and key.exists():
        print(f"{key}: the key of both halves; keep it, and hand it to nobody")
