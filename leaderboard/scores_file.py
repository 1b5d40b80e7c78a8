"""Score tables as JSON files (`score --out`), written with the protocol's definitions and read with full checks."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.json_record import read_record
from freeart21.files.places import SCORES, require_replaceable
from freeart21.files.result import Method
from freeart21.reconstruction import PIECES
from leaderboard.protocol import Protocol
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row, Scores
from leaderboard.submission import LONGEST_TEXT, escape_unprintable, plain_json, shorten

SCHEMA = "freeart21/scores/2"
MAX_ROWS = 100_000
MAX_NOTES = 100_000
"""Notes of one row."""
LARGEST = 1e100
"""Largest number: its square is still finite."""
_SHA256 = re.compile(r"[0-9a-f]{64}")
_BENCHMARK = ("name", "version", "split", "sha256")


@dataclass(frozen=True)
class _Table:
    """What is read of a file; the statistics in it are those of its rows, and computed anew."""

    protocol: dict[str, Any]
    benchmark: dict[str, str]
    method: Method
    rows: tuple[Row, ...]
    made_with: dict[str, Any]
    notes: tuple[str, ...] = ()


def write_scores(path: Path, scores: Scores) -> None:
    """Write `scores` as JSON, with the text, units, directions and penalties of the protocol.

    Equal results, data, code and machine give equal bytes: the scoring time is left out. Raises FreeArtError when
    something else than an older score table exists at `path`.
    """
    require_replaceable(Path(path), SCORES)
    rules = protocol_named(scores.protocol)
    body: dict[str, Any] = asdict(scores)
    del body["seconds"]
    metrics = [
        {
            "id": metric.id,
            "label": metric.label,
            "unit": {"revolute": metric.revolute_unit, "prismatic": metric.prismatic_unit},
            "direction": metric.direction,
            "price": metric.penalty_text,
            "beside": metric.supplements,
            "definition": metric.definition,
        }
        for metric in rules.metrics
    ]
    body["protocol"] = {"name": rules.name, "preamble": rules.preamble, "metrics": metrics}
    atomic.write_json(Path(path), {"schema": SCHEMA, **body})


def read_scores(path: Path) -> Scores:
    """The scores in a file of `write_scores` from any source: bounded and checked.

    A field with a default may lack, an unknown one is ignored. The values of the rows cannot be verified; the hashes
    identify the results, which can be scored again. Raises FreeArtError, one line with the file and its fault.
    """
    path = Path(path)
    try:
        return _read_scores(checked.read_json(path, SCHEMA, checked.ANYWHERE), path)
    except FreeArtError as error:  # it can quote the file
        raise FreeArtError(shorten(str(error), len(str(path)) + LONGEST_TEXT)) from error
    except RecursionError as error:
        raise FreeArtError(f"{path} is not a table of scores: it is nested too deeply") from error
    except (ValueError, OverflowError) as error:  # a number with too many digits
        raise FreeArtError(f"{path} is not a table of scores: {shorten(str(error))}") from error


def _read_scores(data: dict[str, Any], path: Path) -> Scores:
    from leaderboard.score import summarise

    table = read_record(_Table, data, f"{path}", whole=True)
    rules = protocol_named(checked.text(table.protocol, "name", path))
    for key in _BENCHMARK:
        if not table.benchmark.get(key, "\n").isprintable() or len(table.benchmark[key]) > LONGEST_TEXT:
            raise FreeArtError(f"{path}: '{key}' of its benchmark is missing or not a line of text")
    if not 0 < len(table.rows) <= MAX_ROWS:
        raise FreeArtError(f"{path} has {len(table.rows)} rows, expected 1 to {MAX_ROWS}")
    rows = tuple(_check_row(row, f"{path}: row {k}", rules) for k, row in enumerate(table.rows))
    name, times = Counter(row.sequence for row in rows).most_common(1)[0]
    if times > 1:
        raise FreeArtError(f"{path} has a sequence more than once: {name}")
    words = {key: shorten(getattr(table.method, key)) for key in ("name", "code", "hardware")}
    if not words["name"].strip():
        raise FreeArtError(f"{path}: the method has no name")
    lacks = tuple(piece for piece in PIECES if piece in table.method.lacks)
    method = replace(table.method, **words, settings=plain_json(table.method.settings), lacks=lacks)
    benchmark = {key: value for key, value in table.benchmark.items() if key in (*_BENCHMARK, "hidden")}
    notes, made_with = _printable(table.notes), plain_json(table.made_with)
    return Scores(rules.name, method, benchmark, rows, summarise(rows, rules), None, notes, made_with)


def _check_row(row: Row, where: str, rules: Protocol) -> Row:
    """The row with printable text and its values in the protocol's order; errors begin with `where`."""
    if not _is_name(row.sequence):
        raise FreeArtError(f"{where}: 'sequence' is {checked.shorten(row.sequence)}, expected the name of a folder")
    where = f"{where} ({row.sequence})"
    if (row.status == "ok") != (row.measured_from != "nothing"):
        raise FreeArtError(f"{where} is {row.status} and measured from {row.measured_from}")
    expected = [metric.id for metric in rules.metrics]
    for id in sorted(set(row.values) ^ set(expected)):
        verb = "lacks" if id in expected else "has"
        raise FreeArtError(f"{where}: its values {verb} '{shorten(id)}', expected the numbers of {rules.name}")
    if not set(row.values_cm) <= set(expected):
        raise FreeArtError(f"{where}: 'values_cm' has numbers that {rules.name} does not know")
    numbers = (row.diagonal_m, row.seconds or 0.0, *row.values_cm.values(), *(v or 0.0 for v in row.values.values()))
    if max(map(abs, numbers)) > LARGEST or row.diagonal_m <= 0 or (row.seconds or 0.0) < 0:
        raise FreeArtError(f"{where} has a number beyond {LARGEST:g}, a 'diagonal_m' of 0, or 'seconds' below 0")
    for key, digest in (("result_sha256", row.result_sha256), ("truth_sha256", row.truth_sha256)):
        if digest is not None and not _SHA256.fullmatch(digest):
            raise FreeArtError(f"{where}: '{key}' is {checked.shorten(digest)}, expected 64 hexadecimal digits or null")
    if len(row.notes) > MAX_NOTES:
        raise FreeArtError(f"{where} has {len(row.notes)} notes, expected at most {MAX_NOTES}")
    values = {id: row.values[id] for id in expected}
    return replace(row, reason=shorten(row.reason), values=values, notes=_printable(row.notes))


def _printable(notes: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(escape_unprintable(note) for note in notes)


def _is_name(name: str) -> bool:
    """Whether it can be a folder's name: printable and not a path."""
    is_short = 0 < len(name) <= LONGEST_TEXT
    return is_short and name.isprintable() and name not in (".", "..") and not set(name) & set("/\\")
