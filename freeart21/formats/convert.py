"""Converts recordings between layouts. Each sequence is written whole or not at all."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import is_unfinished, read_benchmark, unfinished_error, write_benchmark
from freeart21.files.data_card import write_card_of
from freeart21.files.places import check_append, require_replaceable
from freeart21.files.sequence import write_frame, write_header, write_queries
from freeart21.files.truth import write_truth
from freeart21.formats import freeart21_official, rgbd_folder
from freeart21.formats.third_party import (
    DEFAULTS,
    Progress,
    ReadOptions,
    RecordingLayout,
    ThirdPartyRecording,
    find_object_folder,
)
from freeart21.recording import Recording
from freeart21.registry import find_instances
from freeart21.truth import Truth

Target = Literal["official", "native", "rgbd"]
TruthMaker = Callable[[ThirdPartyRecording, Path], Truth]
"""Makes the truth of a third-party recording from a folder of PartNet-Mobility objects; FreeArtError when it cannot."""

PICTURES = "pictures"
"""Subfolder of plain folders of pictures."""

_RIM = 0.9  # a mask that covers this share of the picture's border is inverted
_FARTHER = 10.0  # depth beyond this multiple of the object's farthest point can be lost to a finer depth scale


@dataclass(frozen=True)
class Converted:
    """One sequence that was written."""

    name: str
    """Name of the source."""
    folder: Path
    """The sequence or example folder."""
    with_truth: bool
    notes: tuple[str, ...]
    """Notes for the user, one line each."""


@functools.cache
def recording_layouts() -> dict[str, RecordingLayout]:
    """By name, in the order in which they are tried: the modules of this folder, and entry points of others
    (`freeart21.registry`)."""
    found = find_instances("freeart21.formats", RecordingLayout)
    return dict(sorted(found.items(), key=lambda item: (item[1].rank, item[0])))


def find_sources(source: Path, layout: str | None = None) -> list[tuple[RecordingLayout, Path]]:
    """The recordings in `source` (itself, or in it), all of one layout: `layout`, or the first that fits."""
    source, known = Path(source), recording_layouts()
    if layout is not None and layout not in known:
        raise FreeArtError(f"unknown layout '{layout}'; layouts: {', '.join(known)}")
    if not source.exists():
        raise FreeArtError(f"{source} is missing")
    for kind in known.values() if layout is None else (known[layout],):
        found = kind.find(source)
        if found:
            return [(kind, folder) for folder in found]
    if layout is not None:
        raise FreeArtError(f"{source} holds no recording of the layout {layout}: {known[layout].files}")
    raise FreeArtError(
        f"{source} holds no recording of a known layout: {', '.join(known)}; `--from LAYOUT` says which files it needs"
    )


def convert(
    source: Path,
    out: Path,
    to: Target,
    layout: str | None = None,
    truth_of: TruthMaker | None = None,
    options: ReadOptions = DEFAULTS,
    hold_out: bool = False,
    progress: Callable[[str, int, int], None] = lambda name, done, total: None,
) -> Iterator[Converted]:
    """Convert every recording in `source`, in sequence.

    to="native" writes out/sequences/SEQ and, when `truth_of` can make it, out/truth/SEQ. Objects are searched in
    `options.partnet_root` or, for an official example, in data/partnet-mobility-v0/dataset next to examples/.
    out/benchmark.json is updated when every sequence has its truth.

    to="official" writes out/examples/NAME and, with the object's files (of the truth, or options.partnet_root/ID),
    out/data/partnet-mobility-v0/dataset/NAME. `hold_out` makes the official split of 5 %.

    to="rgbd" writes out/pictures/NAME, upright and undistorted, depth in millimetres, to segment the object in.

    `progress` is called with a sequence's name, the frames done, their total.
    Raises FreeArtError; recordings converted before remain.
    """
    out = Path(out)
    check_append(out, (source,))
    label = _label(out) if to == "native" else None
    for kind, folder in find_sources(source, layout):
        checked.require_inside(Path(source), folder)
        if kind.name == to:
            raise FreeArtError(f"{folder} is of the layout {to} already")
        recording = kind.read(folder, options)
        tick = functools.partial(progress, recording.name)
        with _remove_empty_folders(out):
            if to == "rgbd":
                yield _write_pictures(out, recording, tick)
                continue
            if not recording.has_masks:
                raise FreeArtError(
                    f"{folder} has no masks: `--to rgbd` writes its pictures; segment the object without the hands in "
                    "them, one mask a picture, and name their folder by --masks"
                )
            if to == "native":
                yield _write_native(out, recording, truth_of, options.partnet_root or kind.objects(folder), tick)
                continue
            files = find_object_folder(kind.object_folder(folder), recording.object_id, options.partnet_root)
            yield _write_official(out, recording, files, hold_out, tick)
    if label is not None and _all_have_truth(out):
        write_benchmark(out, *label)
        write_card_of(out)


def _label(out: Path) -> tuple[str, str, str]:
    """Name, version and split of the data folder: from its benchmark.json, else defaults."""
    if is_unfinished(out):
        raise unfinished_error(out)
    if not (out / "benchmark.json").exists():
        return out.resolve().name, "1", "public"
    known = read_benchmark(out)
    return known.name, known.version, known.split


def _write_native(
    out: Path, read: ThirdPartyRecording, truth_of: TruthMaker | None, root: Path | None, tick: Progress
) -> Converted:
    sequence, truth_folder = (out / sub / read.name for sub in ("sequences", "truth"))
    for folder in (sequence, truth_folder):
        require_replaceable(folder, None)
    n, recording = len(read.recording), read.recording
    scale = _depth_scale(recording, lambda done: tick(done, 2 * n))
    truth, lacks = _truth(read, truth_of, root)
    with atomic.new_folder(sequence) as aside:
        for i, frame in enumerate(recording.frames()):
            write_frame(aside, i, frame, scale)
            tick(n + i + 1, 2 * n)
        write_queries(aside, ())  # held-out views need pictures, which third-party layouts do not have
        write_header(aside, recording.camera, scale, recording.times_s, recording.licence, recording.gravity)
        if truth is not None:
            write_truth(truth_folder, truth, 0)
    notes = (*read.notes, *((f"without truth: {lacks}",) if lacks else ()))
    return Converted(read.name, sequence, truth is not None, notes)


def _write_pictures(out: Path, read: ThirdPartyRecording, tick: Progress) -> Converted:
    folder, recording = out / PICTURES / read.name, read.recording
    with atomic.new_folder(folder) as aside:
        for i, (time, frame) in enumerate(zip(recording.times_s, recording.frames(), strict=True)):
            rgbd_folder.write_pictures(aside, time, frame, read.has_masks)
            tick(i + 1, len(recording))
        rgbd_folder.write_intrinsics(aside, recording.camera)
    return Converted(read.name, folder, False, read.notes)


def _truth(read: ThirdPartyRecording, truth_of: TruthMaker | None, root: Path | None) -> tuple[Truth | None, str]:
    if read.known is None:
        return None, read.lacks
    if truth_of is None or root is None:
        return None, f"it needs the object's meshes: --partnet-root, a folder with {read.object_id}"
    try:
        return truth_of(read, root), ""
    except FreeArtError as error:
        return None, str(error)


def _depth_scale(recording: Recording, tick: Callable[[int], None]) -> float:
    """Metres per unit: 1, 2 or 5 times a power of ten, the finest that holds the scene in 16 bits.

    Depth beyond _FARTHER times the object's farthest point can be lost. Raises FreeArtError when there is no depth, or
    when most masks are empty or cover the picture's border, as inverted ones do.
    """
    farthest = on_object = 0.0
    empty = around = 0
    for i, frame in enumerate(recording.frames()):
        farthest = max(farthest, float(frame.depth.max(initial=0)))
        on_object = max(on_object, float(frame.depth[frame.mask].max(initial=0)))
        rim = np.concatenate([frame.mask[[0, -1]].ravel(), frame.mask[:, [0, -1]].ravel()])
        empty, around = empty + (not frame.mask.any()), around + bool(rim.mean() > _RIM)
        tick(i + 1)
    for count, what in ((empty, "is empty"), (around, "covers the picture's rim")):
        if 2 * count > len(recording):
            raise FreeArtError(
                f"{recording.name}: the object's mask {what} in {count} of {len(recording)} frames, expected white (or "
                "a label) where the object is, on black"
            )
    if farthest <= 0:
        raise FreeArtError(f"{recording.name} has no depth in any frame")
    least = min(farthest, _FARTHER * on_object if on_object > 0 else farthest) / 65000
    power = 10.0 ** np.floor(np.log10(least))
    return float(f"{next(power * k for k in (1, 2, 5, 10) if power * k >= least * (1 - 1e-12)):.1g}")


def _write_official(
    out: Path, read: ThirdPartyRecording, object_folder: Path | None, hold_out: bool, tick: Progress
) -> Converted:
    folder = freeart21_official.write_example(out, read.name, read.recording, read.known, object_folder, hold_out, tick)
    notes = [*read.notes]
    if read.known is None:
        notes.append(f"pictures only: {read.lacks}")
    elif object_folder is None:
        notes.append(
            f"without the object's files, which their evaluator needs: {read.object_id} was not found (--partnet-root)"
        )
    return Converted(read.name, folder, read.known is not None, tuple(notes))


def _all_have_truth(out: Path) -> bool:
    sequences = [path.parent.name for path in (out / "sequences").glob("*/sequence.json")]
    return bool(sequences) and all((out / "truth" / name / "truth.json").is_file() for name in sequences)


@contextlib.contextmanager
def _remove_empty_folders(out: Path) -> Iterator[None]:
    """When the block fails, remove empty folders that it made."""
    new = not out.exists()
    try:
        yield
    except BaseException:
        objects = freeart21_official.OBJECTS
        made = [Path("sequences"), Path(PICTURES), Path("truth"), Path("examples"), objects, *objects.parents]
        for place in made if new else made[:-1]:
            with contextlib.suppress(OSError):
                (out / place).rmdir()
        raise
