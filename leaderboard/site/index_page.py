"""The front page: a ranking by every protocol, with every sequence below it, and published tables of other papers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from freeart21.view.document import Markup, Section, render
from freeart21.view.tables import ARROWS, NONE, Cell, number_cell, number_text, table
from leaderboard.points import FIRST, TRACK_TEXTS, TRACKS, Standing, is_outside_ranking, standings
from leaderboard.protocols import Group, Protocol, protocol_named
from leaderboard.published import PUBLISHED, PublishedRow
from leaderboard.rows import Statistic
from leaderboard.site.common import (
    PACKAGE,
    Board,
    best_of,
    columns,
    facts,
    method_heads,
    method_link,
    metric_head,
    page,
    score_cell,
    sentence,
    sequence_link,
    statistic_of,
)
from leaderboard.site.entrant import Entrant


@dataclass(frozen=True)
class Place:
    """One line of a ranking."""

    entrant: Entrant
    standings: dict[str, Standing]
    """By track (`leaderboard.points`), without tracks whose numbers it lacks."""
    means: tuple[Statistic | None, ...]
    """Of every column; None where it has no number."""
    measured: int

    @property
    def text(self) -> str:
        """Its place in the first track; a dash where it has none."""
        whole = self.standings.get(FIRST)
        return NONE if whole is None else "ref." if whole.place is None else str(whole.place)


def index_page(board: Board) -> bytes:
    """The front page."""
    benchmark, frames = board.benchmark, sum(s.facts.get("frames", 0) for s in board.sequences)
    rows = [
        ("benchmark", f"{benchmark['name']}, version {benchmark['version']}"),
        ("split", benchmark["split"]),
        *([("frames", f"{frames:,}".replace(",", " "))] if frames else []),
        ("ground truth", f"{benchmark['sha256'][:12]}{', hidden' if benchmark.get('hidden') else ''}"),
    ]
    lead = render(
        "index_lead.html.j2",
        PACKAGE,
        methods=len(board.entrants),
        videos=len(board.sequences),
        facts=facts(rows),
        hidden=bool(benchmark.get("hidden")),
        with_data=bool(frames),
        copies=describe_copies(board.entrants),
        protocols=board.protocols,
    )
    sections = [*(_ranking_section(board, name) for name in board.protocols), _published_section()]
    return page(board, board.title, sections, here="index.html", lead=lead)


def describe_copies(methods: Sequence[Entrant]) -> list[str]:
    """A sentence for each pair of methods that hold the same files for some sequences."""
    of = [
        {row.sequence: row.result_sha256 for row in next(iter(e.scores.values())).rows if row.status == "ok"}
        for e in methods
    ]
    found = []
    for (one, own), (other, its) in combinations(zip(methods, of, strict=True), 2):
        same = sum(digest is not None and its.get(name) == digest for name, digest in own.items())
        if same:
            found.append(f"{one.name} and {other.name} hold the same files for {same} of {len(own)} sequences.")
    return found


def ranked(protocol: str, entrants: Sequence[Entrant]) -> list[Place]:
    """All methods by their points on the whole; those that lack a number of it after the others, by their other points.

    The order of two methods depends on these two alone.
    """
    rules, heads = protocol_named(protocol), columns(protocol_named(protocol))
    references = frozenset(e.name for e in entrants if is_outside_ranking(e.method))
    tables = {entrant.name: entrant.whole[protocol] for entrant in entrants}
    found = {track: standings(tables, track, rules, references) for track in TRACKS}
    places = []
    for entrant in entrants:
        own = {track: of[entrant.name] for track, of in found.items() if entrant.name in of}
        means = tuple(statistic_of(entrant, rules, metric, group) for metric, group in heads)
        places.append(Place(entrant, own, means, entrant.scores[protocol].measured))

    def points(place: Place) -> tuple[float, ...]:
        return tuple(-place.standings[track].points if track in place.standings else 1.0 for track in TRACKS)

    return sorted(places, key=points)


def _ranking_section(board: Board, protocol: str) -> Section:
    rules = protocol_named(protocol)
    heads, places = columns(rules), ranked(protocol, board.entrants)
    up, meaning = ARROWS["up"]
    head = [
        Cell("#", title="1 plus the number of methods that are better beyond doubt"),
        "method",
        Cell("measured", css="number", title="the others count with their penalty in every mean"),
        *(
            Cell(track, None, "number", f"points {up}", title=f"{sentence(TRACK_TEXTS[track])} 0 to 100, {meaning}.")
            for track in TRACKS
        ),
        *(metric_head(metric, group) for metric, group in heads),
    ]
    best = [
        best_of([None if mean is None else mean.mean for mean in means], metric)
        for (metric, _), means in zip(heads, zip(*(place.means for place in places), strict=True), strict=True)
    ]
    lines = []
    for place in places:
        cells = []
        for (metric, group), found, top in zip(heads, place.means, best, strict=True):
            unit, value = metric.unit(group), None if found is None else found.mean
            below = "" if found is None or found.std is None else f"± {number_text(found.std, unit)}"
            cells.append(number_cell(number_text(value, unit), value is not None and value == top, value, below))
        points = [place.standings[track].points if track in place.standings else None for track in TRACKS]
        order = tuple(place.standings)[:1] == (FIRST,) and place.standings[FIRST].place
        lines.append(
            [
                Cell(place.text, order or 10**6),
                Cell(method_link(place.entrant), place.entrant.name),
                number_cell(f"{place.measured} of {len(board.sequences)}", value=place.measured),
                *(number_cell(number_text(value, "points"), value=value) for value in points),
                *cells,
            ]
        )
    ranking, every = table(lines, head, "sortable ranking", "ranking"), _sequences(board, rules)
    html = render("ranking.html.j2", PACKAGE, protocol=protocol, ranking=ranking, sequences=every)
    title = f"Ranking by {protocol}" if rules.ranking else f"By {protocol}: another protocol, not the ranking"
    return Section(title, html, place="full", id=f"protocol-{protocol}")


def _sequences(board: Board, rules: Protocol) -> Markup:
    """Every sequence with the first number of every method; the pages of sequences and methods have all."""
    metric = next((m for m in rules.metrics if m.column and m.supplements is None), rules.metrics[0])
    rows = []
    for s in board.sequences:
        thumb = Markup('<img class="thumb" src="{}" alt="">').format(s.thumb) if s.thumb else Markup("")
        cells = [Cell(thumb + sequence_link(s.name, board), s.name), s.facts["category"], s.facts["joint_type"]]
        for row in (entrant.row(rules.name, s.name) for entrant in board.entrants):
            failed = row.status if row is not None and row.status != "ok" else ""
            cells.append(score_cell(row, metric, s.facts["joint_type"], below=failed))
        rows.append(cells)
    head = ["sequence", "category", "joint", *method_heads(board.entrants)]
    note = Markup('<p class="note">{}. All numbers are on the pages of sequences and methods.</p>').format(metric.label)
    return note + table(rows, head, "sortable every", "every sequence")


def _published_section() -> Section:
    """Tables from publications, by protocol, data set, joint type and source; never ranked."""
    groups: dict[tuple[str, str, Group, str], list[PublishedRow]] = {}
    for one in PUBLISHED:
        groups.setdefault((one.protocol, one.dataset, one.group, one.source), []).append(one)
    tables = []
    for (protocol, dataset, group, source), members in groups.items():
        ids, rules = list(dict.fromkeys(id for row in members for id in row.values)), protocol_named(protocol)
        head = ["method", *(metric_head(rules.metric(id), group) for id in ids)]
        rows = []
        for row in members:
            numbers = [row.values.get(id, (None, None)) for id in ids]
            texts = [(NONE if v is None else f"{v:.2f}", "" if std is None else f"± {std:.2f}") for v, std in numbers]
            rows.append([row.method, *(number_cell(mean, below=below) for mean, below in texts)])
        tables.append((f"{dataset}, {group}, closest protocol {protocol}", source, table(rows, head, label=dataset)))
    return Section("As published", render("published.html.j2", PACKAGE, tables=tables), place="full", id="published")
