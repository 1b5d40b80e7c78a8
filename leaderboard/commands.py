"""The leaderboard's commands: tyro reads each function's signature, and the help its docstring.

Heavy imports are inside the functions, so that `freeart21 --help` is fast.
"""

from __future__ import annotations

import itertools
import sys
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

Positional: Any = tyro.conf.Positional
ExecutorName = Literal["local", "ray", "slurm"]


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
    import contextlib
    import tempfile

    from freeart21.errors import FreeArtError
    from freeart21.files import atomic
    from freeart21.files.places import SCORES, check_place
    from freeart21.progress import progress_bar
    from leaderboard.archive import open_results
    from leaderboard.rows import Row
    from leaderboard.score import score_results
    from leaderboard.scores_file import write_scores
    from leaderboard.tables import print_scores

    if out is not None:
        check_place(out, SCORES, (data, *([truth] if truth else [])))
    with contextlib.ExitStack() as stack:
        work = None
        if executor != "local":
            if out is None:
                raise FreeArtError(f"score: --executor {executor} needs --out: rows are gathered in its folder")
            out.parent.mkdir(parents=True, exist_ok=True)
            place = tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.", suffix=atomic.PART_SUFFIX)
            work = Path(stack.enter_context(place)) / "jobs"
        folder, show = stack.enter_context(open_results(results)), stack.enter_context(progress_bar("Scoring"))
        count = itertools.count(1)

        def report(row: Row, of: int) -> None:
            show(f"Scored {row.sequence}", next(count), of)

        scores = score_results(
            folder, data, protocol, report, workers=workers, executor=executor, work=work, truth=truth
        )
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
    from freeart21.progress import progress_bar
    from leaderboard.compare import compare_results
    from leaderboard.compare_tables import kind_of, print_comparison, write_comparison
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
    """Write a static site: the ranking, a page per method and per sequence, failures, definitions.

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
    from freeart21.progress import progress_bar
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

    Layouts: freeartgs, itaco, artgs, articulate-anything, bundlesdf, foundationpose, screwsplat. docs/adapters.md lists
    what each provides, lacks and means. Results are read from SOURCE/SEQ for every sequence of the data folder; its
    truth is not read. Metrics that need what a layout lacks get no value.

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
    from freeart21.progress import progress_bar
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
        method: Descriptor, a .json, or the name of a shipped one (two-motions, rigid-clusters, masked-icp, paper,
            freeartgs, itaco, bundlesdf, foundationpose, articulate-anything, videoartgs).
        data: The data folder of the sequences.
        out: Results folder, such as results/NAME.
        home: The method's own checkout, if its commands name it.
        sequences: Some sequences of the data folder; by default all.
        engine: Program that runs images: docker or podman.
        truth: The truth of a packed data folder, for methods that are given part masks or meshes of it.
    """
    from freeart21.progress import progress_bar
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
        out: Folder to write.
        public: Write the public half.
        truth: Write the truth.
        keep_names: Keep the names of the sequences.
        key: File with the key, created when missing; by default DATA.key in the parent folder.
    """
    from freeart21.errors import FreeArtError
    from freeart21.files.places import check_place
    from freeart21.progress import progress_bar
    from leaderboard.pack import PUBLIC, TRUTH, default_key_path, pack_public, pack_truth

    if public == truth:
        raise FreeArtError("pack: name one half, --public or --truth")
    key = key or default_key_path(data)
    is_new = not key.exists()
    check_place(out, PUBLIC if public else TRUTH, (data, key))
    with progress_bar("Packing") as show:
        (pack_public if public else pack_truth)(data, out, key, keep_names, partial(show, "Packing"))
    print(out)
    if is_new and key.exists():
        print(f"{key}: the secret key of both halves; keep it")


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
    from freeart21.progress import progress_bar
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
