"""One answer scored on one sequence, from files; whatever is wrong with the answer is priced in its row."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from freeart21.articulation import Articulation
from freeart21.errors import FreeArtError
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.reconstruction import Failure, Piece, Reconstruction
from freeart21.recording import Recording
from freeart21.truth import Truth
from leaderboard.adapters.notes import import_notes
from leaderboard.asset_measurement import measure_asset, measure_joint
from leaderboard.protocol import Protocol, Render, Shape
from leaderboard.protocols import DEFAULT, protocol_named
from leaderboard.rows import Row, Source, Status
from leaderboard.submission import escape_unprintable, read_render, read_submission_with_notes, shorten

LONGEST_RUN_S = 1e9
"""Seconds (30 years) beyond which what a method says it took is no time."""


def score_sequence(
    result_folder: Path,
    sequence_folder: Path,
    truth_folder: Path,
    protocol: str = DEFAULT,
    lacks: tuple[Piece, ...] = (),
) -> Row:
    """Score one result folder of a method that does not make what it `lacks`, for any sequence.

    Raises FreeArtError for a broken sequence or truth; a broken result is priced.
    """
    case = SequenceScorer(protocol_named(protocol), read_sequence(sequence_folder), read_truth(truth_folder), lacks)
    camera, folder = case.recording.camera, Path(result_folder)
    if not folder.is_dir() and not folder.is_symlink():
        return case.penalised_row("missing", f"there is no {folder.name} among the results")
    try:
        answer, notes = read_submission_with_notes(folder, len(case.recording), camera.height, camera.width)
    except FreeArtError as error:
        return case.penalised_row("unreadable", str(error))
    if isinstance(answer, Failure):
        return case.penalised_row("failed", f"{answer.stage}: {answer.reason}", answer.seconds)
    source: Source = "files"
    shape: Shape | None = None
    if case.rules.asset != "none" and (folder / "asset").exists():
        try:
            answer, shape, found = apply_asset(answer, folder / "asset", case.rules.asset == "whole")
        except FreeArtError as error:
            return case.penalised_row("failed", f"asset: {error}", answer.seconds)
        source, notes = "asset", (*notes, *found)
    return case.measure_row(answer, folder, source, shape, (*notes, *import_notes(folder)))


def apply_asset(
    answer: Reconstruction, folder: Path, whole: bool
) -> tuple[Reconstruction, Shape | None, tuple[str, ...]]:
    """`answer` with joint and states as the asset in `folder` moves when loaded; FreeArtError when it does not.

    When the `whole` asset counts, also its visual meshes as they move, and a line about each thing that is wrong.
    """
    shape: Shape | None = None
    notes: tuple[str, ...] = ()
    if whole:
        asset = measure_asset(folder, answer.states)
        joint, states, shape = asset.joint, asset.states, asset.shape
        notes = tuple(f"asset: {finding}" for finding in asset.findings)
    else:
        joint, states = measure_joint(folder, answer.states)
    parts = answer.articulation
    return replace(answer, articulation=Articulation(joint, parts.reference, parts.moving), states=states), shape, notes


@dataclass(frozen=True)
class SequenceScorer:
    """One sequence to be scored on, by the rules of one protocol."""

    rules: Protocol
    recording: Recording
    truth: Truth
    lacks: tuple[Piece, ...] = ()
    """What the method does not make at all: numbers that need it do not exist, in priced rows neither."""

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

    def penalties(self) -> dict[str, float | None]:
        """Metric id to price, in the metric's unit for this sequence; None for numbers that do not exist for it."""
        shown = any(self.truth.query_mask(i).any() for i in range(len(self.recording.queries)))
        nowhere = {*self.lacks, *(() if shown else ("renders",))}
        prices = self.rules.penalties(self.truth)
        return {m.id: None if nowhere & {*m.needs} else prices[m.id] for m in self.rules.metrics}

    def measure_row(
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
        renders, faults = self._renders(folder, "renders")
        others, other_faults = None, faults
        if self.rules.asset == "whole" and (folder / "renders_other").is_dir():
            others, other_faults = self._renders(folder, "renders_other")
        found = self.rules.measure(self.truth, answer, renders, asset=asset, renders_other=others, lacks=self.lacks)
        if found.other_views:
            faults = other_faults
        elif self.rules.asset == "whole" and found.swapped and any(render is not None for render in renders):
            faults = (*faults, "its parts go by each other's names: held-out views of renders/, no renders_other/")
        notes = (*found.notes, *notes)
        given_type, expected = answer.articulation.joint.type, self.truth.articulation.joint.type
        if given_type != expected and "joint" not in self.lacks:
            notes = (f"the joint is {given_type}, expected {expected}", *notes)
        values: dict[str, float | None] = {}
        for id, price in self.penalties().items():
            value = found.values.get(id, price)
            values[id] = None if price is None or value is None else self.rules.capped_value(id, value, price)
        return self._row(values, "ok", "", source, found.swapped, (*notes, *faults), answer.seconds)

    def penalised_row(self, status: Status, reason: str, seconds: dict[str, float] | None = None) -> Row:
        """The row of an answer that cannot be measured: every number at its price."""
        return self._row(self.penalties(), status, shorten(reason), "nothing", False, (), seconds or {})

    def _renders(self, folder: Path, pictures: str) -> tuple[list[Render], tuple[str, ...]]:
        """The picture of every query in the subfolder `pictures`, None where there is none, and what is wrong with
        them; none is looked for where the method makes none, or the protocol has no use for them."""
        if "renders" in self.lacks or not any("renders" in metric.needs for metric in self.rules.metrics):
            return [None] * len(self.recording.queries), ()
        camera = self.recording.camera
        renders: list[Render] = []
        notes = []
        for i in range(len(self.recording.queries)):
            render, faults = read_render(folder, pictures, i, camera.height, camera.width)
            renders.append(render)
            notes += [str(fault) for fault in faults]
        absent = sum(render is None for render in renders) - len(notes)
        if absent:
            notes.append(f"{absent} of {len(renders)} held-out views have no render")
        return renders, tuple(notes)

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
            tuple(escape_unprintable(note) for note in notes),
            total if timed else None,
        )
