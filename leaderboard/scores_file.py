"""The file that `score --out` writes: every number of one method by one protocol, with what each means."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, get_args

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.places import SCORES, require_replaceable
from freeart21.files.result import Method, lacks_of
from freeart21.joint import JointType
from leaderboard.protocol import Metric, Protocol
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row, Scores, Source, Status, Summary
from leaderboard.submission import LONGEST_TEXT, escape_unprintable, plain_json, shorten

SCHEMA = "freeart21/scores/2"
MAX_ROWS = 100_000
MAX_NOTES = 100_000
"""Lines of one row."""
LARGEST = 1e100
"""Of any number: its square is a float."""
_CLOSE = 1e-9
"""Relative: by how much statistics of a file may be off those of its rows."""
_SHA256 = re.compile(r"[0-9a-f]{64}")
_BENCHMARK = ("name", "version", "split", "sha256")


def write_scores(path: Path, scores: Scores) -> None:
    """Write `scores` as JSON, with the protocol's text, units, directions and prices beside the numbers.

    The same results, data, code and machine give the same bytes: what scoring took is left out. Raises FreeArtError
    unless only an older table of scores stands at `path`.
    """
    require_replaceable(Path(path), SCORES)
    rules = protocol_named(scores.protocol)
    body: dict[str, Any] = asdict(scores)
    del body["seconds"]
    metrics = [{**_terms(m), "beside": m.supplements, "definition": m.definition} for m in rules.metrics]
    body["protocol"] = {"name": rules.name, "preamble": rules.preamble, "metrics": metrics}
    atomic.write_json(Path(path), {"schema": SCHEMA, **body})


def read_scores(path: Path) -> Scores:
    """The scores in a file of `write_scores`, from anybody: bounded and checked, statistics computed anew.

    What is in it is what somebody says: hashes tell of which results, so that they can be scored again. Raises
    FreeArtError in one line that names the file and what is wrong with it.
    """
    path = Path(path)
    try:
        return _scores(checked.read_json(path, SCHEMA, checked.ANYWHERE), path)
    except FreeArtError as error:  # which may quote what is in the file
        raise FreeArtError(shorten(str(error), len(str(path)) + LONGEST_TEXT)) from error
    except RecursionError as error:
        raise FreeArtError(f"{path} is no table of scores: it is nested too deeply") from error
    except (ValueError, OverflowError) as error:  # a number of more digits than Python reads, or than a float holds
        raise FreeArtError(f"{path} is no table of scores: {shorten(str(error))}") from error


def _scores(data: dict[str, Any], path: Path) -> Scores:
    from leaderboard.score import summarise  # which makes what this file writes

    told = _object(data, "protocol", path)
    rules = protocol_named(checked.text(told, "name", path))
    _check_terms(told, rules, path)
    facts = _object(data, "benchmark", path)
    benchmark = {key: _line(facts, key, path) for key in (*_BENCHMARK, *({"hidden"} & set(facts)))}
    said = data.get("rows")
    if not isinstance(said, list) or not 0 < len(said) <= MAX_ROWS:
        raise FreeArtError(f"{path}: 'rows' is {_short(said)}, expected a list of 1 to {MAX_ROWS} rows")
    rows = tuple(_row(row, f"{path}: row {k}", rules) for k, row in enumerate(said))
    name, times = Counter(row.sequence for row in rows).most_common(1)[0]
    if times > 1:
        raise FreeArtError(f"{path} has a sequence more than once: {name}")
    summaries = summarise(rows, rules)
    _check_summaries(data.get("summaries"), summaries, path)
    made = plain_json(_object(data, "made_with", path))
    return Scores(
        rules.name,
        _method(_object(data, "method", path), path),
        benchmark,
        rows,
        summaries,
        None,
        _notes(data.get("notes"), f"{path}"),
        made,
    )


def _terms(metric: Metric) -> dict[str, Any]:
    """What has to be the same for a number to be the same number."""
    return {
        "id": metric.id,
        "label": metric.label,
        "unit": {"revolute": metric.revolute_unit, "prismatic": metric.prismatic_unit},
        "direction": metric.direction,
        "price": metric.penalty_text,
    }


def _check_terms(told: dict[str, Any], rules: Protocol, path: Path) -> None:
    listed = told.get("metrics")
    if not isinstance(listed, list) or not all(isinstance(one, dict) for one in listed):
        raise FreeArtError(f"{path}: the metrics of its protocol are {_short(listed)}, expected a list of objects")
    for one in listed:
        ours = _terms(rules.metric(str(one.get("id"))))
        for key in ("unit", "direction", "price"):
            if one.get(key) != ours[key]:
                raise FreeArtError(
                    f"{path}: its {rules.name} has '{key}' {_short(one.get(key))} for {ours['id']}, expected "
                    f"{ours[key]}: that is another protocol"
                )


def _method(data: dict[str, Any], path: Path) -> Method:
    settings = data.get("settings")
    if settings is not None and not isinstance(settings, dict):
        raise FreeArtError(f"{path}: the method's settings are {_short(settings)}, expected an object or null")
    words = [shorten(checked.text(data, key, path)) for key in ("name", "code", "hardware")]
    if not words[0].strip():
        raise FreeArtError(f"{path}: the method has no name")
    return Method(words[0], words[1], plain_json(settings), words[2], lacks_of(data, path))


def _row(data: Any, where: str, rules: Protocol) -> Row:
    """The row that `data` holds; `where` begins its faults."""
    known = [field.name for field in fields(Row)]
    if not isinstance(data, dict) or sorted(data) != sorted(known):
        got = ", ".join(shorten(str(key)) for key in sorted(data)) if isinstance(data, dict) else _short(data)
        raise FreeArtError(f"{where} has {got[:LONGEST_TEXT]}, expected {', '.join(known)}")
    sequence = data["sequence"]
    if not _is_name(sequence):
        raise FreeArtError(f"{where}: 'sequence' is {_short(sequence)}, expected the name of a folder")
    where = f"{where} ({sequence})"
    for key, choices in (("joint_type", JointType), ("status", Status), ("measured_from", Source)):
        if data[key] not in get_args(choices):
            raise FreeArtError(f"{where}: '{key}' is {_short(data[key])}, expected {', '.join(get_args(choices))}")
    if (data["status"] == "ok") != (data["measured_from"] != "nothing"):
        raise FreeArtError(f"{where} is {data['status']} and measured from {data['measured_from']}")
    if not isinstance(data["swapped"], bool):
        raise FreeArtError(f"{where}: 'swapped' is {_short(data['swapped'])}, expected true or false")
    if not isinstance(data["reason"], str):
        raise FreeArtError(f"{where}: 'reason' is {_short(data['reason'])}, expected text")
    diagonal = _number(data, "diagonal_m", where)
    if diagonal is None or diagonal <= 0:
        raise FreeArtError(f"{where}: 'diagonal_m' is {_short(diagonal)}, expected more than 0")
    values = _numbers(data, "values", where)
    expected = [metric.id for metric in rules.metrics]
    if sorted(values) != sorted(expected):
        odd = sorted(set(values) ^ set(expected))[0]
        is_ = "lacks" if odd in expected else "has"
        raise FreeArtError(f"{where}: its values {is_} '{shorten(odd)}', expected the numbers of {rules.name}")
    centimetres = _numbers(data, "values_cm", where)
    if not set(centimetres) <= set(expected):
        raise FreeArtError(f"{where}: 'values_cm' has numbers that {rules.name} does not know")
    seconds = _number(data, "seconds", where)
    if seconds is not None and seconds < 0:
        raise FreeArtError(f"{where}: 'seconds' is {seconds:g}, expected 0 or more, or null")
    return Row(
        sequence,
        data["joint_type"],
        data["status"],
        shorten(data["reason"]),
        data["measured_from"],
        data["swapped"],
        diagonal,
        {id: values[id] for id in expected},
        {id: value for id, value in centimetres.items() if value is not None},
        _notes(data["notes"], where),
        seconds,
        _sha256(data, "result_sha256", where),
        _sha256(data, "truth_sha256", where),
    )


def _check_summaries(said: Any, summaries: Iterable[Summary], path: Path) -> None:
    """FreeArtError where statistics in the file are not those of its rows."""
    ours = {summary.group: asdict(summary) for summary in summaries}
    if not isinstance(said, list) or not all(isinstance(one, dict) for one in said):
        raise FreeArtError(f"{path}: 'summaries' is {_short(said)}, expected a list of objects")
    for one in said:
        group = str(one.get("group"))
        if group not in ours:
            raise FreeArtError(f"{path} has a summary of '{shorten(group)}'; its rows are {', '.join(ours)}")
        wrong = _difference(one, ours[group])
        if wrong:
            raise FreeArtError(f"{path}: {wrong} of its {group} summary is not that of its rows")


def _difference(said: Mapping[str, Any], ours: Mapping[str, Any]) -> str:
    """The first thing in `said` that is otherwise in `ours`, by name; empty when there is none."""
    for key, value in said.items():
        mine = ours.get(key)
        if isinstance(value, dict) and isinstance(mine, Mapping):
            deeper = _difference(value, mine)
            if deeper:
                return f"{shorten(key)} {deeper}"
        elif isinstance(value, int | float) and isinstance(mine, int | float):
            if not math.isclose(value, mine, rel_tol=_CLOSE, abs_tol=_CLOSE):
                return shorten(key)
        elif value != mine:
            return shorten(key)
    return ""


def _object(data: dict[str, Any], key: str, path: Path) -> dict[str, Any]:
    value = data.get(key)
    if not isinstance(value, dict):
        raise FreeArtError(f"{path}: '{key}' is {_short(value)}, expected an object")
    return value


def _line(data: dict[str, Any], key: str, path: Path) -> str:
    """The text `data[key]`, one line that prints."""
    value = data.get(key)
    if not isinstance(value, str) or not value.isprintable() or len(value) > LONGEST_TEXT:
        raise FreeArtError(f"{path}: '{key}' is {_short(value)}, expected a line of text")
    return value


def _notes(value: Any, where: str) -> tuple[str, ...]:
    if not isinstance(value, list) or len(value) > MAX_NOTES or not all(isinstance(note, str) for note in value):
        raise FreeArtError(f"{where}: 'notes' is {_short(value)}, expected a list of at most {MAX_NOTES} lines")
    return tuple(escape_unprintable(note) for note in value)


def _numbers(data: dict[str, Any], key: str, where: str) -> dict[str, float | None]:
    value = data[key]
    if not isinstance(value, dict):
        raise FreeArtError(f"{where}: '{key}' is {_short(value)}, expected an object")
    return {id: _number(value, id, f"{where} {key}") for id in value}


def _number(data: dict[str, Any], key: str, where: str) -> float | None:
    """The finite number `data[key]`, or None for null."""
    value = data[key]
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
        raise FreeArtError(f"{where}: '{shorten(key)}' is {_short(value)}, expected a finite number or null")
    return float(value)


def _sha256(data: dict[str, Any], key: str, where: str) -> str | None:
    value = data[key]
    if value is not None and not (isinstance(value, str) and _SHA256.fullmatch(value)):
        raise FreeArtError(f"{where}: '{key}' is {_short(value)}, expected 64 hexadecimal digits or null")
    return value


def _is_name(value: Any) -> bool:
    """Whether it may be the name of a folder, that is neither a path nor hidden characters."""
    return (
        isinstance(value, str)
        and 0 < len(value) <= LONGEST_TEXT
        and value.isprintable()
        and value not in (".", "..")
        and not set(value) & set("/\\")
    )


def _short(value: Any) -> str:
    """At most sixty characters of what came from outside."""
    if isinstance(value, dict | list):
        return f"{'an object' if isinstance(value, dict) else 'a list'} of {len(value)}"
    return escape_unprintable(repr(value)[:60])
