"""simgap's commands: tyro reads each function's signature, and the help its docstring."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from freeart21.errors import FreeArtError

Positional: Any = tyro.conf.Positional


@dataclass(frozen=True)
class TruthOptions:
    """Options of `measure` for truths: the simulated tracker, and the object."""

    noise_mm: float = 0.5
    """Standard deviation of the tracker's translations, mm."""
    noise_deg: float = 0.2
    """Standard deviation of the tracker's rotations, degrees."""
    seed: int = 0
    """Seed of the tracker's errors."""
    partnet_root: Path | None = None
    """Folder of PartNet-Mobility objects, for truths of such objects."""
    urdf: Path | None = None
    """The object's URDF as it was recorded, for truths of a URDF."""
    root: Path | None = None
    """The --root of that recording."""


def gap(
    asset: Annotated[Path, Positional],
    measured: Annotated[Path, Positional],
    out: Path,
    seconds: float = 120.0,
    replay_seconds: float = 120.0,
    poses: Path | None = None,
    root: Path | None = None,
) -> None:
    """Name the physical effects that an asset's simulation lacks, from measured runs or an RGB-D video.

    Args:
        asset: An asset folder or a URDF.
        measured: A measured set (with measured.json), or a sequence folder: a video of the asset.
        out: Folder for verdict.json, the repaired asset (or camera.json for `record --camera`) and a page. An older one
            there is replaced.
        seconds: Limit of the search on a measured set, processor seconds; the answer says when it was reached.
        replay_seconds: Limit of the replay of a measured set in SAPIEN, s; the answer says when it was reached.
        poses: For a video: the result or truth folder with the asset's poses; the asset's own result, or the truth of
            the sequence, when not given.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
    """
    is_video = (measured / "sequence.json").is_file()
    if not is_video and poses is not None:
        raise FreeArtError(f"gap: --poses goes with a video; {measured} has no sequence.json")
    from freeart21.progress import progress_bar

    verdict: Any
    with progress_bar("Searching for missing effects") as show:
        if is_video:
            from simgap.film.workflow import film_gap_folder

            verdict = film_gap_folder(asset, measured, out, poses, partial(show, "Comparing the videos"), root)
        else:
            from simgap.settings import GapSettings
            from simgap.workflow import gap_folder

            settings, replaying = GapSettings(seconds=seconds), partial(show, "Replaying in SAPIEN")
            verdict = gap_folder(asset, measured, out, settings, replay_seconds, replaying, root)
    for note in verdict.notes:
        print(f"- {note}", file=sys.stderr)
    print(f"{verdict.verdict}: {verdict.sentence}")
    proof = getattr(verdict, "proof", None)
    for what, line in ({} if proof is None else proof.repeat).items():
        print(f"gap {what}: {line}")
    print(out / "verdict.json")


def replay(
    asset: Annotated[Path, Positional],
    runs: Annotated[tuple[Path, ...], Positional],
    out: Path | None = None,
    engine: Literal["sapien", "mujoco"] = "sapien",
    holding: Annotated[float | None, tyro.conf.arg(metavar="PART")] = None,
    without_guesses: bool = False,
    seconds: float = 120.0,
    root: Path | None = None,
) -> None:
    """Simulate measured runs from an asset's files alone, and print the simulation error of each run.

    Only the start state of a run is fitted; it is reported. `gap` prints the same numbers.

    Args:
        asset: An asset folder or a URDF, with effects.json (or MJCF for MuJoCo) next to it.
        runs: Measured sets (with measured.json), or files of runs in them.
        out: New folder for replay.json, a curve of every run and a page.
        engine: Simulator: sapien, or mujoco, whose format lacks some effects.
        holding: Inputs between their rows, where the set says unknown: 0 smooth, 1 held [0].
        without_guesses: Leave out effects that asset.json marks as guessed, as `gap` does.
        seconds: Limit of the whole replay, s; runs beyond it are left out.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
    """
    from freeart21.progress import progress_bar
    from simgap.replay import format_table, replay_folder

    if not seconds > 0 or not (holding is None or 0 <= holding <= 1):
        raise FreeArtError(
            f"replay: --seconds is {seconds:g}, expected above 0, and --holding {holding}, expected 0 to 1"
        )
    with progress_bar(f"Replaying in {engine}", counted=True) as show:
        progress = partial(show, f"Replaying in {engine}")
        done = replay_folder(asset, runs, out, engine, holding, not without_guesses, seconds, progress, root)
    for note in done.notes:
        print(f"- {note}", file=sys.stderr)
    if done.given_up:
        print(f"- not replayed within {seconds:g} s: {', '.join(done.given_up)}", file=sys.stderr)
    print(format_table(done))
    print(done.command if out is None else out / "replay.json")
