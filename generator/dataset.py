"""A whole data set: which sequences, one writer at a time, several workers, and going on after an interruption.

A data folder under construction holds `.recording/`: a lock, job.json (what is being made, in full), and a work folder
a sequence. A finished sequence is renamed into place, truth first; at the end benchmark.json is written and
`.recording/` goes. Whatever was killed, the same command goes on from there, to the same bytes.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib import metadata
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from freeart21 import catalog, child, stopping
from freeart21 import jobs as jobs_anywhere
from freeart21.doctor import require_rendering
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import JOB_SCHEMA, WORK, is_unfinished, read_benchmark, write_benchmark
from freeart21.files.lock import release, take
from freeart21.files.places import check_growing
from freeart21.files.urdf import MAX_URDF_BYTES
from generator import partnet, urdf_folder
from generator.progress import Board, progress_board
from generator.session import ACCESS, RecordSettings, catalog_entry, find_partnet_folder, load_object, record_object

__all__ = ["WORK", "Job", "Label", "is_unfinished", "official_names", "plan_jobs", "procedural_jobs", "record_jobs"]

MAX_OBJECTS = 1000
"""Of a category, drawn at once: three digits."""
MAX_WORKERS = 64
_MADE_WITH = ("freeart21", "sapien", "numpy", "opencv-python-headless", "embreex", "manifold3d", "scipy")
SECONDS_A_PICTURE = 0.25
"""What a picture takes, about: for the time limits of clusters."""
_JOBS = ".jobs-elsewhere"
"""Folder in the work folder where jobs on other machines say how far they are; no sequence is called so."""
_OBJECT_FILES = 107
"""Files of an object, and of a sequence but for its pictures: the mean of freeart21-v1."""
_BYTES_OF_LINE = 102
"""Of a line of benchmark.json, without the sequence's name: the picture's path and its hash."""
_PATHS = ("camera", "effects", "partnet_root", "root", "track", "urdf")
"""Settings that are paths."""
_PATIENCE_S = 3.0
"""How long the lock is waited for: the workers of a killed recorder need a moment to notice."""


@dataclass(frozen=True)
class Job:
    """One sequence to be recorded."""

    name: str
    """Object of the catalog, or PartNet-Mobility id."""
    sequence: str
    """Name of the sequence's folders."""
    settings: RecordSettings
    notes: tuple[str, ...] = ()
    """What a user should know of the object, a line each."""

    def to_json(self) -> dict[str, Any]:
        """All that decides the sequence's bytes, as JSON."""
        return {"object": self.name, "sequence": self.sequence, **self.settings.to_json()}


@dataclass(frozen=True)
class Label:
    """What benchmark.json says of the whole."""

    name: str
    version: str = "1"
    split: str = "public"


# --- which sequences --------------------------------------------------------------------------------------------------


def plan_jobs(names: Sequence[str], settings: RecordSettings) -> list[Job]:
    """A job for each of `names`: objects of the catalog, paths of URDFs or, given settings.partnet_root,
    PartNet-Mobility ids.

    Sequences are called such as 'stapler-s0' or '41083-joint_2-s0': the joint is named unless it is a procedural
    object's own. Raises FreeArtError when a name is unknown, or an object of others is unfit.
    """
    settings.check()
    given, jobs = settings, []
    for name in dict.fromkeys(names):
        settings = given
        if name.lower().endswith(urdf_folder.URDF_ENDINGS):
            settings = replace(given, urdf=checked.require_file(Path(name), MAX_URDF_BYTES, checked.ANYWHERE))
            name = urdf_folder.object_name(Path(name))
        entry = catalog_entry(name, settings)
        joint, notes = settings.joint or entry.joint, tuple[str, ...]()
        if entry.source == "partnet":
            folder = find_partnet_folder(name, settings.partnet_root)
            loaded = partnet.load(folder, joint, settings.skip_missing)
            joint, notes = loaded.joint.name, loaded.notes
        elif entry.source == "urdf":
            with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
                loaded = load_object(entry, settings, Path(place))
            joint, notes = loaded.joint.name, loaded.notes
        own = entry.source == "procedural" and joint == entry.joint
        middle = "" if own else f"-{joint}"
        jobs.append(Job(name, f"{name}{middle}-s{settings.seed}", settings, notes))
    return jobs


def official_names(root: Path, skip_missing: bool = False) -> tuple[str, ...]:
    """The 21 ids of the official FreeArt-21, all of which must be in `root` unless those absent may be skipped."""
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
    """`count` fresh objects of a category: the design and all else of the k-th is drawn from (seed, k).

    Sequences are called such as 'stapler-s7-000'. Raises FreeArtError when there is no such category.
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


# --- the whole --------------------------------------------------------------------------------------------------------


def record_jobs(
    out: Path,
    jobs: Sequence[Job],
    workers: int = 1,
    label: Label | None = None,
    on_done: Callable[[str], None] = lambda sequence: None,
    executor: str = "local",
) -> list[str]:
    """Record `jobs` into the data folder `out`; returns the sequences made now: those already there are kept.

    Other sequences of a finished data folder stay as they are; benchmark.json is renewed. `label` None keeps what
    benchmark.json says, or takes the folder's name. `on_done` is called with every sequence that takes its place.
    The bytes do not depend on `workers` (processes), nor on how often the work was interrupted, nor on the `executor`
    (`freeart21.jobs.EXECUTORS`): by another one than 'local' every sequence is a job, on machines that all see `out`.

    Raises FreeArtError, in one line, when a job is unfit, a sequence exists from other settings, another process writes
    to `out`, an unfinished recording there was of something else, or the disk refuses (then what is done is kept, and
    the same call goes on). KeyboardInterrupt stops all workers and keeps what is done, too.
    """
    out = Path(out)
    check_growing(out)
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
            _remove_partial_files(out)
            _write_plan(out, jobs, label)
            todo = _unfinished_jobs(out, jobs)
            try:
                _run(out, todo, workers, on_done, executor)
            except atomic.CannotWrite:
                raise
            except Exception:  # of whatever kind: what is done stays, and the folder is as before
                _finish(out, label)
                raise
            _finish(out, label)
        except atomic.CannotWrite as error:
            kept = f"; what is done is kept in {out / WORK}" if is_unfinished(out) else ""
            raise atomic.CannotWrite(f"{error}{kept}: make room and run the same command again") from error
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
    """FreeArtError when benchmark.json, which lists every file with its hash, would be larger than is read."""
    there = (out / "benchmark.json").stat().st_size if (out / "benchmark.json").is_file() else 0
    sizes = [_listed_bytes(job) for job in jobs if not (out / "sequences" / job.sequence).exists()]
    if there + sum(sizes) > checked.MAX_JSON_BYTES:
        fit = max(0, int((checked.MAX_JSON_BYTES - there) / (sum(sizes) / len(sizes))))
        raise FreeArtError(
            f"cannot record {len(sizes)} sequences into {out}: benchmark.json would list their files in about "
            f"{(there + sum(sizes)) >> 20} MiB, at most {checked.MAX_JSON_BYTES >> 20} are read; record at most {fit} "
            "of them here, and the others into folders of their own"
        )


def _listed_bytes(job: Job) -> int:
    """Of benchmark.json, about, for one sequence: three pictures a frame and one of its truth, two a held-out view, and
    the object's own files."""
    files = 4 * job.settings.frames + 2 * job.settings.queries + _OBJECT_FILES
    return files * (len(job.sequence) + _BYTES_OF_LINE)


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
    """The jobs whose sequence is not in place; FreeArtError when one is there, but of other settings."""
    todo = []
    for job in jobs:
        sequence, truth = (out / sub / job.sequence for sub in ("sequences", "truth"))
        under_way = (out / WORK / job.sequence).is_dir()
        if not sequence.exists() and (not truth.exists() or under_way):
            todo.append(job)
            continue
        different = _difference(job, truth / "truth.json")
        if different:
            there = sequence if sequence.exists() else truth
            raise FreeArtError(
                f"{there} exists{different}; choose another place or seed, or remove the sequence and its truth first"
            )
    return todo


def _remove_partial_files(out: Path) -> None:
    """Remove the files that a recorder left aside when it was killed while it wrote one of the whole."""
    for folder in (out, out / WORK):
        for left in folder.glob(f".*{atomic.ASIDE}"):
            left.unlink(missing_ok=True)


def _difference(job: Job, header: Path) -> str:
    """What the truth of an existing sequence says otherwise than `job`; '' when it is the same."""
    try:
        source = checked.read_json(header).get("source") or {}
    except FreeArtError:
        return " and has no truth"
    was = {"object": source.get("object"), "sequence": job.sequence, **(source.get("settings") or {})}
    return _first_difference(was, _parsed_json(job.to_json()), " with {key} {was}, not {now}")


def _first_difference(was: dict[str, Any], now: dict[str, Any], pattern: str) -> str:
    key = next((key for key in {**now, **was} if was.get(key) != now.get(key)), None)
    return "" if key is None else pattern.format(key=key, was=was.get(key), now=now.get(key))


def _parsed_json(data: Any) -> Any:
    return checked.parse_json(atomic.json_text(data), "the plan")


def _write_plan(out: Path, jobs: Sequence[Job], label: Label) -> None:
    """Write down what is to be made; FreeArtError when something else was being made here."""
    made_with = {name: metadata.version(name) for name in _MADE_WITH}
    plan = {"schema": JOB_SCHEMA, "label": vars(label), "made_with": made_with, "jobs": [j.to_json() for j in jobs]}
    path = out / WORK / "job.json"
    if not path.is_file():
        for left in (out / WORK).iterdir():  # of a recording that was done, killed while it cleaned up
            if left.is_dir():
                shutil.rmtree(left)
        atomic.write_json(path, plan)
        return
    before, now = checked.read_json(path, JOB_SCHEMA), _parsed_json(plan)
    if before == now:
        return
    different = (
        _first_difference(before.get("label", {}), now["label"], "{key} {was}, not {now}")
        or _first_difference(before.get("made_with", {}), now["made_with"], "made with {key} {was}, not {now}")
        or _different_jobs(before.get("jobs", []), now["jobs"])
    )
    raise FreeArtError(
        f"{out} holds an unfinished recording of something else ({different}): finish it by its own command, "
        f"or give it up by removing {out / WORK}"
    )


def _different_jobs(before: list[dict[str, Any]], now: list[dict[str, Any]]) -> str:
    for was, wanted in zip(before, now, strict=False):
        different = _first_difference(was, wanted, "{key} {was}, not {now}")
        if different:
            return different
    return f"{len(before)} sequences, not {len(now)}"


def _finish(out: Path, label: Label) -> None:
    """List every file with its hash and clear away what is under way; a folder with no sequence vanishes."""
    work = out / WORK
    if any((out / "sequences").glob("*/sequence.json")):
        write_benchmark(out, label.name, label.version, label.split)
    with contextlib.suppress(OSError):  # job.json first: without it the rest counts for nothing
        (work / "job.json").unlink(missing_ok=True)
    for left in work.iterdir():
        if left.is_dir():
            shutil.rmtree(left, ignore_errors=True)


@contextlib.contextmanager
def _writer_lock(out: Path) -> Iterator[None]:
    """Be the only one who writes to `out`, together with this recorder's own workers (`_join_writers`)."""
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    lock = out / WORK / "lock"
    deadline = time.monotonic() + _PATIENCE_S
    while (handle := take(lock)) is None:
        if time.monotonic() > deadline:
            if not lock.is_file():
                raise FreeArtError(f"cannot write {lock}: its folder cannot be made")
            raise FreeArtError(f"another process is recording into {out}; wait for it, or choose another folder")
        time.sleep(0.05)
    try:
        yield
    finally:
        if is_unfinished(out):  # a worker that ends a moment later has it still
            os.close(handle)
        else:
            release(lock, handle, [lock.parent, out / "sequences", out / "truth", *made])


# --- one after the other, or side by side -----------------------------------------------------------------------------


def _run(out: Path, jobs: list[Job], workers: int, on_done: Callable[[str], None], executor: str) -> None:
    pictures = sum(job.settings.frames + job.settings.queries for job in jobs)
    with progress_board(len(jobs), pictures) as board:
        if executor != "local":
            _run_on_executor(out, jobs, workers, executor, board, on_done)
        elif workers == 1 or len(jobs) < 2:
            for job in jobs:
                _record_sequence(out, job, partial(board.update, job.sequence))
                board.finished(job.sequence)
                on_done(job.sequence)
        else:
            _run_workers(out, jobs, min(workers, len(jobs)), board, on_done)


def _record_sequence(out: Path, job: Job, progress: Callable[[int, int], None]) -> None:
    """Record one sequence and put it in its place, the truth first. A call that was killed anywhere may be repeated."""
    work = out / WORK / job.sequence
    places = {sub: out / folder / job.sequence for sub, folder in (("truth", "truth"), ("sequence", "sequences"))}
    try:
        if not places["truth"].exists():
            work.mkdir(parents=True, exist_ok=True)
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


_reports: Any = None
"""In a worker: where progress goes."""


def _start_worker(folder: Path, lock: Path, life: Connection, reports: Any) -> None:
    """Go to the recorder's folder, hold the lock as long as this worker lives, and end when the recorder ends.

    That shows by its side of `life`, which it may close before.
    """
    global _reports
    os.chdir(folder)

    def end_with_the_recorder() -> None:
        with contextlib.suppress(EOFError, OSError):
            life.recv()
        os._exit(1)

    threading.Thread(target=end_with_the_recorder, daemon=True).start()
    fcntl.flock(os.open(lock, os.O_RDWR), fcntl.LOCK_SH)  # closed by the process's end
    _reports = reports


def _record_in_worker(out: Path, job: Job) -> str:
    """In a worker: record one sequence, and tell of it a few times a second."""
    last = 0.0

    def progress(done: int, total: int) -> None:
        nonlocal last
        if done == total or time.monotonic() - last > 0.25:
            last = time.monotonic()
            _reports.put((job.sequence, done, total))

    _record_sequence(out, job, progress)
    return job.sequence


def _run_workers(out: Path, jobs: list[Job], workers: int, board: Board, on_done: Callable[[str], None]) -> None:
    """Workers are processes of their own, because the simulator holds Python's lock while it draws."""
    context = get_context("spawn")
    theirs, ours = context.Pipe(duplex=False)
    with _renderer_threads(workers), tempfile.TemporaryDirectory(prefix="freeart21-") as empty:
        with child.spawn_in(Path(empty)):
            reports = context.SimpleQueue()
        listener = threading.Thread(target=_forward_reports, args=(reports, board), daemon=True)
        listener.start()
        worker_setup = Path.cwd(), out / WORK / "lock", theirs, reports
        pool = ProcessPoolExecutor(workers, context, _start_worker, worker_setup)
        try:
            with stopping.unheard(), child.spawn_in(Path(empty)):  # from birth: the recorder says when to stop
                futures: list[Future[str]] = [pool.submit(_record_in_worker, out, job) for job in jobs]
            for future in as_completed(futures):
                board.finished(future.result())
                on_done(future.result())
        except BrokenProcessPool as error:
            raise atomic.CannotWrite("a worker of the recorder was killed, for want of memory perhaps") from error
        finally:
            ours.close()  # ends the workers
            pool.shutdown(wait=True, cancel_futures=True)
            reports.put(None)
            listener.join(1)


def _run_on_executor(
    out: Path, jobs: list[Job], workers: int, executor: str, board: Board, on_done: Callable[[str], None]
) -> None:
    """A job a sequence. What is done of a sequence that was lost with its machine is gone on from."""
    place, by_name = out.resolve(), {f"record/{job.sequence}": job for job in jobs}
    asked = [
        jobs_anywhere.Job(
            name,
            call="generator.dataset:record_one",
            arguments={
                "out": str(place),
                "name": job.name,
                "sequence": job.sequence,
                "settings": _settings_to_json(job.settings),
            },
            seconds=SECONDS_A_PICTURE * (job.settings.frames + job.settings.queries),
        )
        for name, job in by_name.items()
    ]

    def listener(event: str, asked: jobs_anywhere.Job, facts: dict[str, object]) -> None:
        if event == "finished":
            job = by_name[asked.name]
            board.update(job.sequence, *[job.settings.frames + job.settings.queries] * 2)
            board.finished(job.sequence)
            on_done(job.sequence)

    report = jobs_anywhere.run_jobs(place / WORK / _JOBS, asked, workers, executor, listener=listener)
    for failed in report.failed:
        full = failed.reason.startswith("cannot write")
        raise (atomic.CannotWrite if full else FreeArtError)(failed.reason)


def record_one(out: str, name: str, sequence: str, settings: dict[str, Any]) -> None:
    """What the job of a sequence does: record it into the data folder `out`, whose recorder waits for it.

    It holds the recorder's lock as long as it works, so that none comes after it to the same folder.
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


def _settings_to_json(settings: RecordSettings) -> dict[str, Any]:
    """All fields as JSON, paths from the root."""
    return {key: str(value.resolve()) if isinstance(value, Path) else value for key, value in asdict(settings).items()}


def _forward_reports(reports: Any, board: Board) -> None:
    while (report := reports.get()) is not None:
        board.update(*report)


@contextlib.contextmanager
def _renderer_threads(workers: int) -> Iterator[None]:
    """Share the cores among workers: Mesa's software renderer takes all for each, unless it is told."""
    name = "LP_NUM_THREADS"
    given = os.environ.get(name)
    if given is None:
        os.environ[name] = str(max(1, (os.cpu_count() or 1) // workers))
    try:
        yield
    finally:
        if given is None:
            del os.environ[name]
