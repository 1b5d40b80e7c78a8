"""Scoring results against a benchmark: every number of a protocol, from files, with nothing dropped."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from freeart21.articulation import Articulation
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.benchmark import file_sha256, read_benchmark
from freeart21.files.places import SCORES, require_replaceable
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.recording import Recording
from freeart21.truth import Truth
from leaderboard.asset_joint import measured_asset, measured_joint
from leaderboard.protocols import DEFAULT, Group, Protocol, protocol_named
from leaderboard.rows import Row, Scores, Source, Statistic, Status, Summary, frame
from leaderboard.strict1 import Render, Shape
from leaderboard.submission import method_of, printable, read_with_notes, render_faults, shortened
from leaderboard.worker import ROW_LIMIT_S, RowEnded, worker

SCHEMA = "freeart21/scores/1"
LONGEST_RUN_S = 1e9
"""Seconds (30 years) beyond which what a method says it took is no time."""


def score_results(
    results: Path,
    data: Path,
    protocol: str = DEFAULT,
    progress: Callable[[Row, int], None] | None = None,
    limit_s: float | None = ROW_LIMIT_S,
) -> Scores:
    """Score the results folder of one method against the benchmark folder `data`: every sequence of it, found or not.

    `progress` is called with each row and how many there will be. Rows are scored in a process of their own, and one
    that takes more than `limit_s` seconds is priced; None: in this process, without a limit. Raises FreeArtError when
    the protocol is unknown, `results` is not a folder of results, or the benchmark is broken; whatever is wrong with
    one result is priced in its row.
    """
    begun, results = time.perf_counter(), Path(results)
    rules = protocol_named(protocol)
    benchmark = read_benchmark(data)
    check_results_folder(results, benchmark.sequences)
    method, faults = method_of(results)
    rows = []
    with worker() as scorer:
        for name in benchmark.sequences:
            where = results / name, benchmark.sequence(name), benchmark.truth(name)
            if limit_s is None:
                row = score_sequence(*where, rules.name)
            else:
                request = dict(zip(("result", "sequence", "truth"), map(str, where), strict=True))
                try:
                    row = scorer.score({**request, "protocol": rules.name}, limit_s)
                except RowEnded as reason:
                    row = Case(rules, read_sequence(where[1]), read_truth(where[2])).priced("failed", str(reason))
            rows.append(row)
            if progress:
                progress(row, len(benchmark.sequences))
    facts = {
        "name": benchmark.name,
        "version": benchmark.version,
        "split": benchmark.split,
        "sha256": file_sha256(benchmark.folder / "benchmark.json"),
    }
    summaries, seconds = summarise(rows, rules), time.perf_counter() - begun
    return Scores(rules.name, method, facts, tuple(rows), summaries, seconds, tuple(str(fault) for fault in faults))


def check_results_folder(results: Path, sequences: tuple[str, ...]) -> None:
    """FreeArtError unless `results` may be the folder of one method; one level too high or too low names the other."""
    if not results.is_dir():
        raise FreeArtError(f"{results} is not a folder of results")
    if (results / "prediction.json").is_file():
        raise FreeArtError(
            f"{results} is the result of one sequence, expected the folder that holds all of a method: did you mean "
            f"{results.resolve().parent}?"
        )
    below = [child for child in sorted(results.iterdir()) if child.is_dir() and child.name not in sequences]
    methods = [child for child in below if any((child / name / "prediction.json").is_file() for name in sequences)]
    if methods and not any((results / name).exists() for name in sequences):
        raise FreeArtError(
            f"{results} holds results of methods rather than of sequences: did you mean "
            f"{' or '.join(str(method) for method in methods[:5])}?"
        )


def score_sequence(result_folder: Path, sequence_folder: Path, truth_folder: Path, protocol: str = DEFAULT) -> Row:
    """Score one result folder. Raises FreeArtError for a broken sequence or truth; a broken result is priced."""
    case = Case(protocol_named(protocol), read_sequence(sequence_folder), read_truth(truth_folder))
    camera, folder = case.recording.camera, Path(result_folder)
    if not folder.is_dir() and not folder.is_symlink():
        return case.priced("missing", f"there is no {folder.name} among the results")
    try:
        answer, notes = read_with_notes(folder, len(case.recording), camera.height, camera.width)
    except FreeArtError as error:
        return case.priced("unreadable", str(error))
    if isinstance(answer, Failure):
        return case.priced("failed", f"{answer.stage}: {answer.reason}", answer.seconds)
    source: Source = "files"
    shape: Shape | None = None
    if (folder / "asset").exists():
        try:
            answer, shape, found = with_asset(answer, folder / "asset", case.rules.whole_asset)
        except FreeArtError as error:
            return case.priced("failed", f"asset: {error}", answer.seconds)
        source, notes = "asset", (*notes, *found)
    return case.measured(answer, folder, source, shape, notes)


def with_asset(
    answer: Reconstruction, folder: Path, whole: bool
) -> tuple[Reconstruction, Shape | None, tuple[str, ...]]:
    """`answer` with joint and states as the asset in `folder` moves when loaded; FreeArtError when it does not.

    When the `whole` asset counts, also its visual meshes as they move, and a line about each thing that is wrong.
    """
    shape: Shape | None = None
    notes: tuple[str, ...] = ()
    if whole:
        asset = measured_asset(folder, answer.states)
        joint, states, shape = asset.joint, asset.states, asset.shape
        notes = tuple(f"asset: {finding}" for finding in asset.findings)
    else:
        joint, states = measured_joint(folder, answer.states)
    parts = answer.articulation
    return replace(answer, articulation=Articulation(joint, parts.reference, parts.moving), states=states), shape, notes


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
        self,
        answer: Reconstruction,
        folder: Path,
        source: Source,
        asset: Shape | None = None,
        notes: tuple[str, ...] = (),
    ) -> Row:
        """The row of an answer that can be measured, its pictures read from `folder`; what it lacks is priced.

        `asset` is the shape of its asset, for protocols by which that counts.
        """
        renders, faults = _renders(folder, "renders", self.recording)
        if self.rules.whole_asset:
            others, other_faults = _renders(folder, "renders_other", self.recording)
            given = others if (folder / "renders_other").is_dir() else None
            found = self.rules.measure(self.truth, answer, renders, asset=asset, renders_other=given)
            if found.other_views:
                faults = other_faults
            elif found.swapped and any(render is not None for render in renders):
                faults = (*faults, "its parts go by each other's names: held-out views of renders/, no renders_other/")
        else:
            found = self.rules.measure(self.truth, answer, renders)
        given_type, expected = answer.articulation.joint.type, self.truth.articulation.joint.type
        if given_type != expected:
            notes = (f"the joint is {given_type}, expected {expected}", *notes)
        values: dict[str, float | None] = {}
        for id, price in self.prices().items():
            value = found.values.get(id, price)
            values[id] = None if price is None or value is None else self.rules.capped_value(id, value, price)
        return self._row(values, "ok", "", source, found.swapped, (*notes, *faults), answer.seconds)

    def priced(self, status: Status, reason: str, seconds: dict[str, float] | None = None) -> Row:
        """The row of an answer that cannot be measured: every number at its price."""
        return self._row(self.prices(), status, shortened(reason), "nothing", False, (), seconds or {})

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
        timed = bool(seconds) and 0 <= total <= LONGEST_RUN_S  # neither is NaN
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
            tuple(printable(note) for note in notes),
            total if timed else None,
        )


def summarise(rows: Iterable[Row], rules: Protocol) -> tuple[Summary, ...]:
    """Statistics over all rows of each joint type, then over all rows, for every metric that has one unit there."""
    table, summaries = frame(rows), []
    for group in get_args(Group):
        chosen = table if group == "all" else table[table.truth_type == group]
        if chosen.empty:
            continue
        failures = int((chosen.status != "ok").sum())
        statistics = {
            id: statistic(chosen[id].dropna(), metric.direction)
            for metric in rules.metrics
            if metric.unit(group) is not None
            for id in (metric.id, f"{metric.id}_cm")
            if id in chosen and chosen[id].notna().any()
        }
        summaries.append(Summary(group, len(chosen), failures, 1 - failures / len(chosen), statistics))
    return tuple(summaries)


def statistic(values: ArrayLike, direction: Literal["up", "down"]) -> Statistic:
    """Mean, sample standard deviation (ddof 1), median and worst of one or more values (n,)."""
    column = pd.Series(values, dtype=float)
    std = float(column.std()) if len(column) > 1 else None
    worst = column.max() if direction == "down" else column.min()
    return Statistic(float(column.mean()), std, float(column.median()), float(worst), len(column))


def write_scores(path: Path, scores: Scores) -> None:
    """Write `scores` as JSON, with the protocol's text, units, directions and prices beside the numbers.

    Raises FreeArtError unless only an older table of scores stands at `path`.
    """
    require_replaceable(Path(path), SCORES)
    rules = protocol_named(scores.protocol)
    metrics = [
        {
            "id": m.id,
            "label": m.label,
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


def _renders(folder: Path, pictures: str, recording: Recording) -> tuple[list[Render], tuple[str, ...]]:
    """The picture of every query in the subfolder `pictures`, None where there is none, and what is wrong with them."""
    renders: list[Render] = []
    notes = []
    for i in range(len(recording.queries)):
        render, faults = render_faults(folder, pictures, i, recording.camera.height, recording.camera.width)
        renders.append(render)
        notes += [str(fault) for fault in faults]
    absent = sum(render is None for render in renders) - len(notes)
    if absent:
        notes.append(f"{absent} of {len(renders)} held-out views have no render")
    return renders, tuple(notes)
