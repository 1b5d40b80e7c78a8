"""Score of one result on one sequence, from files; a faulty result gets the protocol's penalties."""

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
from leaderboard.asset_measurement import measure_asset
from leaderboard.protocol import Case, Protocol, Render, Shape
from leaderboard.protocols import DEFAULT, protocol_named
from leaderboard.rows import Row, Source, Status
from leaderboard.submission import (
    escape_unprintable,
    read_import_notes,
    read_render,
    read_submission,
    shorten,
)

LONGEST_RUN_S = 1e9
"""Seconds (30 years) above which a method's reported run time is ignored."""


def score_sequence(
    result_folder: Path,
    sequence_folder: Path,
    truth_folder: Path,
    protocol: str = DEFAULT,
    lacks: tuple[Piece, ...] = (),
) -> Row:
    """The score of one result folder; `lacks` names the pieces that its method never produces.

    Raises FreeArtError for a broken sequence or truth; a broken result is penalised.
    """
    scorer = SequenceScorer(protocol_named(protocol), read_sequence(sequence_folder), read_truth(truth_folder), lacks)
    camera, folder = scorer.recording.camera, Path(result_folder)
    if not folder.is_dir() and not folder.is_symlink():
        return scorer.penalised_row("missing", f"there is no {folder.name} among the results")
    try:
        answer, notes = read_submission(folder, len(scorer.recording), camera.height, camera.width)
    except FreeArtError as error:
        return scorer.penalised_row("unreadable", str(error))
    if isinstance(answer, Failure):
        return scorer.penalised_row("failed", f"{answer.stage}: {answer.reason}", answer.seconds)
    source: Source = "files"
    shape: Shape | None = None
    if scorer.rules.asset != "none" and (folder / "asset").exists():
        try:
            answer, shape, findings = apply_asset(answer, folder / "asset", scorer.rules.asset == "whole")
        except FreeArtError as error:
            return scorer.penalised_row("failed", f"asset: {error}", answer.seconds)
        source, notes = "asset", (*notes, *findings)
    return scorer.measure_row(answer, folder, source, shape, (*notes, *read_import_notes(folder)))


def apply_asset(
    answer: Reconstruction, folder: Path, whole: bool
) -> tuple[Reconstruction, Shape | None, tuple[str, ...]]:
    """`answer` with the joint and states of the asset in `folder`, loaded and driven in the simulator.

    With `whole` also the shape of its visual meshes and one note for each finding of its checks. Raises FreeArtError
    when the asset does not load or move.
    """
    asset, parts = measure_asset(folder, answer.states, whole), answer.articulation
    notes = tuple(f"asset: {finding}" for finding in asset.findings)
    parts = Articulation(asset.joint, parts.reference, parts.moving)
    return replace(answer, articulation=parts, states=asset.states), asset.shape, notes


@dataclass(frozen=True)
class SequenceScorer:
    """Scores answers to one sequence by one protocol."""

    rules: Protocol
    recording: Recording
    truth: Truth
    lacks: tuple[Piece, ...] = ()
    """Pieces that the method never produces: metrics that need one have no value, not even a penalty."""

    def __post_init__(self) -> None:
        if len(self.truth) != len(self.recording):
            raise FreeArtError(
                f"{self.recording.name}: the truth has {len(self.truth)} states, the sequence has "
                f"{len(self.recording)} frames"
            )

    @cached_property
    def diagonal(self) -> float:
        """Diagonal of the true object, metres."""
        return self.truth.diagonal

    def penalties(self) -> dict[str, float | None]:
        """Metric id to penalty, in the metric's unit for this sequence; None for metrics without a value here."""
        query_shows_object = any(self.truth.query_mask(i).any() for i in range(len(self.recording.queries)))
        absent = {*self.lacks, *(() if query_shows_object else ("renders",))}
        penalties = self.rules.penalties(self.truth)
        return {m.id: None if absent & {*m.needs} else penalties[m.id] for m in self.rules.metrics}

    def measure_row(
        self,
        answer: Reconstruction,
        folder: Path,
        source: Source,
        asset: Shape | None = None,
        notes: tuple[str, ...] = (),
    ) -> Row:
        """The row of a readable answer whose renders lie in `folder`; metrics that it has no value for are penalised.

        `asset` is the shape of its asset, for protocols that measure it.
        """
        renders, faults = self._read_renders(folder, "renders")
        others, other_faults = None, faults
        if self.rules.asset == "whole" and (folder / "renders_other").is_dir():
            others, other_faults = self._read_renders(folder, "renders_other")
        found = self.rules.measure(Case(self.truth, answer, renders, asset, others, self.lacks))
        if found.other_views:
            faults = other_faults
        elif self.rules.asset == "whole" and found.swapped and any(render is not None for render in renders):
            faults = (*faults, "its parts go by each other's names: held-out views of renders/, no renders_other/")
        notes = (*found.notes, *notes)
        given_type, expected = answer.articulation.joint.type, self.truth.articulation.joint.type
        if given_type != expected and "joint" not in self.lacks:
            notes = (f"the joint is {given_type}, expected {expected}", *notes)
        values: dict[str, float | None] = {}
        for id, penalty in self.penalties().items():
            value = found.values.get(id, penalty)
            values[id] = None if penalty is None or value is None else self.rules.capped_value(id, value, penalty)
        return self._row(values, "ok", "", source, found.swapped, (*notes, *faults), answer.seconds)

    def penalised_row(self, status: Status, reason: str, seconds: dict[str, float] | None = None) -> Row:
        """The row of an answer that cannot be measured: the penalty for every metric."""
        return self._row(self.penalties(), status, shorten(reason), "nothing", False, (), seconds or {})

    def _read_renders(self, folder: Path, subfolder: str) -> tuple[list[Render], tuple[str, ...]]:
        """The render of every query, None where there is none, and notes about faulty and missing ones.

        Nothing is read when the method makes no renders or the protocol needs none.
        """
        if "renders" in self.lacks or not any("renders" in metric.needs for metric in self.rules.metrics):
            return [None] * len(self.recording.queries), ()
        camera = self.recording.camera
        renders: list[Render] = []
        notes = []
        for i in range(len(self.recording.queries)):
            render, faults = read_render(folder, subfolder, i, camera.height, camera.width)
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
        joint_type, diagonal = self.truth.articulation.joint.type, self.diagonal
        centimetres = {
            id: value * diagonal
            for id, value in values.items()  # % of a diagonal in m is cm
            if value is not None and self.rules.metric(id).unit(joint_type) == "%"
        }
        total = float(sum(seconds.values()))
        is_plausible = bool(seconds) and 0 <= total <= LONGEST_RUN_S  # False for NaN, too
        return Row(
            self.recording.name,
            joint_type,
            status,
            reason,
            source,
            swapped,
            diagonal,
            values,
            centimetres,
            tuple(escape_unprintable(note) for note in notes),
            total if is_plausible else None,
        )
