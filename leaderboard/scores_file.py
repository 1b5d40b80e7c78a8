"""Score tables as JSON files (`score --out`), written with the protocol's definitions and read with full checks."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.json_record import read_record
from freeart21.files.places import SCORES, require_replaceable
from freeart21.files.result import Method, read_lacks
from leaderboard.protocol import Metric, Protocol
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row, Scores, Summary
from leaderboard.submission import LONGEST_TEXT, escape_unprintable, plain_json, shorten

SCHEMA = "freeart21/scores/2"
MAX_ROWS = 100_000
MAX_NOTES = 100_000
"""Notes of one row."""
LARGEST = 1e100
"""Largest number: its square is still finite."""
_CLOSE = 1e-9
"""Relative tolerance between the file's statistics and those of its rows."""
_SHA256 = re.compile(r"[0-9a-f]{64}")
_BENCHMARK = ("name", "version", "split", "sha256")


def write_scores(path: Path, scores: Scores) -> None:
    """Write `scores` as JSON, with the text, units, directions and penalties of the protocol.

    Equal results, data, code and machine give equal bytes: the scoring time is left out. Raises FreeArtError when
    something else than an older score table exists at `path`.
    """
    require_replaceable(Path(path), SCORES)
    rules = protocol_named(scores.protocol)
    body: dict[str, Any] = asdict(scores)
    del body["seconds"]
    metrics = [{**_terms(m), "beside": m.supplements, "definition": m.definition} for m in rules.metrics]
    body["protocol"] = {"name": rules.name, "preamble": rules.preamble, "metrics": metrics}
    atomic.write_json(Path(path), {"schema": SCHEMA, **body})


def read_scores(path: Path) -> Scores:
    """The scores in a file of `write_scores` from any source: bounded, checked, statistics recomputed.

    The values of the rows cannot be verified; the hashes identify the results, which can be scored again. Raises
    FreeArtError, one line with the file and its fault.
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

    protocol = checked.json_object(data, "protocol", path)
    rules = protocol_named(checked.text(protocol, "name", path))
    _check_terms(protocol, rules, path)
    facts = checked.json_object(data, "benchmark", path)
    benchmark = {key: _read_line(facts, key, path) for key in (*_BENCHMARK, *({"hidden"} & set(facts)))}
    listed = data.get("rows")
    if not isinstance(listed, list) or not 0 < len(listed) <= MAX_ROWS:
        raise FreeArtError(f"{path}: 'rows' is {_quote(listed)}, expected a list of 1 to {MAX_ROWS} rows")
    rows = tuple(_read_row(row, f"{path}: row {k}", rules) for k, row in enumerate(listed))
    name, times = Counter(row.sequence for row in rows).most_common(1)[0]
    if times > 1:
        raise FreeArtError(f"{path} has a sequence more than once: {name}")
    summaries = summarise(rows, rules)
    _check_summaries(data.get("summaries"), summaries, path)
    made_with = plain_json(checked.json_object(data, "made_with", path))
    return Scores(
        rules.name,
        _read_method(checked.json_object(data, "method", path), path),
        benchmark,
        rows,
        summaries,
        None,
        _read_notes(data.get("notes"), f"{path}"),
        made_with,
    )


def _terms(metric: Metric) -> dict[str, Any]:
    """The definition of a metric as far as values of two files can be compared by it."""
    return {
        "id": metric.id,
        "label": metric.label,
        "unit": {"revolute": metric.revolute_unit, "prismatic": metric.prismatic_unit},
        "direction": metric.direction,
        "price": metric.penalty_text,
    }


def _check_terms(protocol: dict[str, Any], rules: Protocol, path: Path) -> None:
    listed = protocol.get("metrics")
    if not isinstance(listed, list) or not all(isinstance(metric, dict) for metric in listed):
        raise FreeArtError(f"{path}: the metrics of its protocol are {_quote(listed)}, expected a list of objects")
    for metric in listed:
        ours = _terms(rules.metric(str(metric.get("id"))))
        for key in ("unit", "direction", "price"):
            if metric.get(key) != ours[key]:
                raise FreeArtError(
                    f"{path}: its {rules.name} has '{key}' {_quote(metric.get(key))} for {ours['id']}, expected "
                    f"{ours[key]}: that is another protocol"
                )


def _read_method(data: dict[str, Any], path: Path) -> Method:
    settings = data.get("settings")
    if settings is not None and not isinstance(settings, dict):
        raise FreeArtError(f"{path}: the method's settings are {_quote(settings)}, expected an object or null")
    words = [shorten(checked.text(data, key, path)) for key in ("name", "code", "hardware")]
    if not words[0].strip():
        raise FreeArtError(f"{path}: the method has no name")
    return Method(words[0], words[1], plain_json(settings), words[2], read_lacks(data, path))


def _read_row(data: Any, where: str, rules: Protocol) -> Row:
    """The row in `data`; error messages begin with `where`."""
    row = read_record(Row, data, where, whole=True)
    if not _is_name(row.sequence):
        raise FreeArtError(f"{where}: 'sequence' is {_quote(row.sequence)}, expected the name of a folder")
    where = f"{where} ({row.sequence})"
    if (row.status == "ok") != (row.measured_from != "nothing"):
        raise FreeArtError(f"{where} is {row.status} and measured from {row.measured_from}")
    if row.diagonal_m <= 0:
        raise FreeArtError(f"{where}: 'diagonal_m' is {row.diagonal_m:g}, expected more than 0")
    expected = [metric.id for metric in rules.metrics]
    if sorted(row.values) != sorted(expected):
        id = sorted(set(row.values) ^ set(expected))[0]
        verb = "lacks" if id in expected else "has"
        raise FreeArtError(f"{where}: its values {verb} '{shorten(id)}', expected the numbers of {rules.name}")
    if not set(row.values_cm) <= set(expected):
        raise FreeArtError(f"{where}: 'values_cm' has numbers that {rules.name} does not know")
    numbers = (row.diagonal_m, row.seconds or 0.0, *row.values_cm.values(), *(v or 0.0 for v in row.values.values()))
    if max(map(abs, numbers)) > LARGEST:
        raise FreeArtError(f"{where} has a number beyond {LARGEST:g}")
    if row.seconds is not None and row.seconds < 0:
        raise FreeArtError(f"{where}: 'seconds' is {row.seconds:g}, expected 0 or more, or null")
    for key, digest in (("result_sha256", row.result_sha256), ("truth_sha256", row.truth_sha256)):
        if digest is not None and not _SHA256.fullmatch(digest):
            raise FreeArtError(f"{where}: '{key}' is {_quote(digest)}, expected 64 hexadecimal digits or null")
    return replace(
        row,
        reason=shorten(row.reason),
        values={id: row.values[id] for id in expected},
        notes=_read_notes(list(row.notes), where),
    )


def _check_summaries(given: Any, summaries: Iterable[Summary], path: Path) -> None:
    """Raise FreeArtError when the file's statistics are not those of its rows."""
    ours = {summary.group: asdict(summary) for summary in summaries}
    if not isinstance(given, list) or not all(isinstance(one, dict) for one in given):
        raise FreeArtError(f"{path}: 'summaries' is {_quote(given)}, expected a list of objects")
    for one in given:
        group = str(one.get("group"))
        if group not in ours:
            raise FreeArtError(f"{path} has a summary of '{shorten(group)}'; its rows are {', '.join(ours)}")
        field = _find_difference(one, ours[group])
        if field:
            raise FreeArtError(f"{path}: {field} of its {group} summary is not that of its rows")


def _find_difference(given: Mapping[str, Any], ours: Mapping[str, Any]) -> str:
    """The path of the first entry of `given` that differs in `ours`; empty when there is none."""
    for key, value in given.items():
        mine = ours.get(key)
        if isinstance(value, dict) and isinstance(mine, Mapping):
            deeper = _find_difference(value, mine)
            if deeper:
                return f"{shorten(key)} {deeper}"
        elif isinstance(value, int | float) and isinstance(mine, int | float):
            if not math.isclose(value, mine, rel_tol=_CLOSE, abs_tol=_CLOSE):
                return shorten(key)
        elif value != mine:
            return shorten(key)
    return ""


def _read_line(data: dict[str, Any], key: str, path: Path) -> str:
    """The text `data[key]`, one printable line."""
    value = data.get(key)
    if not isinstance(value, str) or not value.isprintable() or len(value) > LONGEST_TEXT:
        raise FreeArtError(f"{path}: '{key}' is {_quote(value)}, expected a line of text")
    return value


def _read_notes(value: Any, where: str) -> tuple[str, ...]:
    if not isinstance(value, list) or len(value) > MAX_NOTES or not all(isinstance(note, str) for note in value):
        raise FreeArtError(f"{where}: 'notes' is {_quote(value)}, expected a list of at most {MAX_NOTES} lines")
    return tuple(escape_unprintable(note) for note in value)


def _is_name(value: Any) -> bool:
    """Whether it can be a folder's name: printable and not a path."""
    return (
        isinstance(value, str)
        and 0 < len(value) <= LONGEST_TEXT
        and value.isprintable()
        and value not in (".", "..")
        and not set(value) & set("/\\")
    )


def _quote(value: Any) -> str:
    """`value` for a message, at most sixty characters."""
    if isinstance(value, dict | list):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    return escape_unprintable(repr(value)[:60])
