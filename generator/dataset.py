"""Records a data set: plans its sequences, holds a lock, runs workers, and continues after an interruption.

While it is recorded, a data folder holds `.recording/`: a lock, job.json (the plan) and a work folder a sequence.
What is finished is renamed into place, its truth first. At the end benchmark.json is written and `.recording/` removed.
After an interruption the same command records the sequences that are not in place, and gives the same bytes.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import catalog
from freeart21 import jobs as jobs_anywhere
from freeart21.doctor import require_rendering
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import JOB_SCHEMA, WORK, is_unfinished, read_benchmark, write_benchmark
from freeart21.files.data_card import write_card_of
from freeart21.files.lock import hold_lock
from freeart21.files.places import check_append
from freeart21.progress import Board, progress_board
from generator import partnet
from generator.object_source import ACCESS, find_object
from generator.session import record_object
from generator.settings import RecordSettings

__all__ = ["WORK", "Job", "Label", "is_unfinished", "official_names", "plan_jobs", "procedural_jobs", "record_jobs"]

MAX_OBJECTS = 1000
"""Procedural objects of one call: their names end in three digits."""
MAX_WORKERS = 64
MOST_SECONDS_A_PICTURE = 2.5
"""Ten times the approximate time for a picture: for the limit of a job."""
_JOBS = ".jobs"
"""Folder in the work folder for the state of jobs; no sequence has this name."""
_OBJECT_FILES = 107
"""Files of a sequence besides its pictures, those of the object included: the mean of freeart21-v1."""
_BYTES_OF_LINE = 102
"""Length of a line of benchmark.json (a picture's path and hash) without the sequence's name."""
_PATHS = ("camera", "effects", "partnet_root", "root", "track", "urdf")
"""Settings that are paths."""
_PATIENCE_S = 3.0
"""Longest wait for the lock: the workers of a killed recorder need a moment to end."""


@dataclass(frozen=True)
class Job:
    """One sequence to be recorded."""

    name: str
    """Object of the catalog, or PartNet-Mobility id."""
    sequence: str
    """Name of the sequence's folders."""
    settings: RecordSettings
    notes: tuple[str, ...] = ()
    """Remarks on the object for the user, one line each."""

    def to_json(self) -> dict[str, Any]:
        """All that decides the bytes of the sequence, as JSON."""
        return {"object": self.name, "sequence": self.sequence, **self.settings.to_json()}


@dataclass(frozen=True)
class Label:
    """Name, version and split of the data set, as in benchmark.json."""

    name: str
    version: str = "1"
    split: str = "public"


# --- which sequences --------------------------------------------------------------------------------------------------


def plan_jobs(names: Sequence[str], settings: RecordSettings) -> list[Job]:
    """One job for each of `names`: objects of the catalog, paths of URDFs or, given settings.partnet_root,
    PartNet-Mobility ids.

    Sequences get names such as 'stapler-s0' or '41083-joint_2-s0'; the name contains the joint unless it is the scored
    joint of a procedural object. Raises FreeArtError when a name is unknown or the object's files are unfit.
    """
    settings.check()
    jobs = []
    for each in dict.fromkeys(names):
        source = find_object(each, settings)
        entry, joint, notes = source.entry, source.joint, tuple[str, ...]()
        if entry.source != "procedural":
            with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
                loaded = source.load(Path(place))
            joint, notes = loaded.joint.name, loaded.notes
        own = entry.source == "procedural" and joint == entry.joint
        middle = "" if own else f"-{joint}"
        sequence = f"{entry.name}{middle}-s{settings.seed}"
        jobs.append(Job(entry.name, sequence, replace(settings, urdf=source.urdf), notes))
    return jobs


def official_names(root: Path, skip_missing: bool = False) -> tuple[str, ...]:
    """The ids of the official FreeArt-21, 21 objects, that are in `root`.

    Raises FreeArtError when one is absent without `skip_missing`, or all are.
    """
    if not root.is_dir():
        raise FreeArtError(f"{root} is not a folder; expected one that holds PartNet-Mobility objects ({ACCESS})")
    official = [entry.name for entry in catalog.CATALOG if entry.benchmark == "FreeArt-21"]
    places = {name: partnet.find_folder(name, root) for name in official}
    absent = [name for name, place in places.items() if place is None or not (place / partnet.URDF_NAME).is_file()]
    here = tuple(name for name in official if name not in absent)
    if absent and not (skip_missing and here):
        raise FreeArtError(
            f"{len(absent)} of FreeArt-21's {len(official)} PartNet-Mobility objects are not in {root}: "
            f"{', '.join(absent)}; ask for access to the dataset at {ACCESS} (an account is free)"
            + (", or record those that are there with --skip-missing" if here else "")
        )
    return here


def procedural_jobs(category: str, count: int, seed: int, settings: RecordSettings) -> list[Job]:
    """Jobs for `count` procedural objects of a category; the k-th object is drawn from the random stream (seed, k).

    Sequences get names such as 'stapler-s7-000'. Raises FreeArtError when there is no such category.
    """
    designs: dict[str, list[str]] = {}
    for entry in catalog.CATALOG:
        if entry.source == "procedural":
            designs.setdefault(entry.category, []).append(entry.name)
    wanted = next((known for known in designs if known.lower() == category.lower()), None)
    if wanted is None:
        raise FreeArtError(f"unknown category '{category}'; procedural categories: {', '.join(designs)}")
    if not 1 <= count <= MAX_OBJECTS:
        raise FreeArtError(
            f"cannot record {count} objects of category {wanted}; expected 1 to {MAX_OBJECTS}: their names end in "
            "three digits"
        )
    settings.check()
    jobs = []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        name = designs[wanted][int(rng.integers(len(designs[wanted])))]
        own_seed = int(rng.integers(2**31))
        jobs.append(Job(name, f"{wanted.lower()}-s{seed}-{k:03d}", replace(settings, seed=own_seed)))
    return jobs


# --- recording --------------------------------------------------------------------------------------------------------


def record_jobs(
    out: Path,
    jobs: Sequence[Job],
    workers: int = 1,
    label: Label | None = None,
    on_done: Callable[[str], None] = lambda sequence: None,
    executor: str = "local",
) -> list[str]:
    """Record `jobs` into the data folder `out`; returns the names of the sequences that were recorded now.

    Existing sequences of the same settings are kept, and so are other sequences of a finished data folder;
    benchmark.json is updated. The bytes depend neither on `workers` and `executor` nor on interruptions.

    Args:
        out: the data folder.
        jobs: what to record.
        workers: processes at a time.
        label: of benchmark.json; None keeps the existing one, or takes the folder's name.
        on_done: called with the name of every sequence that is in place.
        executor: one of `freeart21.jobs.EXECUTORS`; the machines of another one than 'local' all see `out`.

    Raises FreeArtError, in one line, when a job is unfit, a sequence exists with other settings, another process writes
    to `out`, or the disk refuses. Finished sequences are kept then, as after KeyboardInterrupt, and the same call
    records the others.
    """
    out = Path(out)
    check_append(out)
    _check(jobs, workers if executor == "local" else 1)
    if executor not in jobs_anywhere.EXECUTORS:
        known = ", ".join(jobs_anywhere.EXECUTORS)
        raise FreeArtError(f"unknown executor '{executor}'; executors: {known}")
    require_rendering()
    if not jobs or (not (out / WORK).is_dir() and not _unfinished_jobs(out, jobs)):
        return []
    _check_list(out, jobs)
    label = label or _read_label(out)
    with _writer_lock(out):
        try:
            for folder in (out, out / WORK):  # what a killed recorder left
                for left in folder.glob(f".*{atomic.PART_SUFFIX}"):
                    left.unlink(missing_ok=True)
            plan = {"schema": JOB_SCHEMA, "label": vars(label), "jobs": [job.to_json() for job in jobs]}
            atomic.write_json(out / WORK / "job.json", plan)
            todo = _unfinished_jobs(out, jobs)
            try:
                _run(out, todo, workers, on_done, executor)
            except atomic.CannotWrite:
                raise
            except Exception:  # finished sequences stay, and the folder is left in order
                _finish(out, label)
                raise
            _finish(out, label)
        except atomic.CannotWrite as error:
            hint = f"; finished work is kept in {out / WORK}" if is_unfinished(out) else ""
            raise atomic.CannotWrite(f"{error}{hint}: make room and run the same command again") from error
    return [job.sequence for job in todo]


def _check(jobs: Sequence[Job], workers: int) -> None:
    if not 1 <= workers <= MAX_WORKERS:
        raise FreeArtError(
            f"cannot record with {workers} workers; expected 1 to {MAX_WORKERS}: each loads a simulator of its own"
        )
    seen: set[str] = set()
    for job in jobs:
        job.settings.check()
        if job.sequence in seen or Path(job.sequence).name != job.sequence or job.sequence.startswith("."):
            raise FreeArtError(f"'{job.sequence}' cannot be the name of a sequence here: names are unique, without '/'")
        seen.add(job.sequence)


def _check_list(out: Path, jobs: Sequence[Job]) -> None:
    """FreeArtError when benchmark.json, which lists every file with its hash, would exceed the size that is read.

    There are four pictures for a frame (one of them in the truth), two for a held-out view, and the object's files.
    """
    size = (out / "benchmark.json").stat().st_size if (out / "benchmark.json").is_file() else 0
    for job in jobs:
        if not (out / "sequences" / job.sequence).exists():
            files = 4 * job.settings.frames + 2 * job.settings.queries + _OBJECT_FILES
            size += files * (len(job.sequence) + _BYTES_OF_LINE)
    if size > checked.MAX_JSON_BYTES:
        raise FreeArtError(
            f"cannot record {len(jobs)} sequences into {out}: benchmark.json would list their files in about "
            f"{size >> 20} MiB, at most {checked.MAX_JSON_BYTES >> 20} are read; record some into folders of their own"
        )


def _read_label(out: Path) -> Label:
    if is_unfinished(out):
        label = checked.read_json(out / WORK / "job.json", JOB_SCHEMA).get("label")
        if isinstance(label, dict):
            return Label(**{key: str(label.get(key)) for key in ("name", "version", "split")})
    if (out / "benchmark.json").is_file():
        known = read_benchmark(out)
        return Label(known.name, known.version, known.split)
    return Label(out.resolve().name)


def _unfinished_jobs(out: Path, jobs: Sequence[Job]) -> list[Job]:
    """The jobs whose sequence is not in place; FreeArtError when it, or its truth, is there with other settings."""
    todo = []
    for job in jobs:
        sequence, truth = (out / sub / job.sequence for sub in ("sequences", "truth"))
        there = next((place for place in (sequence, truth) if place.exists()), None)
        if there and (different := _difference(job, truth / "truth.json")):
            raise FreeArtError(
                f"{there} exists{different}; choose another place or seed, or remove the sequence and its truth first"
            )
        if not sequence.exists() and (not truth.exists() or (out / WORK / job.sequence).is_dir()):
            todo.append(job)
    return todo


def _difference(job: Job, header: Path) -> str:
    """The first difference between the truth of an existing sequence and `job`, in words; '' for none."""
    try:
        source = checked.read_json(header).get("source") or {}
    except FreeArtError:
        return " and has no truth"
    was = {"object": source.get("object"), "sequence": job.sequence, **(source.get("settings") or {})}
    now = checked.parse_json(atomic.json_text(job.to_json()), "the plan")
    key = next((key for key in {**now, **was} if was.get(key) != now.get(key)), None)
    return "" if key is None else f" with {key} {was.get(key)}, not {now.get(key)}"


def _finish(out: Path, label: Label) -> None:
    """Write benchmark.json with the hash of every file, and remove the work folders of unfinished sequences."""
    work = out / WORK
    if any((out / "sequences").glob("*/sequence.json")):
        write_benchmark(out, label.name, label.version, label.split)
        write_card_of(out)
    with contextlib.suppress(OSError):  # job.json first: without it the other files mean nothing
        (work / "job.json").unlink(missing_ok=True)
    for left in work.iterdir():
        if left.is_dir():
            shutil.rmtree(left, ignore_errors=True)


def _writer_lock(out: Path) -> contextlib.AbstractContextManager[None]:
    """Hold the lock of the data folder `out`; this recorder's jobs share it (`record_one`), a moment longer perhaps."""
    lock, folders = out / WORK / "lock", (out / WORK, out / "sequences", out / "truth")
    return hold_lock(
        lock, f"another process is recording into {out}", _PATIENCE_S, folders, keep=lambda: is_unfinished(out)
    )


# --- workers ----------------------------------------------------------------------------------------------------------


def _run(out: Path, jobs: list[Job], workers: int, on_done: Callable[[str], None], executor: str) -> None:
    """Record one sequence after the other in this process, or each as a job of `executor`."""
    pictures = sum(job.settings.frames + job.settings.queries for job in jobs)
    with progress_board(len(jobs), pictures) as board:
        if executor == "local" and (workers == 1 or len(jobs) < 2):
            for job in jobs:
                _record_sequence(out, job, partial(board.update, job.sequence))
                board.finished(job.sequence)
                on_done(job.sequence)
        else:
            workers = min(workers, len(jobs))
            with _renderer_threads(workers) if executor == "local" else contextlib.nullcontext():
                _run_as_jobs(out, jobs, workers, executor, board, on_done)


def _record_sequence(out: Path, job: Job, progress: Callable[[int, int], None]) -> None:
    """Record one sequence and move it into place, the truth first. A killed call may be repeated: it begins anew unless
    the truth is in place."""
    work = out / WORK / job.sequence
    places = {sub: out / folder / job.sequence for sub, folder in (("truth", "truth"), ("sequence", "sequences"))}
    try:
        if not places["truth"].exists():
            shutil.rmtree(work, ignore_errors=True)
            work.mkdir(parents=True)
            record_object(job.name, job.settings, work, progress)
            os.sync()
        for sub, place in places.items():
            if (work / sub).exists():
                place.parent.mkdir(exist_ok=True)
                (work / sub).replace(place)
    except atomic.CannotWrite:
        raise
    except OSError as error:
        raise atomic.cannot_write(work, error) from error
    except FreeArtError as error:
        raise FreeArtError(f"{job.sequence}: {error}") from error
    shutil.rmtree(work, ignore_errors=True)


def _run_as_jobs(
    out: Path, jobs: list[Job], workers: int, executor: str, board: Board, on_done: Callable[[str], None]
) -> None:
    """Record each sequence as a job of `executor`. A job whose machine failed begins anew."""
    place, by_name = out.resolve(), {f"record/{job.sequence}": job for job in jobs}
    job_list = [
        jobs_anywhere.Job(
            name,
            call="generator.dataset:record_one",
            arguments={
                "out": str(place),
                "name": job.name,
                "sequence": job.sequence,
                "settings": {
                    key: str(value.resolve()) if isinstance(value, Path) else value
                    for key, value in asdict(job.settings).items()
                },
            },
            processors=2,
            memory_gb=8.0,
            limit_s=max(3600.0, MOST_SECONDS_A_PICTURE * (job.settings.frames + job.settings.queries)),
        )
        for name, job in by_name.items()
    ]

    def finished(done: jobs_anywhere.Job) -> None:
        job = by_name[done.name]
        board.update(job.sequence, *[job.settings.frames + job.settings.queries] * 2)
        board.finished(job.sequence)
        on_done(job.sequence)

    failed = jobs_anywhere.run_jobs(place / WORK / _JOBS, job_list, workers, executor, on_done=finished)
    for reason in failed.values():
        raise (atomic.CannotWrite if reason.startswith("cannot write") else FreeArtError)(reason)


def record_one(out: str, name: str, sequence: str, settings: dict[str, Any]) -> None:
    """Record one sequence into the data folder `out` as a job of an executor; the recorder waits for it.

    It shares the recorder's lock while it works, so that no other recorder writes to the folder.
    """
    paths = {key: None if settings[key] is None else Path(settings[key]) for key in _PATHS}
    handle = os.open(Path(out) / WORK / "lock", os.O_RDWR)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH)
        _record_sequence(
            Path(out), Job(name, sequence, RecordSettings(**{**settings, **paths})), lambda done, total: None
        )
    finally:
        os.close(handle)


@contextlib.contextmanager
def _renderer_threads(workers: int) -> Iterator[None]:
    """Divide the cores among the workers: by default Mesa's software renderer takes all of them in each process."""
    name = "LP_NUM_THREADS"
    given = os.environ.get(name)
    if given is None:
        os.environ[name] = str(max(1, (os.cpu_count() or 1) // workers))
    try:
        yield
    finally:
        if given is None:
            del os.environ[name]
