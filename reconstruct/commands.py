"""The solver's command: tyro reads the function's signature, and the help its docstring."""

from __future__ import annotations

import math
import os
import platform
import sys
from dataclasses import replace
from functools import update_wrapper
from inspect import signature
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

import freeart21
from freeart21 import processes
from freeart21.processes import DOUBTFUL
from reconstruct.settings import ReconstructSettings, read_settings
from reconstruct.stages import STAGES, CachedStageName

if TYPE_CHECKING:
    from collections.abc import Callable

    from freeart21.reconstruction import Reconstruction

STOP_AFTER = "Stop after this stage and save its result for the next call. " + " ".join(
    f"{stage.name}: {stage.description}." for stage in STAGES if stage.cached
)
Positional: Any = tyro.conf.Positional
HIDDEN = Annotated[ReconstructSettings, tyro.conf.Suppress]


def reconstruct(
    sequence: Annotated[Path, Positional],
    out: Path,
    until: Annotated[CachedStageName | None, tyro.conf.arg(help=STOP_AFTER)] = None,
    keep_work: bool = False,
    tracker: str | None = None,
    poses: str | None = None,
    settings_file: Annotated[Path | None, tyro.conf.arg(name="settings", metavar="FILE.json")] = None,
    settings: ReconstructSettings = ReconstructSettings(),  # noqa: B008 (frozen)
) -> int:
    """Reconstruct one sequence from the video alone: two parts, their poses, their joint, and meshes.

    Can be stopped at any moment: the same command resumes after the last finished stage, with the same result. An older
    result at --out, with its asset, is replaced; anything else there is an error. The last line says whether to trust
    the result: `sound`, or `doubtful` with exit code 3.

    Args:
        sequence: A sequence folder (with sequence.json).
        out: Result folder, such as results/ours/SEQ.
        keep_work: Keep the stages' files after the result is written, for calls with other settings.
        tracker: Short for --settings.tracks.tracker: dis, or a learned one (docs/priors.md).
        poses: Short for --settings.poses-from: bundlesdf:FOLDER (docs/priors.md).
        settings_file: JSON of settings: a method.json, or its `settings` alone. What it lacks keeps its default.
        settings: One setting, such as --settings.joint.type-rule paper; --settings.help lists them all.
    """
    from freeart21.files.lock import only_writer
    from freeart21.files.places import RESULT, check_place
    from freeart21.files.result import Method, write_own_method
    from freeart21.reconstruction import Failure
    from reconstruct import VERSION
    from reconstruct.cache import work_folder
    from reconstruct.pipeline import reconstruct_folder, reconstruct_until

    if tracker is not None:
        settings = replace(settings, tracks=replace(settings.tracks, tracker=tracker))
    if poses is not None:
        settings = replace(settings, poses_from=poses)
    check_place(out, RESULT, (sequence,))
    work = work_folder(out)
    hint = f"finished stages are in {work}: the same command goes on"
    with processes.resume_hint(lambda: hint if work.is_dir() else ""), only_writer(out):
        if until is not None:
            outcome = reconstruct_until(sequence, out, until, settings)
            if isinstance(outcome, Path):
                size = outcome.stat().st_size / 1e6
                print(f"{outcome}: results until {until} ({size:.1f} MB); the next call for {out} goes on from here")
                return 0
            print(f"{out}: failed in {outcome.stage}: {outcome.reason}", file=sys.stderr)
            return 1
        result = reconstruct_folder(sequence, out, settings, keep_work)
    code = f"freeart21 {freeart21.__version__}, solver {VERSION}"
    home = out.absolute().parent
    write_own_method(home, Method(home.name, code, settings.to_json(), _hardware()))
    if isinstance(result, Failure):
        print(f"{out}: failed in {result.stage}: {result.reason}", file=sys.stderr)
        return 1
    return _print_result(result, out)


def _print_result(result: Reconstruction, out: Path) -> int:
    """Print joint, standard deviations, time and, last, whether to trust the result; 0 when sound, 3 when doubtful."""
    joint = result.articulation.joint
    low, high = _format_state(joint.lower, joint.type), _format_state(joint.upper, joint.type)
    known = []
    if result.axis_std is not None:
        known.append(f"axis to {math.degrees(result.axis_std):.2g} deg")
    if result.pivot_std is not None:
        known.append(f"pivot to {1000 * result.pivot_std:.2g} mm")
    stds = f" ({', '.join(known)})" if known else ""
    seconds = sum(result.seconds.values())
    print(f"{out}: {joint.type} joint{stds}, {low} to {high}, {len(result)} frames in {seconds:.0f} s")
    if result.trust is None or result.trust.verdict == "sound":
        print("sound")
        return 0
    print(f"doubtful: {'; '.join(result.trust.reasons)}")
    return DOUBTFUL


def _format_state(state: float, joint_type: str) -> str:
    return f"{math.degrees(state):.1f} deg" if joint_type == "revolute" else f"{100 * state:.2f} cm"


def _hardware() -> str:
    return f"{platform.machine()}, {os.cpu_count()} cores"


def with_settings(words: list[str]) -> Callable[..., int]:
    """`reconstruct` for these words of a command line: the settings' defaults come from the file of `--settings`, and
    the single settings are in its help only where one of them, or `--settings.help`, is among the words."""
    named = [after for word, after in pairwise(words) if word == "--settings"]
    named += [word.partition("=")[2] for word in words if word.startswith("--settings=")]
    parameters = dict(signature(reconstruct).parameters)
    if named:
        parameters["settings"] = parameters["settings"].replace(default=read_settings(Path(named[-1])))

    def command(*arguments: Any, **options: Any) -> int:
        return reconstruct(*arguments, **options)

    update_wrapper(command, reconstruct)
    command.__dict__.pop("__wrapped__")  # tyro reads the signature of what is wrapped
    command.__signature__ = signature(reconstruct).replace(parameters=[*parameters.values()])  # type: ignore[attr-defined]
    if not any(word.startswith("--settings.") for word in words):
        command.__annotations__ = {**reconstruct.__annotations__, "settings": HIDDEN}
    return command
