"""A package of somebody else adds a member of a kind by one file and one entry point."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from refusal import assert_refused

from freeart21.effects import ASSET_ERRORS, EFFECTS, Effect
from freeart21.formats.convert import recording_layouts
from freeart21.formats.third_party import RecordingLayout
from freeart21.registry import find_classes, find_instances
from generator.motion.style import Style
from generator.motion.styles import STYLES
from generator.sensors import SENSORS
from generator.sensors.base import SensorModel
from leaderboard.adapters.layout import Layout, layouts
from leaderboard.protocols import PROTOCOLS, Protocol
from reconstruct.features import FEATURES, Features
from reconstruct.trackers import TRACKERS
from reconstruct.tracks import Tracker

EFFECT = """
from freeart21.effects.viscous_damping import ViscousDamping

class Squeak(ViscousDamping):
    name = "squeak"
"""
PROTOCOL = """
from dataclasses import replace
from leaderboard.protocols.strict2 import STRICT_2 as theirs

OWN = replace(theirs, name="own-1", ranking=False)
del theirs
"""
STYLE = """
from dataclasses import replace
from generator.motion.styles import wave

STYLE = replace(wave.STYLE, name="shake", stream=1000)
"""
SENSOR = """
from generator.sensors.base import SensorModel

class Millimetres(SensorModel):
    name = "millimetres"

    def depth(self, depth, rng):
        return (depth * 1000).round() / 1000
"""
TRACKER = """
from reconstruct.trackers.dis import Dis

class Slow(Dis):
    name = "slow"
"""
FEATURES_ = """
from reconstruct.features.hand_made import HandMade

class Grey(HandMade):
    name = "grey"
"""
RECORDINGS = """
from dataclasses import replace
from freeart21.formats import rgbd_folder

LAYOUT = replace(rgbd_folder.LAYOUT, name="scans", rank=9)
"""
LAYOUT = """
from dataclasses import replace
from leaderboard.adapters import artgs

LAYOUT = replace(artgs.LAYOUT, name="own")
"""


def install(folder: Path, group: str, text: str) -> None:
    """An installed package with one module, named by one entry point."""
    (folder / "stranger.py").write_text(text)
    info = folder / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{group}]\nown = stranger\n")


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "stranger", raising=False)
    return tmp_path


@pytest.mark.parametrize(
    ("group", "text", "kind", "ours", "name"),
    [
        ("freeart21.effects", EFFECT, Effect, EFFECTS | ASSET_ERRORS, "squeak"),
        ("generator.sensors", SENSOR, SensorModel, SENSORS, "millimetres"),
        ("reconstruct.trackers", TRACKER, Tracker, TRACKERS, "slow"),
        ("reconstruct.features", FEATURES_, Features, FEATURES, "grey"),
    ],
)
def test_a_class_of_a_stranger(stranger: Path, group: str, text: str, kind: type, ours: dict, name: str):
    install(stranger, group, text)
    found = find_classes(group, kind)
    assert set(found) - set(ours) == {name} and issubclass(found[name], kind)


@pytest.mark.parametrize(
    ("group", "text", "kind", "ours", "name"),
    [
        ("leaderboard.protocols", PROTOCOL, Protocol, PROTOCOLS, "own-1"),
        ("generator.motion.styles", STYLE, Style, STYLES, "shake"),
        ("freeart21.formats", RECORDINGS, RecordingLayout, recording_layouts(), "scans"),
        ("leaderboard.adapters", LAYOUT, Layout, layouts(), "own"),
    ],
)
def test_an_instance_of_a_stranger(stranger: Path, group: str, text: str, kind: type, ours: dict, name: str):
    install(stranger, group, text)
    found = find_instances(group, kind)
    assert set(found) - set(ours) == {name} and isinstance(found[name], kind) and list(found) == sorted(found)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (EFFECT.replace('"squeak"', '"detent"'), "name already taken: Effect 'detent'"),
        ("import nowhere_at_all", "No module named 'nowhere_at_all'"),
        ("", "defines no Effect with a name"),
    ],
)
def test_a_member_that_cannot_be_one_is_named(stranger: Path, text: str, message: str):
    install(stranger, "freeart21.effects", text)
    line = assert_refused("entry point freeart21.effects: own = stranger", find_classes, "freeart21.effects", Effect)
    assert message in line
