"""The page of a replay: every run as it was measured and as the files have it, and the command that does it again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from freeart21.files import atomic
from freeart21.joint import JointType
from freeart21.view.document import Section, document, escape
from freeart21.view.tables import table_section
from simgap.page.report_plots import run_drawings
from simgap.prove.replay import RunReplay
from simgap.prove.show import ReplayGap

MOST_DRAWN = 40
"""Runs whose curves are drawn: each takes some 50 kB."""


@dataclass(frozen=True)
class Drawn:
    """One run of the page."""

    name: str
    joint_type: JointType
    replay: RunReplay
    texts: tuple[str, ...]
    """Its row of the table."""


def repeat_section(commands: dict[str, str], note: str = "") -> Section:
    """What repeats the proof: what a command is of to the command line."""
    lines = "".join(
        f'<p class="note">{escape(what)}</p><pre class="command">{escape(line)}</pre>'
        for what, line in commands.items()
    )
    return Section("Repeat it", lines + (f'<p class="note">{escape(note)}</p>' if note else ""), place="full")


def write_replay_page(
    path: Path,
    title: str,
    about: Sequence[str],
    command: str,
    head: Sequence[str],
    runs: Sequence[Drawn],
    notes: Sequence[str] = (),
) -> None:
    """Write the page, one file that needs no other."""
    told = (
        "Simulated from the asset's files alone. Only the state at each run's first reading is free; it is fitted to "
        "the run. Sigma is the noise of the readings."
    )
    sections = [
        table_section("Runs", [run.texts for run in runs], head, "full", " ".join([told, *notes])),
        repeat_section({"This replay": command}),
    ]
    for drawn in runs[:MOST_DRAWN]:
        run = drawn.replay
        curves = run.times_s, run.measured, run.simulated, run.simulated
        gap = ReplayGap(run.run, *curves, run.error, run.error, run.noise, "", "fitted")
        figures, data = run_drawings(gap, drawn.joint_type, ("by the files", None))
        heading = f"Run {drawn.name}: {drawn.texts[1]}, {drawn.texts[2]} sigmas"
        sections.append(Section(heading, f'<div class="charts wide">{"".join(figures)}</div>', "curves", data, "full"))
    if len(runs) > MOST_DRAWN:
        sections.append(Section("More runs", f"<p>{len(runs) - MOST_DRAWN} more are in curves/.</p>", place="full"))
    atomic.write_bytes(path, document(title, sections, "replay", about).encode())
