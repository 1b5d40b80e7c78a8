"""Runs a method over the sequences of a data folder: measured, within limits, its output read as a stranger's."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import processes
from freeart21.articulation import PARTS
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import Benchmark, read_benchmark
from freeart21.files.json_record import read_record
from freeart21.files.lock import only_writer
from freeart21.files.places import RESULT, check_place
from freeart21.files.result import RESULT_FILES, Method, read_result, write_method, write_result
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.formats import rgbd_folder
from freeart21.mesh import Mesh
from freeart21.reconstruction import PIECES, Failure, Piece
from leaderboard.adapters.importer import import_results
from leaderboard.adapters.layout import Options, common_lacks
from leaderboard.methods.descriptor import (
    NATIVE,
    PRIVILEGED,
    SCHEMA,
    Descriptor,
    fill_words,
    known_values,
    needs_home,
)
from leaderboard.methods.measured import Usage, run_measured
from leaderboard.submission import find_link_faults

RUN_SCHEMA = "freeart21/run/1"
ENGINES = ("docker", "podman")
_HIDDEN = ".run"
"""In the results folder: logs, and the folders of the sequence under way."""


@dataclass(frozen=True)
class Entry:
    """What became of one sequence."""

    outcome: str
    """'answer' or 'failure'."""
    reason: str
    seconds: float
    cpu_seconds: float
    peak_bytes: int
    lacks: list[Piece] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Report:
    """The outcome of a run."""

    entries: dict[str, Entry]
    skipped: tuple[str, ...]
    """Sequences that an earlier run had finished."""


class _Failed(Exception):
    """The method has no answer: a stage and one line."""

    def __init__(self, stage: str, reason: str) -> None:
        super().__init__(reason)
        self.stage, self.reason = stage, reason


def run_method(
    method: Descriptor,
    data: Path,
    out: Path,
    home: Path | None = None,
    sequences: tuple[str, ...] = (),
    engine: str = "docker",
    truth: Path | None = None,
    progress: Callable[[str, int, int], None] = lambda name, done, total: None,
) -> Report:
    """Run `method` over `sequences` of `data` (all when empty) into the results folder `out`.

    Finished sequences of the same descriptor are skipped, so that the same call goes on. Each other one is prepared,
    run within the descriptor's limits, and its output copied or imported; a method that is stopped, ends with an error
    or writes what cannot be read has failed there, with the reason. run.json holds time, memory and versions.

    Args:
        method: What to run.
        data: Data folder; its truth is read for privileged inputs alone.
        out: Results folder.
        home: The method's checkout, for {home}.
        sequences: Some of the data folder's.
        engine: Program that runs images: one of ENGINES.
        truth: The truth of a packed data folder.
        progress: Called with a sequence, the number done, and their total.

    Raises FreeArtError, before anything is written, for what is not the method's fault.
    """
    benchmark, out = read_benchmark(data), Path(out)
    wanted = sequences or benchmark.sequences
    for name in wanted:
        if name not in benchmark.sequences:
            raise FreeArtError(f"{data} has no sequence '{name}'; it has {', '.join(benchmark.sequences[:5])}, ...")
    if needs_home(method) and (home is None or not home.is_dir()):
        raise FreeArtError(f"{method.name} needs its checkout: give --home DIR, got {home}")
    if engine not in ENGINES:
        raise FreeArtError(f"engine is '{engine}', expected {' or '.join(ENGINES)}")
    digest = hashlib.sha256(atomic.json_text(asdict(method)).encode()).hexdigest()
    before = _read_earlier(out, digest, (data, *([home] if home else [])))
    options = _read_options(method, home)
    versions = [_read_version(method, words, home) for words in method.versions]
    where = {name: benchmark.truth(name) if truth is None else truth / "truth" / name for name in wanted}
    with only_writer(out):
        out.mkdir(parents=True, exist_ok=True)
        entries = dict(before)
        todo = [name for name in wanted if name not in before or not (out / name / "prediction.json").is_file()]
        for done, name in enumerate(todo):
            progress(name, done, len(todo))
            work = out / _HIDDEN / "work"
            shutil.rmtree(work, ignore_errors=True)
            work.mkdir(parents=True)
            entries[name] = _run_one(method, benchmark, name, where[name], work, out, home, engine, options)
            shutil.rmtree(work, ignore_errors=True)
            _write_run(out, method, digest, versions, entries)
        _write_run(out, method, digest, versions, entries)
    return Report({name: entries[name] for name in wanted}, tuple(name for name in wanted if name not in todo))


def _read_earlier(out: Path, digest: str, inputs: tuple[Path, ...]) -> dict[str, Entry]:
    """What an earlier run of the same descriptor has finished in `out`; FreeArtError when something else is there."""
    path = out / "run.json"
    if not path.exists():
        if out.exists() and any(entry.name != _HIDDEN for entry in out.iterdir()):
            raise FreeArtError(f"{out} is not a run of a method; choose another place")
        check_place(out, None, inputs) if not out.exists() else None
        return {}
    data = checked.read_json(path, RUN_SCHEMA)
    if data.get("descriptor_sha256") != digest:
        raise FreeArtError(f"{out} was run with another descriptor; choose another place, or remove it")
    try:
        return {str(name): Entry(**entry) for name, entry in data["sequences"].items()}
    except (KeyError, TypeError, AttributeError) as error:
        raise FreeArtError(f"{path}: 'sequences' is not what a run writes") from error


def _run_one(
    method: Descriptor,
    benchmark: Benchmark,
    name: str,
    truth: Path,
    work: Path,
    out: Path,
    home: Path | None,
    engine: str,
    options: Options,
) -> Entry:
    """Run one sequence and write its result folder."""
    values = _prepare_inputs(method, benchmark.sequence(name), truth, work)
    written = work / "out"
    written.mkdir()
    log = out / _HIDDEN / f"{name}.log"
    log.unlink(missing_ok=True)
    total = {"seconds": 0.0, "cpu_seconds": 0.0, "peak_bytes": 0}
    lacks: list[Piece] = []
    notes: list[str] = []
    try:
        for words in method.commands:
            given = {**values, "name": name, "home": home, "out": written}
            usage = _run_command(method, words, given, work, log, engine, method.limits.seconds - total["seconds"])
            total["seconds"] += usage.seconds
            total["cpu_seconds"] += usage.cpu_seconds
            total["peak_bytes"] = max(total["peak_bytes"], usage.peak_bytes)
            if usage.stopped_by:
                raise _Failed("limits", usage.stopped_by)
            if usage.code != 0:
                raise _Failed("run", f"{words[0]} ended with exit code {usage.code}{_last_line(log)}")
        source = written / fill_words([method.result], {"name": name})[0]
        lacks, notes = _collect(method, source, benchmark, name, work, out, options)
    except _Failed as failed:
        seconds = {"run": round(total["seconds"], 2)}
        write_result(out / name, Failure(failed.stage, failed.reason, seconds))
    answer = read_result(out / name, appearance=False)
    took = round(total["seconds"], 2), round(total["cpu_seconds"], 2), int(total["peak_bytes"])
    if isinstance(answer, Failure):  # declared here, or by the method itself
        return Entry("failure", f"{answer.stage}: {answer.reason}", *took, lacks, notes)
    return Entry("answer", "", *took, lacks, notes)


def _run_command(
    method: Descriptor,
    words: Sequence[str],
    values: Mapping[str, Any],
    work: Path,
    log: Path,
    engine: str,
    seconds: float,
) -> Usage:
    """One command on this machine or in a container; _Failed when it cannot be started."""
    container = f"freeart21-{uuid.uuid4().hex[:12]}"

    def stop() -> None:
        if method.image is not None:
            subprocess.run([engine, "kill", container], check=False, capture_output=True, stdin=subprocess.DEVNULL)

    if method.image is None:
        filled = fill_words(words, known_values(**{key: _absolute(value) for key, value in values.items()}))
    else:
        filled = contain(method, words, values, engine, container)
    try:
        return run_measured(filled, work, log, max(seconds, 0.0), method.limits.memory_gb * 1e9, stop)
    except OSError as error:
        raise _Failed(
            "start", f"{filled[0]} cannot be started: {error.strerror or processes.one_line(error)}"
        ) from error


def contain(
    method: Descriptor, words: Sequence[str], values: Mapping[str, Any], engine: str, container: str
) -> list[str]:
    """The command line of a container without network that sees its inputs, which it cannot write, and {out} alone."""
    line = [engine, "run", "--rm", "--name", container, "--network", "none"]
    line += ["--memory", str(int(method.limits.memory_gb * 1e9)), "--user", f"{os.getuid()}:{os.getgid()}"]
    line += ["--gpus", "all"] if method.gpu else []
    inside: dict[str, Any] = {"python": "python3", "name": values["name"], "home": "/home/method"}
    for key in (*method.inputs, "out"):
        inside[key] = f"/freeart21/{key}"
        line += ["--mount", f"type=bind,source={_absolute(values[key])},target=/freeart21/{key}"
                 + ("" if key == "out" else ",readonly")]  # fmt: skip
    assert method.image is not None
    return [*line, method.image, *fill_words(words, inside)]


def _absolute(value: Any) -> Any:
    return value.absolute() if isinstance(value, Path) else value


def _prepare_inputs(method: Descriptor, sequence: Path, truth: Path, work: Path) -> dict[str, Path]:
    """The inputs that the descriptor names, in `work`, but the sequence folder itself."""
    values: dict[str, Path] = {}
    for key in method.inputs:
        kind, _, part = key.partition("_")
        if key == "sequence":
            values[key] = sequence
        elif key == "part_masks":
            values[key] = work / key
            checked.copy_folder(truth / "part_mask", work / key)
        elif kind == "mesh":
            values[key] = work / f"{key}.obj"
            mesh = read_truth(truth).articulation.part(part)
            atomic.write_bytes(values[key], _obj_text(mesh).encode())
        else:
            values[key] = work / key
            recording = read_sequence(sequence)
            label = 1 + PARTS.index(part) if part else None
            for i, (time, frame) in enumerate(zip(recording.times_s, recording.frames(), strict=True)):
                if label is not None:
                    mask = checked.read_labels(truth / "part_mask" / f"{i:05d}.png", truth) == label
                    frame = type(frame)(frame.rgb, frame.depth, mask)
                rgbd_folder.write_pictures(work / key, time, frame, True)
            rgbd_folder.write_intrinsics(work / key, recording.camera)
    return values


def _obj_text(mesh: Mesh) -> str:
    lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in mesh.vertices]
    return "\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in np.asarray(mesh.faces) + 1)]) + "\n"


def _collect(
    method: Descriptor, source: Path, benchmark: Benchmark, name: str, work: Path, out: Path, options: Options
) -> tuple[list[Piece], list[str]]:
    """Put what the method wrote at out/NAME as a result folder; what it lacks, and notes. _Failed with one line."""
    try:
        if not source.is_dir():
            raise FreeArtError(f"the method wrote no folder {method.result}")
        if method.layout == NATIVE:
            _copy_result(source, out / name, len(read_sequence(benchmark.sequence(name))))
            return [], []
        imported = work / "imported"
        report = import_results(method.layout, source, benchmark.folder, imported, options, sequence=name)
        if (out / name).exists():
            shutil.rmtree(out / name)
        shutil.move(imported / name, out / name)
        return [piece for piece in PIECES if piece in report.lacks], list(report.notes.get(name, ()))
    except FreeArtError as error:
        text = str(error).replace(str(work), "").replace("\n", "; ")
        raise _Failed("output", text) from error


def _copy_result(source: Path, target: Path, frames: int) -> None:
    """Copy the files of a result folder, no others. Raises FreeArtError when it cannot be read or leads elsewhere."""
    for fault in find_link_faults(source):
        raise FreeArtError(str(fault))
    answer = read_result(source, appearance=False)
    if not isinstance(answer, Failure) and len(answer) != frames:
        raise FreeArtError(f"the answer has {len(answer)} states, the video {frames} frames")
    with atomic.new_folder(target, RESULT) as aside:
        for path in source.rglob("*"):
            relative = path.relative_to(source).as_posix()
            if path.is_file() and any(fnmatchcase(relative, pattern) for pattern in RESULT_FILES):
                (aside / relative).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(checked.require_file(path, checked.MAX_ARRAY_BYTES, source), aside / relative)


def _read_options(method: Descriptor, home: Path | None) -> Options:
    """The import's options of a descriptor. Raises FreeArtError."""
    given = dict(method.options)
    poses = given.pop("object_poses", None)
    options = read_record(Options, given, f"{method.name}: options")
    if poses is None:
        return options
    return replace(options, object_poses=Path(fill_words([str(poses)], {"home": home})[0]))


def _read_version(method: Descriptor, words: Sequence[str], home: Path | None) -> str:
    """The first line that a command of `versions` writes, or why there is none.

    Raises FreeArtError when one of {python} fails: this Python lacks what the method needs.
    """
    filled = fill_words(words, known_values(home=home, name="", out="", **dict.fromkeys(PRIVILEGED, "")))
    try:
        done = subprocess.run(filled, capture_output=True, text=True, timeout=60, stdin=subprocess.DEVNULL, check=False)
    except (OSError, subprocess.SubprocessError, UnicodeDecodeError) as error:
        return f"unknown: {processes.one_line(error)}"
    if done.returncode and words[0] == "{python}":
        last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
        raise FreeArtError(f"{method.name} cannot run in this Python: {checked.shorten(last)}")
    lines = (done.stdout.strip() or done.stderr.strip()).splitlines()
    return lines[0][:200] if lines else f"exit code {done.returncode}"


def _last_line(log: Path) -> str:
    """The last line of a log, for a message."""
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - 2000))
        lines = file.read().decode(errors="replace").strip().splitlines()
    return f": {checked.shorten(lines[-1])}" if lines else ""


def _write_run(out: Path, method: Descriptor, digest: str, versions: list[str], entries: Mapping[str, Entry]) -> None:
    """Write method.json and run.json."""
    privileged = [key for key in method.inputs if key in PRIVILEGED]
    answers = [set(entry.lacks) for entry in entries.values() if entry.outcome == "answer"]
    hardware = f"{platform.machine()}, {os.cpu_count()} cores"
    settings: dict[str, Any] = {"layout": method.layout, "limits": asdict(method.limits), "versions": versions}
    settings |= {"privileged_inputs": privileged} if privileged else {}
    settings |= {"image": method.image} if method.image else {}
    write_method(out, Method(method.name, method.code, settings, hardware, common_lacks(answers)))
    atomic.write_json(
        out / "run.json",
        {
            "schema": RUN_SCHEMA,
            "descriptor_sha256": digest,
            "descriptor": asdict(method) | {"schema": SCHEMA},
            "versions": versions,
            "hardware": hardware,
            "sequences": {name: asdict(entry) for name, entry in entries.items()},
        },
    )
