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
        protocol: Named protocol, what each number means: strict-2, or strict-1 (joint from the asset, surfaces from
            parts/).
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


def site(
    results: Annotated[tuple[Path, ...], Positional],
    data: Path,
    out: Path,
    protocol: tuple[str, ...] = ("strict-2",),
    scores: Path | None = None,
    title: str | None = None,
) -> None:
    """Write a static site: the ranking, a page a method and a sequence, failures, definitions, downloads.

    One folder that opens from disk or from any host and fetches nothing from elsewhere. Methods are scored first,
    unless their tables are kept in the folder of --scores. An older site at the place is replaced, nothing else.

    Args:
        results: Folders of results, one a method (RESULTS/SEQ/prediction.json).
        data: The data folder that they answer, with its truth.
        out: Folder of the site.
        protocol: Named protocols, a table each; the first one orders the site.
        scores: Folder in which tables of scores are kept.
        title: What the site is called; the name of the data when not given.
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
        index = write_site(results, data, out, protocol, scores, title, command, done)
    print(f"{out}: {len(results)} method{'s' * (len(results) != 1)}; open {index}")
