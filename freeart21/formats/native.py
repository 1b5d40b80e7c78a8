"""Our own layout: a sequence folder, with its truth in truth/ of the same data folder."""

from __future__ import annotations

from pathlib import Path

from freeart21.files import checked
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.formats.freeart21_official import known_of_truth
from freeart21.formats.third_party import (
    ReadOptions,
    RecordingLayout,
    ThirdPartyRecording,
    find_object_folder,
)


def _read(folder: Path, options: ReadOptions) -> ThirdPartyRecording:
    recording, name = read_sequence(folder), folder.resolve().name
    truth_folder = _truth_folder(folder)
    if not truth_folder.is_dir():
        return ThirdPartyRecording(name, name, recording, None, f"there is no {truth_folder}")
    truth = read_truth(truth_folder)
    object_id = str(truth.source.get("object") or name)
    own = find_object_folder(_object_folder(folder), object_id, options.partnet_root)
    return ThirdPartyRecording(name, object_id, recording, known_of_truth(truth, own))


def _truth_folder(sequence: Path) -> Path:
    return sequence.resolve().parent.parent / "truth" / sequence.resolve().name


def _object_folder(sequence: Path) -> Path:
    return _truth_folder(sequence) / "object"


LAYOUT = RecordingLayout(
    "native",
    0,
    "sequence.json",
    lambda folder: checked.is_there(folder / "sequence.json"),
    _read,
    ("sequences/*", "*"),
    object_folder=_object_folder,
)
