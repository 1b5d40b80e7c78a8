"""Definitions: the text of every protocol of the site, and where its numbers come from."""

from __future__ import annotations

import shlex

from freeart21.view.document import Markup, Section, render
from freeart21.view.tables import ARROWS, number_text, table
from leaderboard.points import FIRST, HALF, HALF_IN_UNITS, PARTS, TRACKS
from leaderboard.protocols import PROTOCOLS, Metric, Protocol, protocol_named
from leaderboard.rows import Scores
from leaderboard.site.common import (
    PACKAGE,
    Board,
    metric_name,
    page,
    penalty_sentence,
    sentence,
    unit_text,
)

PENALTY = (
    "A sequence that cannot be measured counts with a fixed penalty in every mean, so that no method gains by leaving "
    "out difficult sequences: a declared failure, a missing or unreadable result, an asset that does not load. With a "
    "wrong joint type, the numbers that then do not exist (axis, position, state) count with their penalty. A number "
    "that a method states it never makes is shown as a dash, without a penalty; such a method has a place in the "
    "tracks whose numbers it has."
)
POINTS = (
    "A number earns 1 / (1 + error / half) points: all where nothing is wrong, half of them at the error below. A "
    "track is the mean over its numbers, times 100; a sequence that failed earns 0. Rows made from the truth, or "
    "given a part of it as input, have points and no place. Scales are fixed: no method changes the points or the "
    "order of two others."
)
LEAD = (
    "A protocol never changes: another definition gets another name. Numbers by different protocols are not compared."
)


def definitions_page(board: Board) -> bytes:
    """The page of definitions."""
    command = render("command.html.j2", PACKAGE, command=shlex.join(board.command), benchmark=board.benchmark)
    paragraph = Markup("<p class=text>{}</p>")
    sections = [
        Section("Penalties", paragraph.format(PENALTY), place="full", id="penalty"),
        Section("Points", paragraph.format(POINTS) + _points_table(), place="full", id="points"),
        *(_protocol_section(protocol_named(name)) for name in board.protocols),
        Section("Command and data", command, place="full", id="command"),
    ]
    return page(board, "Definitions", sections, here="definitions.html", lead=Markup("<p>{}</p>").format(LEAD))


def _points_table() -> Markup:
    """The error that earns half the points, by metric."""
    of = {metric.id: metric for name in sorted(PROTOCOLS) for metric in PROTOCOLS[name].metrics}
    rows = []
    for track, groups in TRACKS.items():
        for id in (i for group in groups for i in group if i in of and (track != FIRST or group is PARTS)):
            unit = of[id].unit("all") or "deg or %"
            half = number_text(HALF_IN_UNITS.get(id, HALF[id]), unit, True)
            rows.append([metric_name(of[id]), "parts" if track == FIRST else track, half])
    return table(rows, ["number", "track", "half the points at"], "points", "points")


def _protocol_section(rules: Protocol) -> Section:
    entries = []
    for metric in rules.metrics:
        beside = f" Shown with {metric.supplements}; not part of the ranking." if metric.supplements else ""
        about = f"Unit: {_unit_sentence(metric)}; {ARROWS[metric.direction][1]}; {penalty_sentence(metric)}."
        entries.append((metric.id, metric_name(metric), sentence(metric.definition) + beside, about))
    html = render("protocol.html.j2", PACKAGE, rules=rules, entries=entries)
    return Section(rules.name, html, place="full", id=rules.name)


def _unit_sentence(metric: Metric) -> str:
    """'° (revolute), cm (prismatic)', for example."""
    units = {"revolute": metric.revolute_unit, "prismatic": metric.prismatic_unit}
    texts = {kind: unit_text(unit) or "fraction" for kind, unit in units.items() if unit is not None}
    if len(texts) == 1:
        return f"{next(iter(texts.values()))}; {next(iter(texts))} joints only"
    if len(set(texts.values())) == 1:
        return next(iter(texts.values()))
    return ", ".join(f"{text} ({kind})" for kind, text in texts.items())


def scores_csv(scores: Scores) -> bytes:
    """A line per sequence: type, status, reason, source, seconds, every number in its unit, `id_cm` in centimetres."""
    lines = scores.frame().reset_index().rename(columns={"truth_type": "joint_type_truth"})
    lines["swapped"] = lines["swapped"].astype(int)
    return str(lines.map(_no_formula).to_csv(index=False, lineterminator="\n")).encode()


def _no_formula(value: object) -> object:
    """Text that no spreadsheet takes for a formula."""
    return f"'{value}" if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r") else value
