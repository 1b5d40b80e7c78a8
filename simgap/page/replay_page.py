"""The page of a replay: measured and simulated runs, and the command that repeats it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from freeart21.joint import JointType
from freeart21.view.document import Section, document, render
from freeart21.view.tables import table_section
from simgap.page.report_plots import run_section
from simgap.prove.comparison import compare_curves
from simgap.prove.replay import RunReplay

MOST_DRAWN = 40
"""Runs whose curves are drawn; each takes some 50 kB."""
MOST_SIGMAS = 1e6
"""Larger values occur with readings without noise, whose sigma is a rounding error."""
HEAD = ("run", "rms error", "in sigmas", "used", "start", "start velocity")
"""Columns of `Row.texts`."""
NOTE = (
    "Simulated from the asset's files alone. Only the state at each run's first reading is free; it is fitted to the "
    "run. Sigma is the noise of the readings."
)


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
    return Section("Repeat it", render("repeat.html.j2", "simgap.page", commands=commands), place="full", note=note)


def replay_page(title: str, about: Sequence[str], command: str, rows: Sequence[Row], notes: Sequence[str] = ()) -> str:
    """The page as HTML, self-contained."""
    texts = [row.texts() for row in rows]
    more = [f"{len(rows) - MOST_DRAWN} more are in curves/."] if len(rows) > MOST_DRAWN else []
    sections = [
        table_section("Runs", texts, HEAD, "full", " ".join([NOTE, *notes, *more])),
        repeat_section({"This replay": command}),
    ]
    for row, (name, error, sigmas, *_) in list(zip(rows, texts, strict=True))[:MOST_DRAWN]:
        run = row.replay
        gap = compare_curves(run.run, run.times_s, run.measured, (run.simulated, run.simulated), run.noise)
        sections.append(
            run_section(f"Run {name}: {error}, {sigmas} sigmas", gap, row.joint_type, ("by the files", None))
        )
    return document(title, sections, "replay", about)
