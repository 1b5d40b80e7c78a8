"""The page of a sequence: its video with every method's parts, the 3D view, joint states, and all numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from freeart21.view.document import Section, escape
from freeart21.view.plots import display_unit
from freeart21.view.tables import NONE, number_cell, number_text, table
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row
from leaderboard.site.entrant import Entrant
from leaderboard.site.html import (
    TABLES_ONLY,
    Board,
    facts,
    hash_text,
    method_heads,
    method_link,
    metric_row_head,
    page,
)
from leaderboard.site.index_page import hidden_metrics
from leaderboard.site.sequence_data import LACKS, SequenceContent

MEASURED = {
    "asset": "the asset, loaded and moved in the simulator",
    "files": "the result's files, as there is no asset",
    "nothing": "nothing",
}


def sequence_page(board: Board, k: int) -> bytes:
    """The page of the k-th sequence."""
    shown, f = board.sequences[k], board.sequences[k].facts
    lines = [("joint", escape(f["joint_type"]))]
    if "range" in f:
        unit, factor = display_unit(f["joint_type"])
        motion = f"{factor * f['range']:.1f}{'' if unit == '°' else ' '}{unit}"
        lines = [("category", escape(f["category"])), *lines, ("range", motion)]
        lines.append(("diagonal", f"{f['diagonal_cm']:.1f} cm"))
    if "frames" in f:
        lines.append(("video", f"{f['frames']} frames, {f['seconds']:.1f} s, {escape(f['size'])}"))
    steps = [(board.sequences[i].name if 0 <= i < len(board.sequences) else None) for i in (k - 1, k + 1)]
    links = "".join(
        f'<a rel="{rel}" href="{escape(board.files[name])}.html">{arrow.format(escape(name))}</a>'
        if name is not None
        else "<span></span>"
        for rel, arrow, name in zip(("prev", "next"), ("← {}", "{} →"), steps, strict=True)
    )
    lead = f'{facts(lines)}<nav class="steps" aria-label="sequences">{links}</nav>'
    sections = [
        *_visual_sections(shown, board),
        *(_numbers_section(name, shown, board.entrants) for name in board.protocols),
        _notes_section(shown, board),
        *_source_section(f, board.entrants[0].row(board.protocols[0], shown.name)),
    ]
    data = [f"../data/{board.files[shown.name]}.js"] if shown.script else []
    return page(board, shown.name, sections, deep=True, lead=lead, kind="Sequence", data=data)


def _visual_sections(shown: SequenceContent, board: Board) -> list[Section]:
    """Video, 3D view and joint states, as far as there are any."""
    if not shown.script:
        return [Section("Video and parts", f'<p class="note">{TABLES_ONLY}</p>', place="full")]
    hidden = "range" not in shown.facts
    without = _without_meshes(shown, board.entrants)
    sheets = [f"../video/{board.files[shown.name]}-{k}.jpg" for k in range(len(shown.sheets))]
    video = Section(
        "Video and parts",
        '<div class="stage"><p class="note">Loading …</p></div><div class="player"></div>',
        "overlays",
        {"sheets": sheets},
        "left",
        "Solid outline and stronger colour: moving part; dashed: reference part.",
    )
    if shown.states is None:  # no method has a result that can be shown
        return [video, Section("Parts and joint in 3D", without, place="right")]
    where = (
        "The ground truth is hidden: every result is shown in the camera frame of the first image."
        if hidden
        else "Results are aligned with the ground truth as the protocol does it."
    )
    signs = (
        "The ground truth is hidden: states have the sign and zero of the first method shown; the sign of the axis and "
        "the median offset are removed."
        if hidden
        else "The sign of the axis and the median offset are removed, as in scoring. Grey: the moving part is "
        "not visible."
    )
    scene = Section(
        "Parts and joint in 3D",
        f'<div class="scene"></div>{without}',
        "scene",
        {},
        "right",
        f"{where} The slider moves all joints of one type. Meshes are simplified; pale: reference part.",
    )
    html, data = shown.states
    states = Section(
        "Joint state", html, "curves", data, "left", f"{signs} Curves beyond the scale run along its edge."
    )
    return [video, states, scene]


def _without_meshes(shown: SequenceContent, entrants: Sequence[Entrant]) -> str:
    """A line for each method without a surface: why."""
    lines = []
    for entrant in entrants:
        why = shown.absent.get(entrant.file) or (LACKS["meshes"] if "meshes" in entrant.method.lacks else "")
        if why:
            lines.append(f"<li>{method_link(entrant, True)} <span>{escape(why)}</span></li>")
    return f'<ul class="absent">{"".join(lines)}</ul>' if lines else ""


def _numbers_section(protocol: str, shown: SequenceContent, entrants: Sequence[Entrant]) -> Section:
    """Every number of every method by one protocol."""
    rules, kind = protocol_named(protocol), shown.facts["joint_type"]
    rows: list[Row | None] = [entrant.row(protocol, shown.name) for entrant in entrants]
    lines, css = [], []
    for metric in rules.metrics:
        unit = metric.unit(kind)
        if unit is None:
            continue
        values = [None if row is None else row.values.get(metric.id) for row in rows]
        known = [v for v in values if v is not None]
        best = (max if metric.direction == "up" else min)(known) if len(set(known)) > 1 else None
        cells = []
        for row, value in zip(rows, values, strict=True):
            more = ""
            if row is not None and value is not None and row.status != "ok":
                more = f'<small class="failed">{escape(row.status)}: penalty</small>'
            elif row is not None and value is not None and metric.id in row.values_cm:
                more = f"<small>{number_text(row.values_cm[metric.id], 'cm', True)}</small>"
            cells.append(number_cell(number_text(value, unit, True), best is not None and value == best, more=more))
        lines.append([metric_row_head(rules, metric), *cells])
        css.append("beside" if metric.supplements else "")
    note = f"{NONE}: not made by the method, or not defined for this joint. Small grey numbers do not rank."
    if any(hidden_metrics(entrant, rules) for entrant in entrants):
        note += " Numbers with a penalty that depends on the hidden truth are shown in means only."
    html = table(lines, ["number", *method_heads(entrants, True)], "numbers", f"numbers by {protocol}", css)
    return Section(f"Numbers by {protocol}", html, place="full", note=note, id=f"numbers-{protocol}")


def _notes_section(shown: SequenceContent, board: Board) -> Section:
    """Reasons and notes of scoring on each method's result."""
    blocks = []
    for entrant in board.entrants:
        lines: list[str] = []
        hashes: list[str] = []
        for protocol in board.protocols:
            row = entrant.row(protocol, shown.name)
            if row is None:
                continue
            lines.append(
                f"{row.status}: {row.reason}" if row.reason else f"Measured from {MEASURED[row.measured_from]}."
            )
            if row.swapped:
                lines.append("Its part names were exchanged to match the ground truth.")
            lines += row.notes
            if row.seconds is not None:
                lines.append(f"It took {row.seconds:.0f} s, as stated by the method.")
            if row.result_sha256:
                hashes.append(row.result_sha256)
        lines += [f"{LACKS[p].capitalize()}: numbers that need them are left out." for p in entrant.method.lacks]
        absent = shown.absent.get(entrant.file)
        if absent and not any(line in absent for line in lines):
            lines.append(absent)
        items = "".join(f"<li>{escape(line)}</li>" for line in dict.fromkeys(lines))
        items += "".join(f"<li>SHA-256 of its files {hash_text(digest)}</li>" for digest in dict.fromkeys(hashes))
        blocks.append(f"<div><h3>{method_link(entrant, True)}</h3><ul>{items}</ul></div>")
    place: Literal["right", "full"] = "right" if shown.script else "full"
    return Section("Notes of scoring", f'<div class="said">{"".join(blocks)}</div>', place=place)


def _source_section(f: dict[str, Any], row: Row | None) -> list[Section]:
    rows = [
        (key.replace("_", " "), escape(value))
        for key, value in f["source"].items()
        if isinstance(value, str | int | float)
    ]
    if f.get("licence"):
        rows.append(("licence", escape(f["licence"])))
    if row is not None and row.truth_sha256:
        rows.append(("ground truth, SHA-256", hash_text(row.truth_sha256)))
    return [Section("Source of the sequence", facts(rows), place="full")] if rows else []
