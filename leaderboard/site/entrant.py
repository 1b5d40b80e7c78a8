"""The methods of a site: results, scores, and the mark of each on every page."""

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
"""Of Okabe and Ito (2008), without the green of the ground truth; the yellow is darkened for white backgrounds."""
SHAPES = (
    "M8 2.2a5.8 5.8 0 1 0 0 11.6a5.8 5.8 0 1 0 0-11.6z",
    "M2.8 2.8h10.4v10.4h-10.4z",
    "M8 1.8l6.8 12h-13.6z",
    "M8 1l7 7l-7 7l-7-7z",
    "M6 1.5h4v4.500h4.500v4h-4.500v4.500h-4v-4.500h-4.500v-4h4.500z",
    "M1.200 2.200h13.600l-6.800 12z",
    "M8 1l6 3.500v7l-6 3.500l-6-3.500v-7z",
)
"""Filled SVG paths in a box of 16: a method is never recognised by its colour alone."""
DASHES = ("", "7 3", "2 3", "9 3 2 3", "4 2", "1 4", "12 4")
"""SVG stroke-dasharrays of curves."""


@dataclass(frozen=True, eq=False)
class Entrant:
    """One method."""

    name: str
    """Unique."""
    file: str
    """File name of its page and its tables, without ending."""
    folder: Path | None
    """Of its results; None when only its tables were given."""
    scores: Mapping[str, Scores]
    """Protocol to its table with the rows that the site may show (`public_scores`)."""
    whole: Mapping[str, Scores]
    """Protocol to its complete table, for means."""
    index: int
    """Chooses colour, shape and dash."""

    @property
    def method(self) -> Method:
        """The content of method.json."""
        return next(iter(self.scores.values())).method

    @property
    def colour(self) -> str:
        """'#rrggbb'."""
        return COLOURS[self.index % len(COLOURS)]

    @property
    def shape(self) -> str:
        """An SVG path in a box of 16, shifted after each round of colours so that pairs differ."""
        return SHAPES[(self.index + self.index // len(COLOURS)) % len(SHAPES)]

    @property
    def dash(self) -> str:
        """An SVG stroke-dasharray."""
        return DASHES[(self.index + self.index // len(COLOURS)) % len(DASHES)]

    def row(self, protocol: str, sequence: str) -> Row | None:
        """Its row for a sequence by a protocol, if any."""
        return next((row for row in self.scores[protocol].rows if row.sequence == sequence), None)


def svg_mark(shape: str, colour: str) -> str:
    """An SVG path in a box of 16 in its colour."""
    return f'<svg class="mark" viewBox="0 0 16 16" aria-hidden="true"><path d="{shape}" fill="{colour}"/></svg>'


def public_scores(scores: Scores, hidden: str) -> Scores:
    """`scores` without the numbers of single rows that may reveal the truth, when `hidden`, its digest, is not empty.

    The penalty of a failure in joint state is the range of motion, so a failed row would reveal it.
    """
    rules = protocol_named(scores.protocol)
    removed = rules.penalised_by_truth if hidden else ()
    if not removed:
        return scores
    rows = [
        replace(
            row,
            values={**row.values, **dict.fromkeys(removed)},
            values_cm={id: value for id, value in row.values_cm.items() if id not in removed},
        )
        for row in scores.rows
    ]
    note = f"the truth is hidden: no row has {', '.join(removed)}, whose penalty is a number of the truth"
    facts = {**scores.benchmark, "hidden": hidden}
    notes = (*scores.notes, note)
    return replace(scores, rows=tuple(rows), summaries=summarise(rows, rules), notes=notes, benchmark=facts)


def entrants(tables: Sequence[tuple[Path, Mapping[str, Scores]]], hidden: str = "") -> tuple[Entrant, ...]:
    """All methods in the order given, each with the folder of its results or the file of a table.

    Methods of the same name get that place added to it. `hidden` is the digest of a hidden truth.
    """
    plain = [next(iter(scores.values())).method.name for _, scores in tables]
    places = [place.resolve().name for place, _ in tables]
    names = [n if plain.count(n) == 1 else f"{n} ({p})" for n, p in zip(plain, places, strict=True)]
    names = [n if names.count(n) == 1 else f"{n} #{k + 1}" for k, n in enumerate(names)]
    return tuple(
        Entrant(
            name,
            file,
            place if place.is_dir() else None,
            {protocol: public_scores(table, hidden) for protocol, table in scores.items()},
            scores,
            k,
        )
        for k, (name, file, (place, scores)) in enumerate(zip(names, file_names(names), tables, strict=True))
    )
