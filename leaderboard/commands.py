"""The commands of the leaderboard, each a plain function; tyro reads its signature, and help its docstring.

What a command needs is imported inside it: `freeart21 --help` needs nothing heavy.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import tyro

Positional = tyro.conf.Positional


def score(
    results: Annotated[Path, Positional],
    data: Path,
    protocol: str = "strict-2",
    out: Path | None = None,
    everything: Annotated[bool, tyro.conf.arg(name="all")] = False,
) -> int:
    """Score a folder of results against the truth of a data folder.

    Joint and surfaces are measured from each result's asset/, loaded and driven in SAPIEN; without one, from
    prediction.json and parts/ and marked `files`. Masks, poses and held-out views are read from the result's files.
    What each number means: docs/protocols.md. Exit code 1 when no sequence could be measured.

    Args:
        results: A method's results (RESULTS/SEQ/prediction.json).
        data: The data folder they answer.
        protocol: Named protocol, what each number means: strict-2 (the ranking), strict-1 (joint from the asset,
            surfaces from parts/), paper-1 (as FreeArtGS's evaluator), itaco-1 (as iTACO's), arena-1 (the joint as a
            motion, limits included).
        out: Write every number as JSON here, too.
        everything: Print every number, not only the ranking ones.
    """
    from rich.console import Console
    from rich.progress import Progress

    from freeart21.files.places import SCORES, check_place
    from leaderboard.rows import Row
    from leaderboard.score import score_results
    from leaderboard.scores_file import write_scores
    from leaderboard.tables import print_scores

    if out is not None:
        check_place(out, SCORES, (data,))
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bars:
        task = bars.add_task("Scoring", total=None)

        def scored(row: Row, of: int) -> None:
            bars.update(task, description=f"Scored {row.sequence}", advance=1, total=of)

        scores = score_results(results, data, protocol, scored)
    print_scores(scores, everything=everything)
    if out is not None:
        write_scores(out, scores)
    return 0 if scores.measured else 1


def validate(results: Annotated[Path, Positional], data: Path) -> int:
    """Check a folder of results as `score` will read it, without measuring: every fault, with its place and its cure.

    Exit code 1 when there is a fault. Needs the sequences of the data folder, not their truth.

    Args:
        results: A method's results (RESULTS/SEQ/prediction.json).
        data: The data folder they answer.
    """
    from leaderboard.validate import validate_results

    report = validate_results(results, data)
    for fault in report.faults:
        print(f"{fault}{f'; to mend: {fault.mend}' if fault.mend else ''}")
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
