"""The page of a sequence: its video with every method's parts over it, 3D, joint states, and all numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from freeart21.view.document import escape
from leaderboard.protocols import protocol_named
from leaderboard.rows import Row
from leaderboard.site.entrant import Entrant
from leaderboard.site.html import (
    NONE,
    facts,
    method_link,
    metric_row,
    number,
    number_cell,
    page,
    section,
    sources,
    table,
)
from leaderboard.site.index_page import TABLES_ALONE, hidden_metrics
from leaderboard.site.sequence_data import Shown

WORDS = {
    "states": "makes no joint states",
    "poses": "makes no poses of the parts over time",
    "masks": "makes no part masks",
    "meshes": "makes no meshes",
    "renders": "makes no held-out views",
}
"""What a method says that it does not make, where it would be."""
MEASURED = {
    "asset": "the asset, loaded and driven in the simulator",
    "files": "the result's files, as there is no asset",
    "nothing": "nothing",
}


def sequence_page(
    site: str,
    shown: Shown,
    file: str,
    entrants: Sequence[Entrant],
    protocols: Sequence[str],
    around: tuple[tuple[str, str] | None, tuple[str, str] | None],
) -> bytes:
    """The page; `around` holds name and file name of the sequence before and of the one after it."""
    f = shown.facts
    lines = [("joint", escape(f["joint_type"]))]
    if "range" in f:
        unit = "°" if f["joint_type"] == "revolute" else " cm"
        motion = f["range"] * (57.29577951308232 if f["joint_type"] == "revolute" else 100)
        lines = [("category", escape(f["category"])), *lines, ("range", f"{motion:.1f}{unit}")]
        lines.append(("diagonal", f"{f['diagonal_cm']:.1f} cm"))
    if "frames" in f:
        lines.append(("video", f"{f['frames']} frames, {f['seconds']:.1f} s, {escape(f['size'])}"))
    lead = facts(lines)
    steps = "".join(
        f'<a rel="{rel}" href="{escape(place[1])}.html">{arrow.format(escape(place[0]))}</a>'
        if place
        else "<span></span>"
        for rel, arrow, place in (("prev", "← {}", around[0]), ("next", "{} →", around[1]))
    )
    numbers = "".join(_numbers(name, shown, entrants) for name in protocols)
    said = _said(shown, entrants, protocols)
    main = (
        f'<nav class="steps" aria-label="sequences">{steps}</nav>{_shown(shown, file, entrants)}{numbers}{said}'
        f"{_source(f, entrants[0].row(protocols[0], shown.name))}"
    )
    scripts = [f"../data/{file}.js"] if shown.script else []
    return page(shown.name, main, site, True, lead=lead, kind="Sequence", scripts=scripts)


def _shown(shown: Shown, file: str, entrants: Sequence[Entrant]) -> str:
    """Video, 3D and joint states; of tables alone, that there are none."""
    if not shown.script:
        return section("Video and parts", f'<p class="note">{TABLES_ALONE}</p>')
    hidden = "range" not in shown.facts
    told = _told(shown, entrants, hidden)
    sheets = [f"../video/{file}-{k}.jpg" for k in range(len(shown.sheets))]
    there = [s for s in told if s["id"] == "truth" or s["id"] not in shown.absent]
    noted = (
        "Solid lines and stronger colour: the moving part; dashed: the reference part. Parts go by the truth's names."
    )
    where = (
        "The truth is hidden: each answer stands where it says that the object is, in the camera's frame of the first "
        "picture; the slider moves all joints of one type."
        if hidden
        else "Answers lie in the truth's frame as the protocol aligns them; the slider moves all joints of the true "
        "type."
    )
    counted = (
        "The truth is hidden: states are counted as the first shown method counts; the sign of the axis and the median "
        "offset to it are taken out."
        if hidden
        else "States are counted as the truth counts: the sign of the axis and the median offset are taken out, as in "
        "scoring. Grey: not one pixel of the moving part is seen."
    )
    video = section(
        "Video and parts",
        '<div class="stage"><p class="note">Loading …</p></div><div class="player"></div>',
        "player",
        {"sources": told, "sheets": sheets},
        place="half",
        note=noted,
    )
    scene = section(
        "Parts and joint in 3D",
        f'<div class="scene"></div>{_absent_list(shown, entrants, "meshes")}',
        "scene",
        {"sources": there},
        place="half right",
        note=f"{where} Shown are prediction.json and parts/, thinned out; pale: the reference part.",
    )
    states = section(
        "Joint state",
        '<div class="states"></div>',
        "states",
        {"sources": told},
        note=f"{counted} Curves that leave the scale run along its edge.",
    )
    if hidden and len(shown.absent) == len(entrants):
        return video + section("Parts and joint in 3D", _absent_list(shown, entrants, "meshes"))
    return f'<div class="pair">{video}{scene}</div>{states}'


def _told(shown: Shown, entrants: Sequence[Entrant], hidden: bool) -> list[dict[str, Any]]:
    """The sources with what the scripts say where one shows nothing."""
    told = sources(entrants, hidden)
    told[0]["first"] = True
    for k, (source, entrant) in enumerate(zip(told[not hidden :], entrants, strict=True)):
        lacks, absent = entrant.method.lacks, shown.absent.get(entrant.file)
        source["first"] = k == 0
        source["why"] = _brief(absent) if absent else WORDS["masks"] if "masks" in lacks else ""
        source["noStates"] = (
            _brief(absent) if absent else WORDS["states"] if "states" in lacks else "another joint type"
        )
    return told


def _brief(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}…"


def _absent_list(shown: Shown, entrants: Sequence[Entrant], piece: str) -> str:
    """A line for each method that shows no surface: why."""
    lines = []
    for entrant in entrants:
        why = shown.absent.get(entrant.file) or (WORDS["meshes"] if piece in entrant.method.lacks else "")
        if why:
            lines.append(f"<li>{method_link(entrant, True)} <span>{escape(why)}</span></li>")
    return f'<ul class="absent">{"".join(lines)}</ul>' if lines else ""


def _numbers(protocol: str, shown: Shown, entrants: Sequence[Entrant]) -> str:
    """Every number of every method by one protocol, in one table."""
    rules, kind = protocol_named(protocol), shown.facts["joint_type"]
    rows: list[Row | None] = [entrant.row(protocol, shown.name) for entrant in entrants]
    head = '<th scope="col">number</th>' + "".join(
        f'<th scope="col" class="number">{method_link(e, True)}</th>' for e in entrants
    )
    lines = []
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
                more = f'<small class="failed">{escape(row.status)}: price</small>'
            elif row is not None and value is not None and metric.id in row.values_cm:
                more = f"<small>{number(row.values_cm[metric.id], 'cm', True)}</small>"
            cells.append(number_cell(number(value, unit, True), best is not None and value == best, more=more))
        lines.append(metric_row(rules, metric, "".join(cells)))
    note = (
        f"{NONE}: not made by the method, or not there for this joint. Small numbers stand beside the ranking ones and "
        "do not rank."
    )
    if any(hidden_metrics(entrant, rules) for entrant in entrants):
        note += " Numbers whose price is the hidden truth's stand in the means alone."
    numbers = table(f"numbers by {protocol}", "numbers", head, "".join(lines))
    return section(f"Numbers by {protocol}", numbers, id=f"numbers-{protocol}", note=note)


def _said(shown: Shown, entrants: Sequence[Entrant], protocols: Sequence[str]) -> str:
    """What scoring says of each method's row: reasons and notes, in its words."""
    blocks = []
    for entrant in entrants:
        lines: dict[str, None] = {}
        hashes: dict[str, None] = {}
        for protocol in protocols:
            row = entrant.row(protocol, shown.name)
            if row is None:
                continue
            lines[f"{row.status}: {row.reason}" if row.reason else f"Measured from {MEASURED[row.measured_from]}."] = (
                None
            )
            if row.swapped:
                lines["Its parts go by each other's names; they are shown and scored under the truth's."] = None
            lines.update(dict.fromkeys(row.notes))
            if row.seconds is not None:
                lines[f"It took {row.seconds:.0f} s, by its own word."] = None
            if row.result_sha256:
                hashes[row.result_sha256] = None
        for piece in entrant.method.lacks:
            lines[f"{WORDS[piece].capitalize()}: such numbers are left out, never priced."] = None
        if shown.absent.get(entrant.file) and not any(line in shown.absent[entrant.file] for line in lines):
            lines[shown.absent[entrant.file]] = None
        items = "".join(f"<li>{escape(line)}</li>" for line in lines)
        items += "".join(f'<li>Its files, SHA-256 <code class="hash">{escape(digest)}</code></li>' for digest in hashes)
        blocks.append(f"<div><h3>{method_link(entrant, True)}</h3><ul>{items}</ul></div>")
    return section("What scoring says", f'<div class="said">{"".join(blocks)}</div>')


def _source(f: dict[str, Any], row: Row | None) -> str:
    source = f["source"]
    rows = [
        (key.replace("_", " "), escape(value)) for key, value in source.items() if isinstance(value, str | int | float)
    ]
    if f.get("licence"):
        rows.append(("licence", escape(f["licence"])))
    if row is not None and row.truth_sha256:
        rows.append(("truth, SHA-256", f'<code class="hash">{escape(row.truth_sha256)}</code>'))
    return section("Where the sequence came from", facts(rows)) if rows else ""
