"""The front page of a board: its phases, what was submitted, and how places changed."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from freeart21.files import atomic
from freeart21.files.places import PAGE, require_replaceable
from freeart21.view.document import Section, document, escape
from freeart21.view.tables import NONE, Markup, row_head, table, two_lines, value_cell
from leaderboard.board.ledger import Entry, Ledger, Places
from leaderboard.board.settings import BoardSettings
from leaderboard.points import FIRST


def write_front_page(path: Path, settings: BoardSettings, ledger: Ledger, shown: Collection[str]) -> None:
    """Write the page; `shown` are the phases that have a site in the folder of their name next to it."""
    require_replaceable(path, PAGE)
    phases = []
    for phase in settings.phases:
        days = f"{phase.starts} to {phase.ends or 'no end yet'} (UTC)"
        name = escape(phase.name)
        link = f'<a href="{name}/index.html">{name}</a>' if phase.name in shown else name
        phases.append([row_head(f"{link}<br><small>{days}</small>"), str(len(ledger.current(phase.name)))])
    current = {(e.phase, e.method, e.submission) for p in settings.phases for e in ledger.current(p.name).values()}
    sections = [
        Section("Phases", table(phases, ["phase", "methods"], "list", "phases"), place="full"),
        Section("Places since", _history(ledger), place="full", note=_PLACES_NOTE),
        Section("Submissions", _submissions(ledger, current), place="full", note=_SUBMISSIONS_NOTE),
    ]
    limit = settings.limits.per_week
    lead = (
        f"<p>Submissions are pull requests: at most {limit} of a method in seven days. The newest one that was scored "
        "counts. Every table is in the repository, and its hash in the signed ledger: <code>freeart21 board verify"
        "</code> checks them.</p>"
    )
    atomic.write_bytes(path, document(settings.title, sections, "board", lead=lead).encode())


_PLACES_NOTE = (
    f"Points of the track '{FIRST}' where the method has them, else of its first track; methods with one place are "
    "tied. A line for each time at which something changed, the newest first."
)
_SUBMISSIONS_NOTE = (
    "Received is when the board saw it first. SHA-256 is of the ZIP, or of the names and bytes in the folder."
)


def _history(ledger: Ledger) -> str:
    rows = [[two_lines(_day(h.time), f"{h.phase}, {h.protocol}", True), _places(h)] for h in reversed(ledger.history)]
    return table(rows, ["from", "place, method, points"], "list", "history of places")


def _places(history: Places) -> Markup:
    """All methods in the order of their first track with points: those of the first track come first."""
    lines, seen = [], set()
    for track, methods in history.tracks.items():
        found = sorted(methods.items(), key=lambda one: (one[1][1] or 0, -(one[1][0] or 0)))
        for name, (points, place) in found:
            if name not in seen:
                seen.add(name)
                number = NONE if place is None else f"{place:.0f}"
                where = "" if track == FIRST else f" <small>{escape(track)} only</small>"
                lines.append(f"{number} {escape(name)} <small>{points or 0:.1f}</small>{where}")
    return value_cell("<br>".join(lines), html=True)


def _submissions(ledger: Ledger, current: Collection[tuple[str, str, str]]) -> str:
    rows = []
    for entry in reversed(ledger.entries):
        name = f"{entry.method} / {entry.submission}"
        counts = (entry.phase, entry.method, entry.submission) in current
        rows.append([two_lines(name, f"{entry.phase}, {_day(entry.received)}", True), _status(entry, counts)])
    return table(rows, ["submission, phase, received", "status, SHA-256"], "list", "submissions")


def _status(entry: Entry, counts: bool) -> Markup:
    if entry.status == "refused":
        return value_cell(f"<b>refused</b>: {escape(entry.reason)}", html=True, css="who")
    digest = f'<br><small><code title="{escape(entry.sha256)}">{escape(entry.sha256[:12])}</code></small>'
    status = f"{'<b>counts</b>' if counts else 'scored'}, in a {escape(entry.isolation)}{digest}"
    return value_cell(status, html=True, css="who")


def _day(time: str) -> str:
    return time[:16].replace("T", " ")
