"""A package of somebody else adds a member of a kind by one file and one entry point."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from refusal import assert_refused

from freeart21.effects import ASSET_ERRORS, EFFECTS, Effect
from freeart21.registry import find_classes, find_instances
from generator.motion.style import Style
from generator.motion.styles import STYLES

EFFECT = """
from freeart21.effects.viscous_damping import ViscousDamping

class Squeak(ViscousDamping):
    name = "squeak"
"""
STYLE = """
from dataclasses import replace
from generator.motion.styles import wave

STYLE = replace(wave.STYLE, name="shake", stream=1000)
"""


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Installs a package with one module, named by one entry point."""

    def do(group: str, text: str) -> None:
        (tmp_path / "stranger.py").write_text(text)
        info = tmp_path / "stranger-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[{group}]\nown = stranger\n")

    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "stranger", raising=False)
    return do


def test_a_class_of_a_stranger(install):
    install("freeart21.effects", EFFECT)
    found = find_classes("freeart21.effects", Effect)
    assert set(found) - set(EFFECTS | ASSET_ERRORS) == {"squeak"} and issubclass(found["squeak"], Effect)


def test_an_instance_of_a_stranger(install):
    install("generator.motion.styles", STYLE)
    found = find_instances("generator.motion.styles", Style)
    assert set(found) - set(STYLES) == {"shake"} and isinstance(found["shake"], Style)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (EFFECT.replace('"squeak"', '"detent"'), "name already taken: Effect 'detent'"),
        ("import nowhere_at_all", "No module named 'nowhere_at_all'"),
        ("", "defines no Effect with a name"),
    ],
)
def test_a_member_that_cannot_be_one_is_named(install, text: str, message: str):
    install("freeart21.effects", text)
    line = assert_refused("entry point freeart21.effects: own = stranger", find_classes, "freeart21.effects", Effect)
    assert message in line
