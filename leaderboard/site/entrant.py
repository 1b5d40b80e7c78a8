"""Who stands on the board: a method with its results, its scores and the mark by which every page shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from freeart21.files.result import Method
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row, Scores
from leaderboard.score import summarise
from leaderboard.site.names import file_names

COLOURS = ("#0072B2", "#D55E00", "#CC79A7", "#E69F00", "#56B4E9", "#8A6D00", "#6B7280")
"""Of Okabe and Ito (2008), without the green that is the truth's; the yellow darkened so that it shows on white."""
SHAPES = (
    "M8 2.2a5.8 5.8 0 1 0 0 11.6a5.8 5.8 0 1 0 0-11.6z",
    "M2.8 2.8h10.4v10.4h-10.4z",
    "M8 1.8l6.8 12h-13.6z",
    "M8 1l7 7l-7 7l-7-7z",
    "M6 1.5h4v4.500h4.500v4h-4.500v4.500h-4v-4.500h-4.500v-4h4.500z",
    "M1.200 2.200h13.600l-6.800 12z",
    "M8 1l6 3.500v7l-6 3.500l-6-3.500v-7z",
)
"""Paths in a box of 16, filled: a method is never told by its colour alone."""
DASHES = ("", "7 3", "2 3", "9 3 2 3", "4 2", "1 4", "12 4")
"""Of its curves."""


@dataclass(frozen=True, eq=False)
class Entrant:
    """One method on the board."""

    name: str
    """Shown; no two are alike."""
    file: str
    """Of its page and its tables, without ending."""
    folder: Path | None
    """Of its answers; None where its tables alone were given."""
    scores: Mapping[str, Scores]
    """Protocol to its table, as far as the site may show its rows (`public_scores`)."""
    whole: Mapping[str, Scores]
    """Protocol to its table as it was made: means are of this one."""
    index: int
    """Of its colour, shape and dashes."""

    @property
    def method(self) -> Method:
        """What method.json says."""
        return next(iter(self.scores.values())).method

    @property
    def colour(self) -> str:
        """'#rrggbb'."""
        return COLOURS[self.index % len(COLOURS)]

    @property
    def shape(self) -> str:
        """An SVG path in a box of 16; after one round of colours the shapes move on, so that pairs differ."""
        return SHAPES[(self.index + self.index // len(COLOURS)) % len(SHAPES)]

    @property
    def dash(self) -> str:
        """An SVG stroke-dasharray."""
        return DASHES[(self.index + self.index // len(COLOURS)) % len(DASHES)]

    def row(self, protocol: str, sequence: str) -> Row | None:
        """Its row of a sequence by a protocol; None when the table has none."""
        return next((row for row in self.scores[protocol].rows if row.sequence == sequence), None)


def public_scores(scores: Scores, hidden: str) -> Scores:
    """`scores` without the numbers of each row that may be the truth's own, where `hidden`, its digest, is not empty.

    The price of a failure in joint state is the range of motion, so a failed row would tell it.
    """
    rules = protocol_named(scores.protocol)
    lost = rules.penalised_by_truth if hidden else ()
    if not lost:
        return scores
    rows = [
        replace(
            row,
            values={**row.values, **dict.fromkeys(lost)},
            values_cm={id: value for id, value in row.values_cm.items() if id not in lost},
        )
        for row in scores.rows
    ]
    note = f"the truth is hidden: no row has {', '.join(lost)}, whose price is the truth's own number"
    facts = {**scores.benchmark, "hidden": hidden}
    notes = (*scores.notes, note)
    return replace(scores, rows=tuple(rows), summaries=summarise(rows, rules), notes=notes, benchmark=facts)


def entrants(tables: Sequence[tuple[Path, Mapping[str, Scores]]], hidden: str = "") -> tuple[Entrant, ...]:
    """All methods in the order given, each with the folder of its answers or the file of a table.

    Of two that go by one name, each is told with that place. `hidden` is the digest of a hidden truth.
    """
    names = [next(iter(scores.values())).method.name for _, scores in tables]
    folders = [folder.resolve().name for folder, _ in tables]
    told = [n if names.count(n) == 1 else f"{n} ({f})" for n, f in zip(names, folders, strict=True)]
    told = [n if told.count(n) == 1 else f"{n} #{k + 1}" for k, n in enumerate(told)]
    return tuple(
        Entrant(
            name,
            file,
            folder if folder.is_dir() else None,
            {protocol: public_scores(table, hidden) for protocol, table in scores.items()},
            scores,
            k,
        )
        for k, (name, file, (folder, scores)) in enumerate(zip(told, file_names(told), tables, strict=True))
    )
