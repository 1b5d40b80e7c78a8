"""The `replay` command: measured runs with an asset's files, as a table, and as a folder with the command that repeats
it.

`simgap.prove.replay` replays. From a `gap` answer beside the asset only the runs' uses are read.
"""

from __future__ import annotations

import dataclasses
import re
import shlex
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from freeart21 import __version__
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset_copy import file_hashes
from freeart21.files.hashes import file_sha256
from freeart21.files.lock import only_writer
from freeart21.files.measured import OTHER_UNITS, read_measured, run_files
from freeart21.files.places import check_place
from freeart21.files.urdf import read_root_tag
from freeart21.joint import JointType
from freeart21.measured import Run
from simgap.page.replay_page import HEAD, Row, replay_page
from simgap.prove.replay import SECONDS, Progress, replay
from simgap.prove.replay_process import AssetOnDisk, Engine
from simgap.verdict import SCHEMA as VERDICT
from simgap.verdict import Use, unit_of

SCHEMA = "freeart21/replay/1"
MEASURED, POSES = "measured.json", "poses.npz"
UNKNOWN = "unknown"


@dataclass(frozen=True)
class Replayed:
    """Result of the command."""

    asset: AssetOnDisk
    urdf: Path
    joint: str
    engine: Engine
    version: str
    """Of the engine."""
    rows: tuple[Row, ...]
    given_up: tuple[str, ...]
    """Runs that were not replayed in time."""
    notes: tuple[str, ...]
    command: str
    """The command line that repeats it."""


def replay_folder(
    asset: Path,
    runs: Sequence[Path],
    out: Path | None = None,
    engine: Engine = "sapien",
    holding: float | None = None,
    guesses: bool = True,
    seconds: float = SECONDS,
    progress: Progress | None = None,
    root: Path | None = None,
) -> Replayed:
    """Replay measured runs with the files of an asset; with `out` also written to a new folder: replay.json, curves, a
    page.

    Args:
        asset: an asset folder, or a URDF.
        runs: measured sets, or files of runs in such.
        out: appears as a whole or not at all; must not exist.
        engine: the simulator.
        holding: interpolation of inputs where a set does not specify it: 0 smooth, 1 zero-order hold; None for 0.
        guesses: whether effects that asset.json marks as guessed act.
        seconds: time limit.
        progress: called with the number of replayed runs and their total.
        root: folder that the files named in the URDF must be in.

    Raises FreeArtError when asset or runs cannot be read, nothing is replayed in time, or `out` exists.
    """
    if out is not None:
        check_place(out, None, (asset, *runs))
    _check_urdf(asset)
    files = AssetOnDisk(asset, root, guesses)
    uses, sets = _read_uses(asset), _find_sets(runs)
    if out is not None:
        check_place(out, None, sets)
    end, total = time.monotonic() + seconds, sum(map(len, sets.values()))
    rows: list[Row] = []
    given_up: list[str] = []
    notes: list[str] = []
    joints, version, urdf = dict[str, None](), "", asset
    for folder, names in sets.items():
        measured, paths = read_measured(folder), run_files(folder)
        _check_names(folder, names, measured.runs)
        measured = dataclasses.replace(measured, runs=tuple(run for run in measured.runs if run.poses is None))
        urdf = files.read(measured).urdf
        notes += [note for note in measured.notes if any(f"'{name}'" in note for name in names)]
        if holding is None and measured.interpolation == "unknown" and _is_driven(measured.runs, names):
            notes.append(f"{folder} does not say how inputs go on between their rows: smoothly here (else --holding 1)")
        unit, per_unit = _read_unit(folder, measured.joint_type)
        done = len(rows) + len(given_up)
        (found,) = replay(
            (files,),
            measured,
            names,
            engine=engine,
            holding=holding or 0.0,
            seconds=max(end - time.monotonic(), 0.0),
            progress=None if progress is None else lambda k, _, done=done: progress(done + k, total),  # type: ignore[misc]
        )
        version = found.version or version
        joints[measured.joint] = None
        label = "{}" if len(sets) == 1 else f"{folder}: {{}}"
        given_up += [label.format(name) for name in found.given_up]
        for run in found.runs:
            use = uses.get(file_sha256(paths[run.run], folder), UNKNOWN)
            file = folder / paths[run.run].relative_to(folder.resolve())
            rows.append(Row(label.format(run.run), file, unit, per_unit, use, measured.joint_type, run))
    if not rows:
        raise FreeArtError(f"none of {total} runs was replayed within {seconds:g} s, expected more time (--seconds)")
    command = _command_line(asset, runs, engine, holding, guesses, root)
    row_lists = tuple(rows), tuple(given_up), tuple(notes)
    result = Replayed(files, urdf, ", ".join(joints), engine, version, *row_lists, command)
    if out is not None:
        with only_writer(out), atomic.new_folder(out) as aside:
            _write(aside, result)
    return result


def _check_urdf(asset: Path) -> None:
    """FreeArtError where another kind of model is given in place of a URDF."""
    if asset.is_file() and (tag := read_root_tag(asset)) != "robot":
        raise FreeArtError(
            f"{asset} is of <{tag}>, expected a URDF's <robot>, or an asset folder: MuJoCo (--engine mujoco) takes the "
            "MJCF that lies beside a URDF"
        )


def _find_sets(runs: Sequence[Path]) -> dict[Path, list[str]]:
    """Folder of a measured set to the names of the runs to replay, in order."""
    found: dict[Path, list[str]] = {}
    for path in runs:
        if not path.exists():
            raise FreeArtError(f"{path} does not exist")
        folder = next((place for place in (path, *path.absolute().parents) if (place / MEASURED).is_file()), None)
        if folder is None:
            raise FreeArtError(
                f"{path} is no measured set and lies in none ({MEASURED}): `freeart21 measure FILES --asset URDF --out "
                "SET` makes one of a joint's positions"
            )
        files, here = run_files(folder), path.resolve()
        places = {name: (file, file.parent) if file.name == POSES else (file,) for name, file in files.items()}
        names = [name for name, at in places.items() if folder is path or here in at]
        if not names:
            raise FreeArtError(f"{folder / MEASURED} names no run {path}; runs: {', '.join(files)}")
        folder = next((known for known in found if known.resolve() == folder.resolve()), folder)
        already = found.setdefault(folder, [])
        already += [name for name in names if name not in already]
    if not found:
        raise FreeArtError("no run to replay, expected measured sets or files of runs in such")
    return found


def _check_names(folder: Path, names: Sequence[str], runs: Sequence[Run]) -> None:
    """FreeArtError where a run is a duplicate and was dropped, or has no positions."""
    of = {run.name: run for run in runs}
    for name in names:
        if name not in of:
            raise FreeArtError(f"{folder}: run '{name}' is another run of the set again, and is left out")
        if of[name].poses is not None:
            raise FreeArtError(
                f"{folder}: run '{name}' is of part poses, expected positions of the joint: `freeart21 gap` makes "
                "them of poses, in runs/ of its answer"
            )


def _is_driven(runs: Sequence[Run], names: Sequence[str]) -> bool:
    inputs = [(run.effort, run.q_command, run.voltage) for run in runs if run.name in names]
    return any(values is not None for each in inputs for values in each)


def _read_unit(folder: Path, kind: JointType) -> tuple[str, float]:
    """Unit of positions in the files of a set, and its size in rad or m."""
    own = unit_of("position", kind)
    unit = checked.read_json(folder / MEASURED)["units"].get("q", own)
    return unit, 1.0 if unit == own else OTHER_UNITS[own][unit]


def _read_uses(asset: Path) -> dict[str, str]:
    """SHA-256 of a run's file to its use, from the verdict beside the asset's folder."""
    home = asset if asset.is_dir() else asset.parent
    path = home.resolve().parent / "verdict.json"
    try:
        verdict_json = checked.read_json(path, VERDICT) if path.is_file() else {}
    except FreeArtError:
        return {}
    uses, proof = verdict_json.get("uses"), verdict_json.get("proof")
    hashes = proof.get("runs") if isinstance(proof, dict) else None
    if not isinstance(uses, dict) or not isinstance(hashes, dict):
        return {}
    return {str(hashes[name]): use for name, use in uses.items() if name in hashes and use in get_args(Use)}


def _command_line(
    asset: Path, runs: Sequence[Path], engine: str, holding: float | None, guesses: bool, root: Path | None
) -> str:
    words = ["freeart21", "replay", str(asset), *map(str, runs)]
    words += [] if engine == "sapien" else ["--engine", engine]
    words += [] if holding is None else ["--holding", repr(holding)]
    words += [] if guesses else ["--without-guesses"]
    words += [] if root is None else ["--root", str(root)]
    return shlex.join(words)


def _write(out: Path, result: Replayed) -> None:
    """Write replay.json, a curve per run, and the page."""
    names = _file_names([row.name for row in result.rows])
    for row, name in zip(result.rows, names, strict=True):
        unit, run = unit_of("position", row.joint_type), row.replay
        columns = (run.times_s.tolist(), run.measured.tolist(), run.simulated.tolist())
        lines = (",".join(map(repr, values)) for values in zip(*columns, strict=True))
        head = f"t_s,measured_{unit},simulated_{unit}"
        atomic.write_bytes(out / name, "\n".join([head, *lines, ""]).encode())
    atomic.write_json(
        out / "replay.json",
        {
            "schema": SCHEMA,
            "command": result.command,
            "engine": result.engine,
            "versions": {"freeart21": __version__, result.engine: result.version},
            "joint": result.joint,
            "asset": {"path": str(result.asset.path), "files": file_hashes(result.urdf, result.asset.root)},
            "runs": [_row_to_json(row, name) for row, name in zip(result.rows, names, strict=True)],
            "given_up": list(result.given_up),
            "notes": list(result.notes),
        },
    )
    about = [f"joint {result.joint}", f"{result.engine} {result.version}", f"{len(result.rows)} runs"]
    html = replay_page(str(result.asset.path), about, result.command, result.rows, result.notes)
    atomic.write_bytes(out / "index.html", html.encode())


def _row_to_json(row: Row, curve: str) -> dict[str, Any]:
    """A run in replay.json."""
    run = row.replay
    return {
        "run": row.name,
        "file": str(row.file),
        "sha256": file_sha256(row.file),
        "use": row.use,
        "error": run.error,
        "noise": run.noise,
        "sigmas": run.sigmas,
        "unit": unit_of("position", row.joint_type),
        "start": {"q": run.start[0], "qd": run.start[1]},
        "readings": len(run.times_s),
        "timestep_s": run.timestep_s,
        "change_sigmas": run.change,
        "curve": curve,
    }


def _file_names(names: Sequence[str]) -> list[str]:
    """A unique file name for each run."""
    safe = [re.sub(r"[^\w.-]+", "_", name).strip("._") or "run" for name in names]
    twice = len(set(safe)) < len(safe)
    return [f"curves/{f'{k:03d}_' * twice}{name}.csv" for k, name in enumerate(safe)]


def format_table(result: Replayed) -> str:
    """The runs as lines of text."""
    rows = [HEAD, *(row.texts() for row in result.rows)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(HEAD))]
    return "\n".join("  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
