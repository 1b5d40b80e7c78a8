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
    """Chooses its colour."""

    @property
    def method(self) -> Method:
        """The content of method.json."""
        return next(iter(self.scores.values())).method

    @property
    def colour(self) -> str:
        """'#rrggbb'."""
        return COLOURS[self.index % len(COLOURS)]

    @property
    def pale(self) -> str:
        """The colour halfway to white, for the reference part."""
        return "#" + "".join(f"{(int(self.colour[k : k + 2], 16) + 255) // 2:02x}" for k in (1, 3, 5))

    def row(self, protocol: str, sequence: str) -> Row | None:
        """Its row for a sequence by a protocol, if any."""
        return next((row for row in self.scores[protocol].rows if row.sequence == sequence), None)


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
