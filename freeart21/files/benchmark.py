"""A data folder: sequences, truths, and benchmark.json with the hash of every file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.hashes import file_sha256
from freeart21.files.hidden import read_hidden

SCHEMA = "freeart21/benchmark/1"
WORK = ".recording"
"""Folder of unfinished work in a data folder that is being recorded."""
JOB_SCHEMA = "freeart21/recording-job/1"
"""Schema of job.json there, the full plan of a recording."""


@dataclass(frozen=True)
class Benchmark:
    """benchmark.json of a data folder."""

    folder: Path
    name: str
    version: str
    split: str
    sequences: tuple[str, ...]
    hidden: str = ""
    """Salted SHA-256 of a truth that was left out (`freeart21.files.hidden`); empty when the folder has its truth."""
    hidden_truth: Path | None = None
    """Folder of a truth that was left out, if given."""
    salt: str = ""
    """Salt of the hashes of a hidden truth."""

    def sequence(self, name: str) -> Path:
        """The sequence folder of `name`. Raises FreeArtError when a link leads out of the data folder."""
        return checked.require_inside(self.folder, self.folder / "sequences" / name)

    def truth(self, name: str) -> Path:
        """The truth folder of `name`. Raises FreeArtError when it is hidden and not given, or a link leads out of
        it."""
        if self.hidden and self.hidden_truth is None:
            raise FreeArtError(
                f"{self.folder} was packed without its truth, which only its makers have; got no --truth"
            )
        folder = self.hidden_truth or self.folder
        return checked.require_inside(folder, folder / "truth" / name)

    def select_sequences(self, names: Sequence[str] | None) -> tuple[str, ...]:
        """The sequences in `names`, in the benchmark's order; all when it is None. Raises FreeArtError for an unknown
        one."""
        if names is None:
            return self.sequences
        for name in names:
            if name not in self.sequences:
                known = ", ".join(self.sequences[:30]) + (", ..." if len(self.sequences) > 30 else "")
                raise FreeArtError(f"{self.folder} has no sequence '{name}'; it has {known}")
        return tuple(name for name in self.sequences if name in names)


def write_benchmark(folder: Path, name: str, version: str, split: str) -> Benchmark:
    """Write benchmark.json over all sequences that have both their video and their truth."""
    sequences = tuple(sorted(p.parent.name for p in (folder / "sequences").glob("*/sequence.json")))
    files = sorted(
        p for sub in ("sequences", "truth") for s in sequences for p in (folder / sub / s).rglob("*") if p.is_file()
    )
    atomic.write_json(
        folder / "benchmark.json",
        {
            "schema": SCHEMA,
            "name": name,
            "version": version,
            "split": split,
            "sequences": list(sequences),
            "sha256": {str(p.relative_to(folder)): file_sha256(p) for p in files},
        },
    )
    return Benchmark(folder, name, version, split, sequences)


def is_unfinished(folder: Path) -> bool:
    """Whether `folder` holds an interrupted or running recording."""
    return (folder / WORK / "job.json").is_file()


def unfinished_error(folder: Path) -> FreeArtError:
    """The error for an unfinished data folder: how many sequences are done, and how to go on."""
    try:
        jobs = checked.read_json(folder / WORK / "job.json", JOB_SCHEMA).get("jobs")
    except FreeArtError:
        jobs = None
    names = [str(job.get("sequence")) for job in jobs if isinstance(job, dict)] if isinstance(jobs, list) else []
    done = sum((folder / "sequences" / name / "sequence.json").is_file() for name in names)
    return FreeArtError(
        f"{folder} is an unfinished recording ({done} of {len(names)} sequences are done): the `freeart21 record` "
        f"command that began it goes on; to give it up remove {folder / WORK}"
    )


def read_benchmark(folder: Path, truth: Path | None = None) -> Benchmark:
    """The benchmark in `folder`; `truth` is the folder of a hidden truth.

    Raises FreeArtError when the folder is broken, or `truth` does not belong to it.
    """
    folder = Path(folder)
    path = folder / "benchmark.json"
    if not checked.is_there(path) and is_unfinished(folder):
        raise unfinished_error(folder)
    if not checked.is_there(path):
        raise FreeArtError(f"{folder} is not a benchmark: it has no benchmark.json")
    data = checked.read_json(path, SCHEMA)
    sequences = data.get("sequences")
    if not isinstance(sequences, list) or not all(isinstance(s, str) and Path(s).name == s for s in sequences):
        raise FreeArtError(f"{path}: 'sequences' is not a list of folder names")
    benchmark = Benchmark(
        folder,
        checked.text(data, "name", path),
        checked.text(data, "version", path),
        checked.text(data, "split", path),
        tuple(sequences),
        checked.text(data, "hidden", path) if "hidden" in data else "",
    )
    if truth is None:
        return benchmark
    if not benchmark.hidden:
        raise FreeArtError(f"{folder} holds its truth itself: {truth} is not needed")
    found = read_hidden(truth)
    if found.digest != benchmark.hidden:
        raise FreeArtError(
            f"{truth} is not the truth of {folder}: its digest is {found.digest[:12]}, expected {benchmark.hidden[:12]}"
        )
    return replace(benchmark, hidden_truth=Path(truth), salt=found.salt)
