"""Compares methods on one benchmark by one protocol: statistics by group, differences with confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import pandas as pd

from freeart21.catalog import CATALOG
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.benchmark import read_benchmark
from freeart21.joint import JointType
from leaderboard.archive import open_results
from leaderboard.bootstrap import Interval, bootstrap_intervals
from leaderboard.cached import cached_scores
from leaderboard.protocol import Metric, Protocol
from leaderboard.protocols import DEFAULT, protocol_named
from leaderboard.rows import Row, Scores
from leaderboard.score import benchmark_facts, statistic
from leaderboard.scores_file import read_scores
from leaderboard.submission import shorten

By = Literal["type", "category", "sequence"]
UNKNOWN = "unknown"
"""Category of an object whose truth names none."""


@dataclass(frozen=True)
class Entrant:
    """One method of a comparison."""

    name: str
    """Unique name: the method's, with the folder's added when several methods have the same."""
    scores: Scores


@dataclass(frozen=True)
class Group:
    """Sequences that share one set of statistics."""

    by: By
    name: str
    sequences: tuple[str, ...]
    types: tuple[JointType, ...]
    """Joint types of its sequences."""

    def unit(self, metric: Metric) -> str | None:
        """The metric's unit in this group; None without a common one."""
        return metric.unit(self.types[0] if len(self.types) == 1 else "all")


@dataclass(frozen=True)
class Comparison:
    """Several methods, scored by the same code and protocol on the same benchmark."""

    rules: Protocol
    benchmark: dict[str, str]
    entrants: tuple[Entrant, ...]
    categories: dict[str, str]
    """Every sequence of the benchmark, in its order, to its object's category."""
    notes: tuple[str, ...] = ()

    @cached_property
    def types(self) -> dict[str, JointType]:
        """Scored sequence to its true joint type, in the benchmark's order."""
        found = {row.sequence: row.joint_type for entrant in self.entrants for row in entrant.scores.rows}
        return {name: found[name] for name in self.categories if name in found}

    @cached_property
    def frames(self) -> dict[str, pd.DataFrame]:
        """Method to its rows, as `Scores.frame`."""
        return {entrant.name: entrant.scores.frame() for entrant in self.entrants}

    def groups(self, by: By) -> tuple[Group, ...]:
        """The groups: each joint type and then all, or each category, or each sequence."""
        members: dict[str, list[str]] = {}
        for name, joint_type in self.types.items():
            key = {"type": joint_type, "category": self.categories[name], "sequence": name}[by]
            members.setdefault(key, []).append(name)
        order = get_args(JointType) if by == "type" else members if by == "sequence" else sorted(members)
        found = [self._group(by, key, members[key]) for key in order if key in members]
        if by == "type" and len(found) > 1:
            found.append(self._group(by, "all", list(self.types)))
        return tuple(found)

    def table(self, by: By) -> pd.DataFrame:
        """A row per group and method; failed and missing sequences count with their penalty.

        Columns: group, method, sequences, failures, coverage (the measured fraction); for each metric with values and
        one unit in the group its mean (id), id_std, id_median, id_worst, id_sequences; and the mean difference to the
        first method over the sequences for which both have a value, id_difference, with the ends id_low and id_high of
        its interval, and id_verdict: 'better' or 'worse' than the first, or 'open' when 0 lies within or there are too
        few sequences for an interval.
        """
        lines = []
        for group in self.groups(by):
            metrics = [metric for metric in self.rules.metrics if group.unit(metric) is not None]
            ids = [metric.id for metric in metrics]
            chosen = {name: frame.reindex(list(group.sequences)) for name, frame in self.frames.items()}
            first = next(iter(chosen.values()))[ids]
            for name, frame in chosen.items():
                status = frame.status.dropna()
                failures = int((status != "ok").sum())
                line: dict[str, Any] = {"group": group.name, "method": name, "sequences": len(status)}
                line |= {"failures": failures, "coverage": 1 - failures / len(status) if len(status) else 0.0}
                is_first = name == self.entrants[0].name
                intervals = [None] * len(ids) if is_first else bootstrap_intervals(frame[ids] - first)
                for metric, interval in zip(metrics, intervals, strict=True):
                    line |= _describe_column(metric, frame[metric.id].dropna(), interval)
                lines.append(line)
        return pd.DataFrame(lines)

    def frame(self) -> pd.DataFrame:
        """A row per sequence and method: sequence, type, category, method, status, and every metric in its unit."""
        columns = ["status", *(metric.id for metric in self.rules.metrics)]
        table = pd.concat([frame[columns].assign(method=name) for name, frame in self.frames.items()])
        table = table.loc[list(self.types)].reset_index()
        table.insert(1, "type", table.sequence.map(self.types))
        table.insert(2, "category", table.sequence.map(self.categories))
        table.insert(3, "method", table.pop("method"))
        return table

    def _group(self, by: By, name: str, sequences: list[str]) -> Group:
        types = tuple(kind for kind in get_args(JointType) if any(self.types[s] == kind for s in sequences))
        return Group(by, name, tuple(sequences), types)


def compare_results(
    results: Sequence[Path],
    data: Path,
    protocol: str | None = None,
    cache: Path | None = None,
    progress: Callable[[Path, Row, int], None] | None = None,
    truth: Path | None = None,
) -> Comparison:
    """The comparison of `results`: results folders or .zip files, which are scored, and tables of `score --out`.

    `protocol` None takes that of the tables, or the default when there are none. `cache` is a folder for the tables of
    scored folders (`cached_scores`). `progress` gets the folder, each finished row, and the number of rows. `truth` is
    where the truth of a packed data folder lies.

    Raises FreeArtError in one line when the tables differ in protocol, benchmark, truths or scoring code: their numbers
    cannot be compared.
    """
    if not results:
        raise FreeArtError("compare: nothing to compare; name results folders, or tables of `freeart21 score --out`")
    places = [Path(place) for place in results]
    resolved = [place.resolve() for place in places]
    repeated = [place for place, path in zip(places, resolved, strict=True) if resolved.count(path) > 1]
    if repeated:
        raise FreeArtError(f"{repeated[-1]} is named twice; a method is compared with others")
    benchmark = read_benchmark(data, truth)
    tables = {place: read_scores(place) for place in places if place.is_file() and place.suffix.lower() != ".zip"}
    name = protocol or next((table.protocol for table in tables.values()), DEFAULT)
    rules = protocol_named(name)
    for place, table in tables.items():
        if table.protocol != rules.name:
            raise FreeArtError(
                f"{place} is scored by {table.protocol}, expected {rules.name}: numbers of different protocols cannot "
                "be compared"
            )

    def scored(place: Path) -> Scores:
        if place in tables:
            return tables[place]
        report = None if progress is None else lambda row, of: progress(place, row, of)
        with open_results(place) as folder:
            return cached_scores(folder, data, rules.name, cache, report, truth=truth)

    found = [(place, scored(place)) for place in places]
    facts = benchmark_facts(benchmark)
    notes = check_tables(found, facts, benchmark.sequences)
    known = not benchmark.hidden or benchmark.hidden_truth is not None  # comparing tables needs no truth
    categories = {name: read_category(benchmark.truth(name)) if known else UNKNOWN for name in benchmark.sequences}
    return Comparison(rules, facts, _entrants(found), categories, notes)


def read_category(truth_folder: Path) -> str:
    """The `category` in the `source` of truth.json, else that of the catalog object named there, else UNKNOWN."""
    try:
        source = checked.read_json(Path(truth_folder) / "truth.json").get("source")
    except FreeArtError:
        return UNKNOWN
    if not isinstance(source, dict):
        return UNKNOWN
    category = source.get("category")
    if isinstance(category, str) and category.strip():
        return shorten(category)
    return next((entry.category for entry in CATALOG if entry.name == source.get("object")), UNKNOWN)


def check_tables(
    found: list[tuple[Path, Scores]], facts: dict[str, str], sequences: tuple[str, ...]
) -> tuple[str, ...]:
    """Raise FreeArtError unless all tables can be compared; returns remarks on them.

    `facts` and `sequences` are the benchmark's that all tables must be scored on.
    """
    first, reference = found[0]
    truths: dict[str, tuple[Path, str]] = {}
    for place, scores in found:
        if scores.benchmark["sha256"] != facts["sha256"]:
            raise FreeArtError(
                f"{place} is scored on {_describe_set(scores.benchmark)}, expected {_describe_set(facts)}: "
                "another benchmark, or another version of it"
            )
        version, expected = (table.made_with.get("freeart21") for table in (scores, reference))
        if version != expected:
            raise FreeArtError(
                f"{place} is scored by freeart21 {shorten(str(version))}, {first} by {shorten(str(expected))}: "
                "score it again, or name its results folder instead"
            )
        for row in scores.rows:
            if row.sequence not in sequences:
                raise FreeArtError(
                    f"{place} has a row for {row.sequence}, which is not a sequence of {_describe_set(facts)}"
                )
            if row.truth_sha256 is not None:
                other, sha256 = truths.setdefault(row.sequence, (place, row.truth_sha256))
                if sha256 != row.truth_sha256:
                    raise FreeArtError(f"{place} is scored against another truth of {row.sequence} than {other}")
    notes = [
        f"{place} was scored with other versions of libraries than {first}: the last digits may differ"
        for place, scores in found[1:]
        if scores.made_with.get("libraries") != reference.made_with.get("libraries")
    ]
    notes += [
        f"{place} has rows for {len(scores.rows)} of {len(sequences)} sequences: its means are over these"
        for place, scores in found
        if len(scores.rows) < len(sequences)
    ]
    return tuple(notes)


def _entrants(found: list[tuple[Path, Scores]]) -> tuple[Entrant, ...]:
    """Each table with a unique name."""
    names = [scores.method.name for _, scores in found]
    places = [place.resolve().name for place, _ in found]
    full = [n if names.count(n) == 1 else f"{n} ({place})" for n, place in zip(names, places, strict=True)]
    unique = [n if full.count(n) == 1 else f"{n} {full[: k + 1].count(n)}" for k, n in enumerate(full)]
    while len(set(unique)) < len(unique):  # a numbered name can equal another method's own
        unique = [n if unique.count(n) == 1 else f"{n} {unique[: k + 1].count(n)}" for k, n in enumerate(unique)]
    return tuple(Entrant(name, scores) for name, (_, scores) in zip(unique, found, strict=True))


def _describe_column(metric: Metric, values: pd.Series[float], interval: Interval | None) -> dict[str, Any]:
    """The columns of one metric in `Comparison.table`."""
    if values.empty:
        return {}
    one, id = statistic(values, metric.direction), metric.id
    found: dict[str, Any] = {id: one.mean, f"{id}_std": one.std, f"{id}_median": one.median, f"{id}_worst": one.worst}
    found[f"{id}_sequences"] = one.sequences
    if interval is not None:
        better = (interval.mean > 0) == (metric.direction == "up")
        verdict = "open" if not interval.significant else "better" if better else "worse"
        found |= {f"{id}_low": interval.low, f"{id}_high": interval.high}
        found |= {f"{id}_difference": interval.mean, f"{id}_verdict": verdict}
    return found


def _describe_set(facts: dict[str, str]) -> str:
    return f"{facts['name']} {facts['version']} ({facts['sha256'][:12]})"
