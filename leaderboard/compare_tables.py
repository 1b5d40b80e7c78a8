"""A comparison as tables of text, for a terminal, Markdown or LaTeX."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from leaderboard import bootstrap
from leaderboard.compare import By, Comparison, Difference, Group, Standing
from leaderboard.protocol import Metric
from leaderboard.submission import escape_unprintable
from leaderboard.tables import NOTHING, WIDTH, column_foot, column_head, decimals, ranking_metrics, unit_suffix

_LONGEST_NAME = 22
"""Characters of a method's name on a terminal."""
_Show = Literal["mean", "median", "value"]
_SHOWN: dict[_Show, str] = {
    "mean": "mean ± standard deviation",
    "median": "median (worst)",
    "value": "each sequence",
}
_MARKS = {"better": " ✓", "worse": " ✗", "open": ""}
_LATEX = {
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{c: f"\\{c}" for c in "&%$#_{}"},
    **{NOTHING: "--", "±": r"$\pm$", "°": r"$^{\circ}$", "↑": r"$\uparrow$", "↓": r"$\downarrow$"},
    **{"✓": r"$\checkmark$", "✗": r"$\times$", "²": r"$^{2}$"},
    **{"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}"},
}


@dataclass(frozen=True)
class Cell:
    """One cell of a table."""

    text: str
    best: bool = False
    """Whether it is highlighted."""


@dataclass(frozen=True)
class Grid:
    """A table of text whose first column names the rows."""

    title: str
    head: tuple[str, ...]
    """Column heads, each of one or more lines."""
    sections: tuple[tuple[str, tuple[tuple[Cell, ...], ...]], ...]
    """Name and rows of each section."""


def make_grids(comparison: Comparison, by: By) -> tuple[Grid, ...]:
    """The tables of a comparison: means, medians, and differences to the first method; by sequence, the values."""
    groups, metrics = comparison.groups(by), ranking_metrics(comparison.rules)
    if by == "sequence":
        return (_grid(comparison, groups, metrics, "value"),)
    means, medians = (_grid(comparison, groups, metrics, show) for show in ("mean", "median"))
    return (means, medians, *_difference_grids(comparison, groups, metrics))


def legend(comparison: Comparison, by: By) -> tuple[str, ...]:
    """Lines that explain the tables."""
    lines = [
        f"Protocol {comparison.rules.name} on {comparison.benchmark['name']} {comparison.benchmark['version']}: "
        f"{len(comparison.types)} sequences; failed and missing ones count in every number with their penalty.",
    ]
    if by != "sequence":
        lines.append(
            "Standard deviations are of a sample (ddof 1). measured: rows that were not penalised. Best in bold."
        )
    if by != "sequence" and len(comparison.entrants) > 1:
        lines.append(
            f"Differences: mean over the same sequences, {100 * bootstrap.LEVEL:g} % interval ({bootstrap.KIND}; "
            f"{bootstrap.RESAMPLES} resamples, seed {bootstrap.SEED}); none below {bootstrap.min_sequences()} "
            f"sequences. ✓ better, ✗ worse than {comparison.entrants[0].name}; unmarked: 0 lies within, or there is no "
            "interval. Where nothing differs, one interval in twenty leaves 0 out."
        )
    lacking = [
        f"{NOTHING} {entrant.name} makes no {', '.join(entrant.scores.method.lacks)}."
        for entrant in comparison.entrants
        if entrant.scores.method.lacks
    ]
    return tuple(escape_unprintable(line) for line in (*lines, *lacking, *comparison.notes))


# ---- cells


def _grid(comparison: Comparison, groups: tuple[Group, ...], metrics: Sequence[Metric], show: _Show) -> Grid:
    rules = comparison.rules
    typed = show != "value" and any(metric.id == "joint_type" for metric in rules.metrics)
    head = ["method", "measured", *(["type\n↑"] if typed else [])]
    head += [f"{column_head(metric)}\n{column_foot(metric)}" for metric in metrics]
    sections = []
    for group in groups:
        standings = [comparison.standing(entrant, group) for entrant in comparison.entrants]
        best = {
            metric.id: _find_best(standings, metric, "median" if show == "median" else "mean") for metric in metrics
        }
        rows = []
        for k, (entrant, standing) in enumerate(zip(comparison.entrants, standings, strict=True)):
            measured = f"{standing.sequences - standing.failures}/{standing.sequences}"
            if show == "value":
                row = comparison.row(entrant, group.name)
                measured = NOTHING if row is None else row.status
            cells = [Cell(entrant.name), Cell(measured)]
            if typed:
                right = standing.statistics.get("joint_type")
                cells.append(Cell(NOTHING if right is None else f"{100 * right.mean:.0f}%"))
            cells += [Cell(_format(standing, group, metric, show), k in best[metric.id]) for metric in metrics]
            rows.append(tuple(cells))
        sections.append((_section_title(comparison, group), tuple(rows)))
    return Grid(f"{rules.name}, {_SHOWN[show]}", tuple(head), tuple(sections))


def _section_title(comparison: Comparison, group: Group) -> str:
    if group.by == "sequence":
        return f"{group.name}: {comparison.categories[group.name]}, {group.types[0]}"
    n = len(group.sequences)
    return f"{group.name}, {n} sequence{'' if n == 1 else 's'}"


def _find_best(standings: Sequence[Standing], metric: Metric, by: Literal["mean", "median"]) -> set[int]:
    """Indices of the methods with the best mean (or median); empty when fewer than two have one."""
    found = {k: getattr(s.statistics[metric.id], by) for k, s in enumerate(standings) if metric.id in s.statistics}
    if len(found) < 2:
        return set()
    best = max(found.values()) if metric.direction == "up" else min(found.values())
    return {k for k, value in found.items() if value == best}


def format_number(value: float, unit: str) -> str:
    """A number with the decimals of its unit; without decimals from 1000."""
    return f"{value:.{decimals(unit) if abs(value) < 999.5 else 0}f}"


def _format(standing: Standing, group: Group, metric: Metric, show: _Show) -> str:
    """A statistic, with its unit where the head of the column has none."""
    found, unit = standing.statistics.get(metric.id), group.unit(metric) or ""
    if found is None:
        return NOTHING
    text = format_number(found.median if show == "median" else found.mean, unit)
    if show == "mean" and found.std is not None:
        text += f" ± {format_number(found.std, unit)}"
    if show == "median":
        text += f" ({format_number(found.worst, unit)})"
    return text if metric.unit("all") else text + unit_suffix(unit)


def _difference_grids(comparison: Comparison, groups: tuple[Group, ...], metrics: Sequence[Metric]) -> Iterator[Grid]:
    """One table: a section for each method but the first, rows are metrics, columns are groups."""
    first = comparison.entrants[0]
    found: dict[tuple[str, str, str], Difference] = {}
    for group in groups:
        for one in comparison.differences(group) if len(comparison.entrants) > 1 else ():
            if one.other == first.name:
                found[one.method, one.metric, group.name] = one
    sections = []
    for entrant in comparison.entrants[1:]:
        rows = []
        for metric in metrics:
            name = " ".join(column_head(metric).split())
            cells = [_difference_cell(found.get((entrant.name, metric.id, g.name)), g, metric) for g in groups]
            rows.append((Cell(f"{name} {'↑' if metric.direction == 'up' else '↓'}"), *cells))
        sections.append((f"{entrant.name} less {first.name}", tuple(rows)))
    if sections:
        title = f"{comparison.rules.name}, differences to {first.name}"
        yield Grid(title, ("", *(group.name for group in groups)), tuple(sections))


def _difference_cell(found: Difference | None, group: Group, metric: Metric) -> Cell:
    unit = group.unit(metric)
    if found is None or unit is None:
        return Cell(NOTHING)
    interval = found.interval
    text = f"{'+' if interval.mean > 0 else ''}{format_number(interval.mean, unit)}{unit_suffix(unit)}"
    if interval.low is not None and interval.high is not None:
        text += f" [{format_number(interval.low, unit)}, {format_number(interval.high, unit)}]{_MARKS[found.verdict]}"
    return Cell(text, found.verdict == "better")


# ---- terminal


def print_comparison(comparison: Comparison, by: By, console: Console | None = None) -> None:
    """Print the tables, split to the console's width, and their legend."""
    console = console or Console()
    if not console.is_terminal:  # a file or pipe has no width
        console.width = max(console.width, WIDTH)
    for grid in make_grids(comparison, by):
        for part in split_columns(grid, console.width):
            console.print(f"\n[bold]{escape(escape_unprintable(part.title))}[/]")
            console.print(_to_rich(part))
    for line in legend(comparison, by):
        console.print(f"  {escape(line)}", style="dim")


def split_columns(grid: Grid, width: int) -> Iterator[Grid]:
    """The table split between columns so that each part fits `width` characters; each has the first column."""
    widths = [_column_width(grid, k) for k in range(len(grid.head))]
    at = 1
    while at < len(widths):
        end, room = at, width - widths[0]
        while end < len(widths) and (end == at or widths[end] <= room):
            room -= widths[end]
            end += 1
        chosen = [0, *range(at, end)]
        sections = tuple((name, tuple(tuple(row[k] for k in chosen) for row in rows)) for name, rows in grid.sections)
        more = " (continued)" if at > 1 else ""
        yield Grid(grid.title + more, tuple(grid.head[k] for k in chosen), sections)
        at = end


def _column_width(grid: Grid, column: int) -> int:
    """Characters that a column takes on a terminal, its gap included."""
    texts = [*grid.head[column].split("\n"), *(row[column].text for _, rows in grid.sections for row in rows)]
    if column == 0:
        texts += [name for name, _ in grid.sections]
    longest = max(map(len, texts))
    return (min(longest, _LONGEST_NAME + 4) if column == 0 else longest) + 2


def _to_rich(grid: Grid) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for k, head in enumerate(grid.head):
        left = k == 0
        table.add_column(
            head,
            justify="left" if left else "right",
            no_wrap=not left,
            overflow="fold",
            max_width=_LONGEST_NAME + 4 if left else None,
        )
    for name, rows in grid.sections:
        table.add_section()
        table.add_row(f"[bold]{escape(escape_unprintable(name))}[/]")
        for row in rows:
            first = f"  {_truncate(escape_unprintable(row[0].text), _LONGEST_NAME)}"
            table.add_row(escape(first), *(f"[bold]{escape(c.text)}[/]" if c.best else escape(c.text) for c in row[1:]))
    return table


def _truncate(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


# ---- Markdown and LaTeX


def markdown(comparison: Comparison, by: By) -> str:
    """All tables and their legend as Markdown."""
    parts = [f"<!-- freeart21 comparison by {by} -->"]
    for grid in make_grids(comparison, by):
        lines = [f"### {_escape_markdown(grid.title)}", ""]
        lines.append("| " + " | ".join(["", *(_escape_markdown(" ".join(head.split())) for head in grid.head)]) + " |")
        lines.append("|---|---|" + "---:|" * (len(grid.head) - 1))
        for name, rows in grid.sections:
            for k, row in enumerate(rows):
                words = [f"**{_escape_markdown(c.text)}**" if c.best else _escape_markdown(c.text) for c in row]
                lines.append("| " + " | ".join([_escape_markdown(name) if k == 0 else "", *words]) + " |")
        parts.append("\n".join(lines))
    return "\n\n".join([*parts, *map(_escape_markdown, legend(comparison, by))]) + "\n"


def latex(comparison: Comparison, by: By) -> str:
    """All tables as LaTeX for \\input; needs booktabs, graphicx (scales them to the page) and amssymb."""
    parts = [
        f"% freeart21 comparison by {by}; in the preamble: \\usepackage{{booktabs,graphicx,amssymb}}",
        *(f"% {escape_unprintable(line)}" for line in legend(comparison, by)),
    ]
    for grid in make_grids(comparison, by):
        last = len(grid.head)
        lines = [r"\begin{table}[htbp]", r"\centering", rf"\caption{{{_escape_latex(grid.title)}}}"]
        lines += [r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"]
        lines += [rf"\begin{{tabular}}{{l{'r' * (last - 1)}}}", r"\toprule"]
        lines.append(" & ".join(_escape_latex(" ".join(head.split())) for head in grid.head) + r" \\")
        for name, rows in grid.sections:
            lines += [r"\midrule", rf"\multicolumn{{{last}}}{{l}}{{\textit{{{_escape_latex(name)}}}}} \\"]
            for row in rows:
                words = [rf"\textbf{{{_escape_latex(c.text)}}}" if c.best else _escape_latex(c.text) for c in row]
                lines.append(" & ".join(words) + r" \\")
        lines += [r"\bottomrule", r"\end{tabular}}", r"\end{table}"]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def _escape_markdown(text: str) -> str:
    return re.sub(r"([\\`*_\[\]|~#])", r"\\\1", html.escape(escape_unprintable(text), quote=False))


def _escape_latex(text: str) -> str:
    """`text` for pdfLaTeX; characters beyond Latin-1, which its fonts can lack, become their number, such as U+6F22."""
    words = "".join(_LATEX.get(c, c if ord(c) < 0x100 else f"U+{ord(c):04X}") for c in escape_unprintable(text))
    return re.sub(r"(?<![\w-])-(?=\d)", "$-$", words)
