"""The page of a sequence: its video with every method's parts, the 3D view, joint states, and all numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from freeart21.view.document import Section, render
from freeart21.view.plots import display_unit
from freeart21.view.tables import NONE, number_text, source_rows, table
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row
from leaderboard.site.common import (
    LACKS,
    PACKAGE,
    Board,
    best_of,
    facts,
    hidden_metrics,
    method_heads,
    method_link,
    metric_row_head,
    page,
    score_cell,
)
from leaderboard.site.entrant import Entrant
from leaderboard.site.sequence_view import SequenceContent

MEASURED = {
    "asset": "the asset, loaded and moved in the simulator",
    "files": "the result's files, as there is no asset",
    "nothing": "nothing",
}


def sequence_page(board: Board, k: int, visual: Sequence[Section]) -> bytes:
    """The page of the k-th sequence, with the sections of `show_sequence`; none when only tables were given."""
    shown, f = board.sequences[k], board.sequences[k].facts
    lines = [("joint", f["joint_type"])]
    if "range" in f:
        unit, factor = display_unit(f["joint_type"])
        lines = [("category", f["category"]), *lines, ("range", f"{factor * f['range']:.1f} {unit}")]
        lines.append(("diagonal", f"{f['diagonal_cm']:.1f} cm"))
    if "frames" in f:
        lines.append(("video", f"{f['frames']} frames, {f['seconds']:.1f} s, {f['size']}"))
    names = [s.name for s in board.sequences]
    before, after = names[k - 1] if k else None, names[k + 1] if k + 1 < len(names) else None
    lead = render("steps.html.j2", PACKAGE, facts=facts(lines), before=before, after=after, files=board.files)
    row = board.entrants[0].row(board.protocols[0], shown.name)
    sources = [*source_rows(f["source"]), *([("licence", f["licence"])] if f.get("licence") else [])]
    if row is not None and row.truth_sha256:
        sources.append(("ground truth, SHA-256", row.truth_sha256))
    sections = [
        *visual,
        *(_numbers_section(name, shown, board.entrants) for name in board.protocols),
        _notes_section(shown, board, "right" if visual else "full"),
        *([Section("Source of the sequence", facts(sources), place="full")] if sources else []),
    ]
    notices = [] if visual else ["Made from tables of scores only: without videos and the methods' results."]
    return page(board, shown.name, sections, deep=True, lead=lead, kind="Sequence", notices=notices)


def _numbers_section(protocol: str, shown: SequenceContent, entrants: Sequence[Entrant]) -> Section:
    """Every number of every method by one protocol."""
    rules, kind = protocol_named(protocol), shown.facts["joint_type"]
    rows: list[Row | None] = [entrant.row(protocol, shown.name) for entrant in entrants]
    lines, css = [], []
    for metric in rules.metrics:
        if metric.unit(kind) is None:
            continue
        best, cells = best_of([None if row is None else row.values.get(metric.id) for row in rows], metric), []
        for row in rows:
            below = ""
            if row is not None and row.values.get(metric.id) is not None:
                failed, centimetres = row.status != "ok", number_text(row.values_cm.get(metric.id), "cm", True)
                below = f"{row.status}: penalty" if failed else centimetres * (metric.id in row.values_cm)
            cells.append(score_cell(row, metric, kind, best=best, below=below))
        lines.append([metric_row_head(rules, metric), *cells])
        css.append("beside" if metric.supplements else "")
    note = f"{NONE}: not made by the method, or not defined for this joint. Small grey numbers do not rank."
    if any(hidden_metrics(entrant, rules) for entrant in entrants):
        note += " Numbers with a penalty that depends on the hidden truth are shown in means only."
    html = table(lines, ["number", *method_heads(entrants, True)], "numbers", f"numbers by {protocol}", css)
    return Section(f"Numbers by {protocol}", html, place="full", note=note, id=f"numbers-{protocol}")


def _notes_section(shown: SequenceContent, board: Board, place: Literal["right", "full"]) -> Section:
    """Reasons and notes of scoring on each method's result."""
    blocks = []
    for entrant in board.entrants:
        lines: list[str] = []
        hashes: list[str] = []
        for row in (entrant.row(protocol, shown.name) for protocol in board.protocols):
            if row is None:
                continue
            measured = f"Measured from {MEASURED[row.measured_from]}."
            lines.append(f"{row.status}: {row.reason}" if row.reason else measured)
            lines += ["Its part names were exchanged to match the ground truth."] * row.swapped
            lines += row.notes
            if row.seconds is not None:
                lines.append(f"It took {row.seconds:.0f} s, as stated by the method.")
            hashes += [f"SHA-256 of its files {row.result_sha256}"] if row.result_sha256 else []
        lines += [f"{LACKS[p].capitalize()}: numbers that need them are left out." for p in entrant.method.lacks]
        absent = shown.absent.get(entrant.file)
        if absent and not any(line in absent for line in lines):
            lines.append(absent)
        blocks.append((method_link(entrant, True), list(dict.fromkeys([*lines, *hashes]))))
    return Section("Notes of scoring", render("notes.html.j2", PACKAGE, blocks=blocks), place=place)
