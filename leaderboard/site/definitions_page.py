"""What each number means: the text of every protocol of the site, and of prices."""

from __future__ import annotations

from collections.abc import Sequence

from freeart21.view.document import escape
from leaderboard.protocols import Protocol, protocol_named
from leaderboard.site.html import page, price_text, section, sentence, unit_text

PRICE = (
    "A price is what a row costs that cannot be measured: a declared failure, a missing or unreadable result, an asset "
    "that does not load. It stands in every mean, so that no method gains by leaving out what is hard. A number that a "
    "method says it never makes is left out instead, and shown as a dash: it is not priced, and such a method has no "
    "place by mean rank. A wrong joint type prices the numbers that then do not exist: axis, place and state."
)


def definitions_page(site: str, protocols: Sequence[str]) -> bytes:
    """The page."""
    main = section("What a price is", f"<p class=text>{PRICE}</p>", id="price")
    main += "".join(_protocol(protocol_named(name)) for name in protocols)
    lead = (
        "<p>A protocol is named and never changes: a changed definition is another protocol. Numbers of two protocols "
        "are never set side by side.</p>"
    )
    return page("Definitions", main, site, here="definitions.html", lead=lead)


def _protocol(rules: Protocol) -> str:
    paragraphs = "".join(f"<p class=text>{escape(part)}</p>" for part in rules.preamble.split("\n\n"))
    entries = []
    for metric in rules.metrics:
        units = {metric.revolute_unit, metric.prismatic_unit} - {None}
        told = (
            unit_text(next(iter(units))) or "fraction"
            if len(units) == 1
            else f"{unit_text(metric.revolute_unit)} (revolute), {unit_text(metric.prismatic_unit)} (prismatic)"
        )
        only = (
            "; revolute only"
            if metric.prismatic_unit is None
            else "; prismatic only"
            if metric.revolute_unit is None
            else ""
        )
        beside = f" Stands beside {metric.supplements} and does not rank." if metric.supplements else ""
        better = "larger is better" if metric.direction == "up" else "smaller is better"
        entries.append(
            f'<div id="{escape(rules.name)}.{escape(metric.id)}"><dt>{escape(metric.label or metric.id)} '
            f"<code>{escape(metric.id)}</code></dt>"
            f"<dd><p>{escape(sentence(metric.definition))}{escape(beside)}</p>"
            f'<p class="note">In {escape(told)}{only}; {better}; a failure costs {escape(price_text(metric))}.'
            "</p></dd></div>"
        )
    return section(rules.name, f'{paragraphs}<dl class="definitions">{"".join(entries)}</dl>', id=rules.name)
