"""The page of a replay: measured and simulated runs, and the command that repeats it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from freeart21.joint import JointType
from freeart21.view.document import Section, document, escape
from freeart21.view.tables import table_section
from simgap.page.report_plots import run_drawings
from simgap.prove.comparison import ReplayGap, compare_curves
from simgap.prove.replay import RunReplay
from simgap.verdict import Quantity

MOST_DRAWN = 40
"""Runs whose curves are drawn; each takes some 50 kB."""


MOST_SIGMAS = 1e6
"""Larger values occur with readings without noise, whose sigma is a rounding error."""
HEAD = ("run", "rms error", "in sigmas", "used", "start", "start velocity")
"""Columns of `Row.texts`."""


@dataclass(frozen=True)
class Row:
    """One run."""

    name: str
    """Unique over all given sets."""
    file: Path
    unit: str
    """Unit of positions in the file."""
    per_unit: float
    """rad or m per unit."""
    use: str
    """Use according to the verdict beside the asset; "unknown" without one, or for other runs."""
    joint_type: JointType
    replay: RunReplay

    def texts(self) -> tuple[str, ...]:
        """The row of the table: errors and start in the unit of the data."""
        run = self.replay
        error, q, qd = (f"{value / self.per_unit:.6g} {self.unit}" for value in (run.error, *run.start))
        sigmas = f"{run.sigmas:.4g}" if run.sigmas < MOST_SIGMAS else f"over {MOST_SIGMAS:g}"
        return self.name, error, sigmas + " (ill-conditioned)" * (not run.is_converged), self.use, q, f"{qd}/s"


def repeat_section(commands: dict[str, str], note: str = "") -> Section:
    """Command lines that repeat the proof, by description."""
    lines = "".join(
        f'<p class="note">{escape(what)}</p><pre class="command">{escape(line)}</pre>'
        for what, line in commands.items()
    )
    return Section("Repeat it", lines + (f'<p class="note">{escape(note)}</p>' if note else ""), place="full")


def run_section(
    title: str, run: ReplayGap, kind: JointType, names: tuple[str, str | None], by: Quantity = "position"
) -> Section:
    """The curves of a run; `names` are those of the simulations, None for one that is not drawn."""
    figures, data = run_drawings(run, kind, names, by)
    return Section(title, f'<div class="charts wide">{"".join(figures)}</div>', "curves", data, "full")


def replay_page(title: str, about: Sequence[str], command: str, rows: Sequence[Row], notes: Sequence[str] = ()) -> str:
    """The page as HTML, self-contained."""
    note_text = (
        "Simulated from the asset's files alone. Only the state at each run's first reading is free; it is fitted to "
        "the run. Sigma is the noise of the readings."
    )
    texts = [row.texts() for row in rows]
    sections = [
        table_section("Runs", texts, HEAD, "full", " ".join([note_text, *notes])),
        repeat_section({"This replay": command}),
    ]
    for row, (name, error, sigmas, *_) in list(zip(rows, texts, strict=True))[:MOST_DRAWN]:
        run = row.replay
        gap = compare_curves(run.run, run.times_s, run.measured, (run.simulated, run.simulated), run.noise)
        heading = f"Run {name}: {error}, {sigmas} sigmas"
        sections.append(run_section(heading, gap, row.joint_type, ("by the files", None)))
    if len(rows) > MOST_DRAWN:
        sections.append(Section("More runs", f"<p>{len(rows) - MOST_DRAWN} more are in curves/.</p>", place="full"))
    return document(title, sections, "replay", about)
