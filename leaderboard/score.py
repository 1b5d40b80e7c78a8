"""Scoring results against a benchmark: every number of a protocol, from files, with nothing dropped."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from freeart21.articulation import Articulation
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.benchmark import file_sha256, read_benchmark
from freeart21.files.places import SCORES, require_replaceable
from freeart21.files.result import Method, read_method
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.joint import JointType
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.recording import Recording
from freeart21.truth import Truth
from leaderboard.asset_joint import measured_joint
from leaderboard.protocols import Group, Protocol, protocol_named
from leaderboard.strict1 import Render
from leaderboard.submission import read_submission, read_submitted_render

SCHEMA = "freeart21/scores/1"
Status = Literal["ok", "failed", "missing", "unreadable"]
Source = Literal["asset", "files", "nothing"]


@dataclass(frozen=True)
class Row:
    """The score of one sequence."""

    sequence: str
    joint_type: JointType
    """Of the truth."""
    status: Status
    """'ok' was measured; 'failed' says so itself or has an asset that does not load; all but 'ok' are priced."""
    reason: str
    """Why it was not measured; empty when it was."""
    measured_from: Source
    """What the joint figures were measured from."""
    swapped: bool
    """Whether the answer's parts went by each other's names."""
    diagonal_m: float
    """Of the truth: what lengths in % are shares of."""
    values: dict[str, float | None]
    """Every metric of the protocol in its unit; None where it does not exist for this sequence."""
    values_cm: dict[str, float]
    """Those that are shares of the diagonal, in cm."""
    notes: tuple[str, ...] = ()
    """What the reader should know: a wrong joint type, a picture that could not be read."""
    seconds: float | None = None
    """What the method says it took, all stages together; None when it does not say."""


@dataclass(frozen=True)
class Statistic:
    """One metric over a group of sequences."""

    mean: float
    std: float | None
    """Sample standard deviation (ddof 1); None for one sequence."""
    median: float
    worst: float
    sequences: int
    """How many have this number: all, but for position (revolute only) and pictures (where there are queries)."""


@dataclass(frozen=True)
class Summary:
    """All sequences of a joint type, or all of them; failures and missing ones at their price."""

    group: Group
    sequences: int
    failures: int
    """Sequences that were not measured: failed, missing or unreadable."""
    coverage: float
    """Fraction that was measured."""
    statistics: dict[str, Statistic]
    """Metric id, or id_cm, to its statistic; only those with one unit in the group."""


@dataclass(frozen=True)
class Scores:
    """A whole table."""

    protocol: str
    method: Method
    benchmark: dict[str, str]
    """name, version, split, and sha256 of benchmark.json, which holds the hash of every file of the truth."""
    rows: tuple[Row, ...]
    summaries: tuple[Summary, ...]
    seconds: float
    """What scoring took."""


def score_results(
    results: Path, data: Path, protocol: str = "strict-1", progress: Callable[[Row], None] | None = None
) -> Scores:
    """Score the results folder of one method against the benchmark folder `data`: every sequence of it, found or not.

    `progress` is called with each row. Raises FreeArtError when the protocol is unknown, `results` is not a folder of
    results, or the benchmark is broken; whatever is wrong with one result is priced in its row.
    """
    begun, results = time.perf_counter(), Path(results)
    rules = protocol_named(protocol)
    benchmark = read_benchmark(data)
    if not results.is_dir():
        raise FreeArtError(f"{results} is not a folder of results")
    if (results / "prediction.json").is_file():
        raise FreeArtError(f"{results} is the result of one sequence, expected the folder that holds all of a method")
    rows = []
    for name in benchmark.sequences:
        rows.append(score_sequence(results / name, benchmark.sequence(name), benchmark.truth(name), rules.name))
        if progress:
            progress(rows[-1])
    facts = {
        "name": benchmark.name,
        "version": benchmark.version,
        "split": benchmark.split,
        "sha256": file_sha256(benchmark.folder / "benchmark.json"),
    }
    summaries, seconds = summarise(rows, rules), time.perf_counter() - begun
    return Scores(rules.name, read_method(results), facts, tuple(rows), summaries, seconds)


def score_sequence(result_folder: Path, sequence_folder: Path, truth_folder: Path, protocol: str = "strict-1") -> Row:
    """Score one result folder. Raises FreeArtError for a broken sequence or truth; a broken result is priced."""
    case = Case(protocol_named(protocol), read_sequence(sequence_folder), read_truth(truth_folder))
    camera, folder = case.recording.camera, Path(result_folder)
    if not folder.is_dir():
        return case.priced("missing", f"there is no {folder.name} among the results")
    try:
        answer = read_submission(folder, len(case.recording), camera.height, camera.width)
    except FreeArtError as error:
        return case.priced("unreadable", str(error))
    if isinstance(answer, Failure):
        return case.priced("failed", f"{answer.stage}: {answer.reason}", answer.seconds)
    source: Source = "files"
    if (folder / "asset").exists():
        try:
            answer, source = with_asset_joint(answer, folder / "asset"), "asset"
        except FreeArtError as error:
            return case.priced("failed", f"asset: {error}", answer.seconds)
    return case.measured(answer, source, *_renders(folder, case.recording))


def with_asset_joint(answer: Reconstruction, folder: Path) -> Reconstruction:
    """`answer` with joint and states as the asset in `folder` moves when loaded; FreeArtError when it does not."""
    joint, states = measured_joint(folder, answer.states)
    parts = answer.articulation
    return replace(answer, articulation=Articulation(joint, parts.reference, parts.moving), states=states)


@dataclass(frozen=True)
class Case:
    """One sequence to be scored on, by the rules of one protocol."""

    rules: Protocol
    recording: Recording
    truth: Truth

    def __post_init__(self) -> None:
        if len(self.truth) != len(self.recording):
            raise FreeArtError(
                f"{self.recording.name}: the truth has {len(self.truth)} states, the sequence has "
                f"{len(self.recording)} frames"
            )

    @cached_property
    def diagonal(self) -> float:
        """The truth's, metres."""
        return self.truth.diagonal

    def prices(self) -> dict[str, float | None]:
        """Metric id to price, in the metric's unit for this sequence; None for numbers that do not exist for it."""
        kind, motion = self.truth.articulation.joint.type, self.truth.range_of_motion
        motion = float(np.rad2deg(motion)) if kind == "revolute" else 100 * motion / self.diagonal
        prices = {metric.id: metric.price_for(kind, motion) for metric in self.rules.metrics}
        if not any(self.truth.query_mask(i).any() for i in range(len(self.recording.queries))):
            prices["psnr"] = prices["ssim"] = None
        return prices

    def measured(
        self, answer: Reconstruction, source: Source, renders: list[Render], notes: tuple[str, ...] = ()
    ) -> Row:
        """The row of an answer that can be measured; single figures that it lacks are priced."""
        found = self.rules.measure(self.truth, answer, renders)
        given, expected = answer.articulation.joint.type, self.truth.articulation.joint.type
        if given != expected:
            notes = (f"the joint is {given}, expected {expected}", *notes)
        values = {id: None if price is None else found.values.get(id, price) for id, price in self.prices().items()}
        return self._row(values, "ok", "", source, found.swapped, notes, answer.seconds)

    def priced(self, status: Status, reason: str, seconds: dict[str, float] | None = None) -> Row:
        """The row of an answer that cannot be measured: every number at its price."""
        return self._row(self.prices(), status, " ".join(reason.split())[:300], "nothing", False, (), seconds or {})

    def _row(
        self,
        values: dict[str, float | None],
        status: Status,
        reason: str,
        source: Source,
        swapped: bool,
        notes: tuple[str, ...],
        seconds: dict[str, float],
    ) -> Row:
        kind, diagonal = self.truth.articulation.joint.type, self.diagonal
        centimetres = {
            id: value * diagonal
            for id, value in values.items()  # % of a diagonal in m is cm
            if value is not None and self.rules.metric(id).unit(kind) == "%"
        }
        total = float(sum(seconds.values()))
        return Row(
            self.recording.name,
            kind,
            status,
            reason,
            source,
            swapped,
            diagonal,
            values,
            centimetres,
            notes,
            total if seconds and np.isfinite(total) else None,
        )


def summarise(rows: Iterable[Row], rules: Protocol) -> tuple[Summary, ...]:
    """Statistics over all rows of each joint type, then over all rows, for every metric that has one unit there."""
    rows, summaries = list(rows), []
    for group in get_args(Group):
        chosen = [row for row in rows if group in ("all", row.joint_type)]
        if not chosen:
            continue
        failures = sum(row.status != "ok" for row in chosen)
        statistics = {}
        for metric in rules.metrics:
            if metric.unit(group) is None:
                continue
            columns = {
                metric.id: [row.values[metric.id] for row in chosen],
                f"{metric.id}_cm": [row.values_cm.get(metric.id) for row in chosen],
            }
            for id, column in columns.items():
                numbers = [value for value in column if value is not None]
                if numbers:
                    statistics[id] = statistic(numbers, metric.direction)
        summaries.append(Summary(group, len(chosen), failures, 1 - failures / len(chosen), statistics))
    return tuple(summaries)


def statistic(values: list[float], direction: Literal["up", "down"]) -> Statistic:
    """Mean, sample standard deviation (ddof 1), median and worst of one or more values."""
    std = float(np.std(values, ddof=1)) if len(values) > 1 else None
    return Statistic(
        float(np.mean(values)),
        std,
        float(np.median(values)),
        max(values) if direction == "down" else min(values),
        len(values),
    )


def write_scores(path: Path, scores: Scores) -> None:
    """Write `scores` as JSON, with the protocol's text, units, directions and prices beside the numbers.

    Raises FreeArtError unless only an older table of scores stands at `path`.
    """
    require_replaceable(Path(path), SCORES)
    rules = protocol_named(scores.protocol)
    metrics = [
        {
            "id": m.id,
            "unit": {"revolute": m.revolute_unit, "prismatic": m.prismatic_unit},
            "direction": m.direction,
            "price": "range of motion" if m.price is None else m.price,
            "beside": m.beside,
            "definition": m.definition,
        }
        for m in rules.metrics
    ]
    body: dict[str, Any] = asdict(scores)
    body["protocol"] = {"name": rules.name, "preamble": rules.preamble, "metrics": metrics}
    atomic.write_json(Path(path), {"schema": SCHEMA, **body})


def _renders(folder: Path, recording: Recording) -> tuple[list[Render], tuple[str, ...]]:
    """The picture of every query, None where there is none or it is not one, and a note on what is wrong."""
    renders: list[Render] = []
    notes = []
    for i in range(len(recording.queries)):
        try:
            renders.append(read_submitted_render(folder, i, recording.camera.height, recording.camera.width))
        except FreeArtError as error:
            renders.append(None)
            notes.append(str(error))
    absent = sum(render is None for render in renders) - len(notes)
    if absent:
        notes.append(f"{absent} of {len(renders)} held-out views have no render")
    return renders, tuple(notes)
