"""A comparison as tables: on a terminal, or in a CSV, JSON, Markdown or LaTeX file."""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import pandas as pd
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.places import Output, require_replaceable
from leaderboard import bootstrap
from leaderboard.compare import By, Comparison, Group
from leaderboard.protocol import Metric
from leaderboard.submission import escape_unprintable
from leaderboard.tables import NOTHING, WIDTH, column_foot, column_head, decimals, ranking_metrics, unit_suffix

SCHEMA = "freeart21/comparison/2"
COMPARISONS: dict[str, Output] = {
    ".csv": Output("table of a comparison", b"protocol,benchmark,by,"),
    ".json": Output("comparison", b'"schema": "freeart21/comparison/'),
    ".md": Output("comparison", b"<!-- freeart21 comparison"),
    ".tex": Output("comparison", b"% freeart21 comparison"),
}
"""Suffix to how an older file of that kind is recognised."""
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
    table = comparison.table(by)
    if by == "sequence":
        return (_grid(comparison, by, table, "value"),)
    means, medians = (_grid(comparison, by, table, show) for show in ("mean", "median"))
    return (means, medians, *_difference_grids(comparison, by, table))


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


def _grid(comparison: Comparison, by: By, table: pd.DataFrame, show: _Show) -> Grid:
    rules, metrics = comparison.rules, ranking_metrics(comparison.rules)
    typed = show != "value" and any(metric.id == "joint_type" for metric in rules.metrics)
    head = ["method", "measured", *(["type\n↑"] if typed else [])]
    head += [f"{column_head(metric)}\n{column_foot(metric)}" for metric in metrics]
    sections = []
    for group in comparison.groups(by):
        lines = table[table.group == group.name].set_index("method")
        best = {metric.id: _find_best(lines, metric, "_median" if show == "median" else "") for metric in metrics}
        rows = []
        for name, line in lines.iterrows():
            measured = f"{line.sequences - line.failures}/{line.sequences}"
            if show == "value":
                measured = comparison.frames[str(name)].status.get(group.name, NOTHING)
            cells = [Cell(str(name)), Cell(measured)]
            if typed:
                cells.append(Cell(NOTHING if pd.isna(line.get("joint_type")) else f"{100 * line.joint_type:.0f}%"))
            cells += [Cell(_format(line, group, metric, show), name in best[metric.id]) for metric in metrics]
            rows.append(tuple(cells))
        sections.append((_section_title(comparison, group), tuple(rows)))
    return Grid(f"{rules.name}, {_SHOWN[show]}", tuple(head), tuple(sections))


def _section_title(comparison: Comparison, group: Group) -> str:
    if group.by == "sequence":
        return f"{group.name}: {comparison.categories[group.name]}, {group.types[0]}"
    n = len(group.sequences)
    return f"{group.name}, {n} sequence{'' if n == 1 else 's'}"


def _find_best(lines: pd.DataFrame, metric: Metric, suffix: str) -> set[Any]:
    """The methods with the best mean (or median); empty when fewer than two have one."""
    found = lines[metric.id + suffix].dropna() if metric.id in lines else pd.Series()
    if len(found) < 2:
        return set()
    return set(found.index[found == (found.max() if metric.direction == "up" else found.min())])


def format_number(value: float, unit: str) -> str:
    """A number with the decimals of its unit; without decimals from 1000."""
    return f"{value:.{decimals(unit) if abs(value) < 999.5 else 0}f}"


def _format(line: pd.Series[Any], group: Group, metric: Metric, show: _Show) -> str:
    """A statistic, with its unit where the head of the column has none."""
    id, unit = metric.id, group.unit(metric) or ""
    if pd.isna(line.get(id)):
        return NOTHING
    text = format_number(line[f"{id}_median" if show == "median" else id], unit)
    if show == "mean" and pd.notna(line[f"{id}_std"]):
        text += f" ± {format_number(line[f'{id}_std'], unit)}"
    if show == "median":
        text += f" ({format_number(line[f'{id}_worst'], unit)})"
    return text if metric.unit("all") else text + unit_suffix(unit)


def _difference_grids(comparison: Comparison, by: By, table: pd.DataFrame) -> Iterator[Grid]:
    """One table: a section for each method but the first, rows are metrics, columns are groups."""
    groups, first = comparison.groups(by), comparison.entrants[0]
    lines = table.set_index(["method", "group"])
    sections = []
    for entrant in comparison.entrants[1:]:
        rows = []
        for metric in ranking_metrics(comparison.rules):
            name = " ".join(column_head(metric).split())
            cells = [_difference_cell(lines.loc[(entrant.name, group.name)], group, metric) for group in groups]
            rows.append((Cell(f"{name} {'↑' if metric.direction == 'up' else '↓'}"), *cells))
        sections.append((f"{entrant.name} less {first.name}", tuple(rows)))
    if sections:
        title = f"{comparison.rules.name}, differences to {first.name}"
        yield Grid(title, ("", *(group.name for group in groups)), tuple(sections))


def _difference_cell(line: pd.Series[Any], group: Group, metric: Metric) -> Cell:
    unit = group.unit(metric)
    mean, low, high, verdict = (line.get(f"{metric.id}_{key}") for key in ("difference", "low", "high", "verdict"))
    if unit is None or mean is None or pd.isna(mean):
        return Cell(NOTHING)
    text = f"{'+' if mean > 0 else ''}{format_number(mean, unit)}{unit_suffix(unit)}"
    if pd.notna(low) and pd.notna(high):
        text += f" [{format_number(low, unit)}, {format_number(high, unit)}]{_MARKS[verdict]}"
    return Cell(text, verdict == "better")


# ---- terminal


def print_comparison(comparison: Comparison, by: By, console: Console | None = None) -> None:
    """Print the tables, split to the console's width, and their legend."""
    console = console or Console()
    if not console.is_terminal:  # a file or pipe has no width
        console.width = max(console.width, WIDTH)
    for grid in make_grids(comparison, by):
        for k, table in enumerate(split_columns(grid, console)):
            console.print(f"\n[bold]{escape(escape_unprintable(grid.title))}{' (continued)' if k else ''}[/]")
            console.print(table)
    for line in legend(comparison, by):
        console.print(f"  {escape(line)}", style="dim")


def split_columns(grid: Grid, console: Console) -> Iterator[Table]:
    """The table split between columns so that each part fits the console; each has the first column."""
    at, unbounded = 1, console.options.update(width=10_000)
    while at < len(grid.head):
        end = len(grid.head)
        while end > at + 1 and console.measure(_to_rich(grid, at, end), options=unbounded).maximum > console.width:
            end -= 1
        yield _to_rich(grid, at, end)
        at = end


def _to_rich(grid: Grid, at: int, end: int) -> Table:
    """The first column and the columns `at` to `end`."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column(grid.head[0], overflow="fold", max_width=_LONGEST_NAME + 4)
    for head in grid.head[at:end]:
        table.add_column(head, justify="right", no_wrap=True)
    for name, rows in grid.sections:
        table.add_section()
        table.add_row(f"[bold]{escape(escape_unprintable(name))}[/]")
        for row in rows:
            first = f"  {_truncate(escape_unprintable(row[0].text), _LONGEST_NAME)}"
            table.add_row(
                escape(first), *(f"[bold]{escape(c.text)}[/]" if c.best else escape(c.text) for c in row[at:end])
            )
    return table


def _truncate(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


# ---- files


def kind_of(path: Path) -> Output:
    """The kind of file that `path` names; FreeArtError lists the suffixes."""
    if path.suffix not in COMPARISONS:
        raise FreeArtError(f"{path} ends in '{path.suffix}', expected {', '.join(COMPARISONS)}")
    return COMPARISONS[path.suffix]


def write_comparison(path: Path, comparison: Comparison, by: By) -> None:
    """Write `comparison` in the format of `path`'s suffix; JSON has all groups, the others those of `by`.

    Raises FreeArtError for another suffix, and when something else than an older file of this kind exists at `path`.
    """
    require_replaceable(path, kind_of(path))
    writers: dict[str, Callable[[], str]] = {
        ".csv": lambda: csv(comparison, by),
        ".json": lambda: atomic.json_text(to_json(comparison)),
        ".md": lambda: markdown(comparison, by),
        ".tex": lambda: latex(comparison, by),
    }
    atomic.write_bytes(path, writers[path.suffix]().encode())


def csv(comparison: Comparison, by: By) -> str:
    """`Comparison.table`, or by sequence `Comparison.frame`; text that a spreadsheet would take for a formula gets a
    leading apostrophe."""
    found = comparison.frame() if by == "sequence" else comparison.table(by)
    for name in found.select_dtypes(exclude="number"):
        found[name] = [f"'{v}" if isinstance(v, str) and v[:1] in "=+-@" else v for v in found[name]]
    found.insert(0, "by", by)
    found.insert(0, "benchmark", f"{comparison.benchmark['name']} {comparison.benchmark['sha256'][:12]}")
    found.insert(0, "protocol", comparison.rules.name)
    return str(found.to_csv(index=False, lineterminator="\n"))


def to_json(comparison: Comparison) -> dict[str, Any]:
    """The whole comparison: methods with their environment, the tables by type and by category, every sequence."""
    return {
        "schema": SCHEMA,
        "protocol": comparison.rules.name,
        "benchmark": comparison.benchmark,
        "methods": [
            {"name": entrant.name, "method": asdict(entrant.scores.method), "made_with": entrant.scores.made_with}
            for entrant in comparison.entrants
        ],
        "interval": bootstrap.describe(),
        "by_type": comparison.table("type").to_dict("records"),
        "by_category": comparison.table("category").to_dict("records"),
        "sequences": comparison.frame().to_dict("records"),
        "notes": list(legend(comparison, "type")),
    }


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
