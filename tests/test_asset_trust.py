"""A doubtful reconstruction makes an asset that says so, in every file that may be carried off alone."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import pytest
from test_check_asset import files_of
from test_export import reconstruction

from export import commands
from export.exporter import export_result
from export.stated_trust import read_stated_trust
from freeart21.effects.armature import Armature
from freeart21.files.asset import read_asset
from freeart21.files.result import write_result
from freeart21.reconstruction import Trust
from freeart21.view.pages import page
from simgap.prove.writeback import write_repaired

REASON = "the axis is known to 12° only --- a test's <reason>"
DOUBTFUL = Trust("doubtful", (REASON, "and another"))


@pytest.fixture(scope="module")
def doubtful(tmp_path_factory) -> Path:
    """A doubtful result, exported by the command."""
    home = tmp_path_factory.mktemp("doubtful")
    write_result(home / "ours" / "s1", replace(reconstruction(), trust=DOUBTFUL))
    assert commands.export(home / "ours" / "s1", home / "asset") == 3
    return home / "asset"


def said_of(path: Path) -> tuple[str, str]:
    """Verdict and reason of check-asset's rule."""
    (row,) = (row for row in files_of(path) if row.rule == "trust.sound")
    return row.verdict, row.reason


def test_every_file_of_a_doubtful_asset_says_so(doubtful: Path):
    assert read_asset(doubtful).trust == DOUBTFUL
    document = json.loads((doubtful / "asset.json").read_text())["trust"]
    assert document == {"verdict": "doubtful", "reasons": list(DOUBTFUL.reasons)}
    for name in ("object.urdf", "object.xml"):
        assert "freeart21 trust: doubtful: the axis is known to 12° only - - - a test" in (doubtful / name).read_text()
    assert json.loads((doubtful / "loaders/joint.json").read_text())["trust"].startswith("doubtful: the axis")
    if importlib.util.find_spec("pxr"):
        from pxr import Sdf

        layer = Sdf.Layer.FindOrOpen(str(doubtful / "object.usdc"))
        assert layer.documentation == f"freeart21 trust: doubtful: {REASON}; and another"
        assert layer.customLayerData["freeart21:trust"] == f"doubtful: {REASON}; and another"
    assert "The reconstruction that the asset was made of is doubtful: the axis" in page(doubtful)


def test_check_asset_fails_a_doubtful_asset_from_any_one_of_its_files(doubtful: Path, tmp_path: Path):
    assert said_of(doubtful) == ("fail", f"doubtful: {REASON}; and another")
    for name in ("object.urdf", "object.xml"):  # carried off without asset.json, by somebody else's program
        alone = tmp_path / name
        alone.write_bytes((doubtful / name).read_bytes())
        trust = read_stated_trust(alone, None)
        assert trust.verdict == "doubtful" and "known to 12°" in trust.reasons[0]


def test_a_repaired_asset_carries_the_doubt_on(doubtful: Path, tmp_path: Path):
    again = write_repaired(read_asset(doubtful), (Armature(0.001),), tmp_path / "repaired")
    assert again.trust == DOUBTFUL and said_of(tmp_path / "repaired")[0] == "fail"
    for name in ("object.urdf", "object.xml", "loaders/joint.json"):
        assert "doubtful: the axis" in (tmp_path / "repaired" / name).read_text()


@pytest.fixture(scope="module")
def sound(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("sound") / "asset"
    export_result(replace(reconstruction(), trust=Trust("sound")), out)
    return out


def test_a_sound_answer_passes_and_one_without_a_verdict_is_not_stated(sound: Path, tmp_path: Path, capsys):
    assert said_of(sound)[0] == "pass" and "reconstruction that the asset was made of" not in page(sound)
    write_result(tmp_path / "ours" / "s1", reconstruction())
    assert commands.export(tmp_path / "ours" / "s1", tmp_path / "asset") == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("not stated: ")
    document = json.loads((tmp_path / "asset/asset.json").read_text())["trust"]
    assert document == {"verdict": "not stated", "reasons": []} and read_asset(tmp_path / "asset").trust is None
    assert said_of(tmp_path / "asset")[0] == "skip"
    assert "freeart21 trust: not stated" in (tmp_path / "asset/object.urdf").read_text()
