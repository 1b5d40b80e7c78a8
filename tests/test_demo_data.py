"""`make demo-data` records what it was when it was frozen: the same objects, shapes and motions."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from freeart21 import catalog
from generator import v1
from generator.session import RecordSettings

ROOT = Path(__file__).resolve().parents[1]
FROZEN = {  # shape and motion, as generator/v1.py takes them
    "office_scissors": ("7ea2a78fac1ff6fd", "2a928bd407ca51f7"),
    "folding_usb": ("60a5cbef29c89b1b", "68f8e7d18b08f721"),
    "cover_phone": ("e199a2e4750bd415", "0a16c6806bc797e3"),
}
(RECIPE,) = re.findall(r"freeart21 record (.*)", (ROOT / "Makefile").read_text().replace("\\\n", " "))
WORDS = shlex.split(RECIPE)
FIRST_OPTION = next(i for i, word in enumerate(WORDS) if word.startswith("--"))
OBJECTS = WORDS[:FIRST_OPTION]
OPTIONS = dict(zip(WORDS[FIRST_OPTION::2], WORDS[FIRST_OPTION + 1 :: 2], strict=True))
SETTINGS = RecordSettings(
    seed=int(OPTIONS["--seed"]),
    frames=int(OPTIONS["--frames"]),
    width=int(OPTIONS["--width"]),
    height=int(OPTIONS["--height"]),
    queries=int(OPTIONS["--queries"]),
    shader=OPTIONS["--shader"],
)


def fingerprints(name: str) -> tuple[str, str]:
    entry = v1.Entry(name, f"{name}-s{SETTINGS.seed}", SETTINGS.seed, SETTINGS.motion)
    return v1.shape_fingerprint(entry)[:16], v1.motion_fingerprint(entry, SETTINGS)[:16]


def test_it_is_three_objects_of_sixty_frames_with_both_kinds_of_joint() -> None:
    assert len(OBJECTS) == 3 and SETTINGS.frames == 60 and OPTIONS["--out"] == "data/demo"
    assert {catalog.find(name).joint_type for name in OBJECTS} == {"revolute", "prismatic"}


@pytest.mark.parametrize("name", OBJECTS)
def test_shapes_and_motions_are_those_that_were_frozen(name: str) -> None:
    assert fingerprints(name) == FROZEN[name], "a change of these is another demo: freeze it anew, and say so"
