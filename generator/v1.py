"""The benchmark freeart21-v1: its sequences, and frozen fingerprints of their shapes and motions.

The public split is for tuning, the test split is only scored. `freeart21_v1.json` holds a fingerprint of every
sequence's shape and motion. A change of one of them makes a new version of the benchmark: give it a new number and new
fingerprints (`python -m generator.v1 --write`), and note it in the changelog.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
import tyro

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.benchmark import read_benchmark
from freeart21.se3 import Array
from generator import objects
from generator.dataset import Job, Label
from generator.model import ObjectModel
from generator.object_source import find_object
from generator.session import plan_recording
from generator.settings import RecordSettings

NAME, VERSION = "freeart21-v1", "1"
Split = Literal["public", "test"]

SEEDS: dict[Split, int] = {"public": 1, "test": 42}
"""Seed of all sequences of a split: of shapes, motions and views."""

_STYLES = ("tumble", "inspect", "wave")
_OBJECTS = (
    *("swivel_usb", "flip_cap_usb", "folding_usb", "flip_lighter", "torch_lighter", "folding_lighter"),
    *("stapler", "mini_stapler", "long_arm_stapler", "slider_phone", "keyboard_phone", "cover_phone"),
    *("office_scissors", "tailor_shears", "craft_scissors", "drawer_unit", "nightstand", "filing_cabinet"),
    *("tilt_monitor", "pivot_monitor", "folding_display"),
)
"""Three a category; objects that the catalog gains later are of another version."""
_FROZEN = Path(__file__).with_name("freeart21_v1.json")


@dataclass(frozen=True)
class Entry:
    """One sequence of the benchmark."""

    object: str
    """Name in the catalog."""
    sequence: str
    """Name of its folders; opaque in the test split."""
    seed: int
    motion: str


def entries(split: Split) -> tuple[Entry, ...]:
    """The 21 sequences of a split. Every category has one object of each style; the splits assign them differently."""
    found = []
    for k, name in enumerate(_OBJECTS):
        seed, turn = SEEDS[split], get_args(Split).index(split)
        opaque = hashlib.sha256(f"{NAME} {split} {name} {seed}".encode()).hexdigest()[:8]
        sequence = f"{name}-v{VERSION}" if split == "public" else f"test-{opaque}"
        found.append(Entry(name, sequence, seed, _STYLES[(k + k // 3 + turn) % 3]))
    return tuple(found)


def jobs(split: Split, settings: RecordSettings | None = None) -> list[Job]:
    """The recorder's jobs of a split; seed and motion of `settings` are replaced by the benchmark's."""
    settings = settings or RecordSettings()
    return [Job(e.object, e.sequence, replace(settings, seed=e.seed, motion=e.motion)) for e in entries(split)]


def label(split: Split, settings: RecordSettings) -> Label:
    """The label of a split for benchmark.json; its name differs when `settings` are not the benchmark's own."""
    own = RecordSettings(seed=settings.seed, motion=settings.motion)
    return Label(NAME if settings == own else f"{NAME}-changed", VERSION, split)


def check_own_sequences(out: Path, jobs: Sequence[Job], label: Label | None) -> None:
    """FreeArtError when the folder `out` would have the benchmark's name with other sequences than its own.

    `label` is that of the `jobs`; None takes the folder's, or the folder's name.
    """
    known = read_benchmark(out) if (out / "benchmark.json").is_file() else None
    if label is None and (known.name if known else out.resolve().name) == NAME:
        raise FreeArtError(f"{out} is {NAME}, which has sequences of its own only; choose a folder of another name")
    strange = set(known.sequences if known else ()) - {job.sequence for job in jobs}
    if label is not None and strange:
        raise FreeArtError(
            f"{out} holds {min(strange)}, which is not of {label.name} {label.split}; choose another folder"
        )


def read_frozen() -> dict[str, dict[str, str]]:
    """Sequence name to the frozen fingerprints of its shape and motion, both splits."""
    sequences: dict[str, dict[str, str]] = checked.read_json(_FROZEN)["sequences"]
    return sequences


def shape_fingerprint(entry: Entry) -> str:
    """SHA-256, hexadecimal, of an object's solids, joints and mean colours, rounded to micrometres."""
    return _digest(_shape(objects.build(entry.object, entry.seed)))


def motion_fingerprint(entry: Entry, settings: RecordSettings | None = None) -> str:
    """SHA-256, hexadecimal, of a sequence's poses and states, rounded to 1e-4 m or rad, where machines agree.

    Seed and motion of `settings` are replaced by the entry's; None takes the benchmark's own.
    """
    settings = replace(settings or RecordSettings(), seed=entry.seed, motion=entry.motion)
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place:
        plan = plan_recording(find_object(entry.object, settings).load(Path(place)), settings)[1]
    return _digest([_text(plan.Ts_camera_object[:, :3], 4), _text(plan.states, 4)])


def _digest(facts: list[str]) -> str:
    return hashlib.sha256("\n".join(facts).encode()).hexdigest()


def _shape(model: ObjectModel) -> list[str]:
    facts = []
    for link in model.links:
        facts.append(link.semantic)
        if link.hinge is not None:
            hinge = link.hinge
            numbers = _text(np.array([*hinge.axis, *hinge.pivot, hinge.lower, hinge.upper]), 6)
            facts.append(f"{hinge.type} {hinge.parent} {numbers}")
        for piece in link.pieces:
            look = piece.material.texture
            colour = np.array(piece.material.colour) * 255 if look is None else look.reshape(-1, 3).mean(0)
            facts.append(f"{piece.name} {piece.material.finish} {_text(colour, 0)}")
            facts.append(_text(np.array(piece.solid.bounding_box()), 6))
    return facts


def _text(values: Array, digits: int) -> str:
    return " ".join(f"{v + 0.0:.{digits}f}" for v in np.round(values, digits).ravel() + 0.0)


def main(
    write: Annotated[bool, tyro.conf.arg(help="Write the present fingerprints as the frozen ones.")] = False,
) -> int:
    """Compare all sequences with their frozen fingerprints; exit code 1 when one differs."""
    every = [entry for split in get_args(Split) for entry in entries(split)]
    now = {e.sequence: {"shape": shape_fingerprint(e), "motion": motion_fingerprint(e)} for e in every}
    if write:
        atomic.write_json(_FROZEN, {"name": NAME, "version": VERSION, "sequences": now})
        return 0
    known = read_frozen()
    changed = [name for name, prints in now.items() if known.get(name) != prints]
    print(f"{NAME}: shapes or motions changed, which makes a new version: {', '.join(changed) or 'none'}")
    return int(bool(changed))


if __name__ == "__main__":
    raise SystemExit(tyro.cli(main))
