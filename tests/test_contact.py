"""Contact against what is seen, from an asset's files alone: known boxes, and an asset whose numbers are changed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from little_asset import write_little
from solid_case import box, tray
from test_check_asset import files_of
from test_export import reconstruction

from export.contact import measure_contact_depth, measure_contact_fidelity, read_link_shapes
from export.exporter import export_result
from export.settings import ExportSettings, PlacementSettings
from freeart21 import se3

RULE = "collision.true-to-visual"


def row_of(path: Path):
    (row,) = (row for row in files_of(path) if row.rule == RULE)
    return row


def shapes(*solids: trimesh.Trimesh):
    return [(np.eye(4), solid) for solid in solids]


def open_tray() -> tuple[trimesh.Trimesh, list[trimesh.Trimesh]]:
    """A tray of 200 x 150 x 80 mm with walls of 2 mm, and its five plates."""
    wall = 0.002
    plates = [trimesh.creation.box((0.2, 0.15, wall), se3.pose(np.eye(3), (0, 0, -0.039)))]
    for side in (-1, 1):
        plates.append(trimesh.creation.box((wall, 0.15, 0.08), se3.pose(np.eye(3), (side * 0.099, 0, 0))))
        plates.append(trimesh.creation.box((0.2, wall, 0.08), se3.pose(np.eye(3), (0, side * 0.074, 0))))
    return tray(wall), plates


def test_both_ways_are_measured():
    tray, plates = open_tray()
    true = measure_contact_fidelity({"a": shapes(tray)}, {"a": shapes(*plates)})["a"]
    assert true.worst < 2e-3 and true.outward < 2e-3
    block = measure_contact_fidelity({"a": shapes(tray)}, {"a": shapes(trimesh.creation.box((0.2, 0.15, 0.08)))})["a"]
    assert block.uncovered < 5e-4 and block.outward_95 > 0.04
    assert block.outward == pytest.approx(0.074, abs=3e-3)  # the middle of the top is as far from the nearest wall
    bottom = measure_contact_fidelity({"a": shapes(tray)}, {"a": shapes(plates[0])})["a"]
    assert bottom.uncovered == pytest.approx(0.078, abs=2e-3) and bottom.outward < 2e-3


def test_a_sheet_can_be_touched():
    """A door of PartNet-Mobility is two triangles, for the eye and for contact."""
    sheet = trimesh.Trimesh([[0, 0, 0], [0.3, 0, 0], [0.3, 0.5, 0], [0, 0.5, 0.0]], [[0, 1, 2], [0, 2, 3]])
    found = measure_contact_fidelity({"a": shapes(sheet)}, {"a": shapes(sheet)})["a"]
    assert found.worst < 1e-3 and found.outward < 1e-3


@pytest.mark.parametrize(
    "size, verdict",
    [("0.2 0.15 0.04", "pass"), ("0.2 0.05 0.04", "fail"), ("0.2 0.15 0.16", "fail")],
    ids=["as it is", "contact lacks two thirds", "contact stands out"],
)
def test_check_asset_measures_any_urdf(tmp_path: Path, size, verdict):
    file = write_little(tmp_path / "lid")
    box = '<box size="{}"/></geometry></collision>'
    file.write_text(file.read_text().replace(box.format("0.2 0.15 0.04"), box.format(size)))
    row = row_of(file)
    assert row.verdict == verdict and row.unit == "m" and row.value is not None
    assert (row.value > 0.02) == (verdict == "fail") and ("link 'box'" in row.reason or verdict == "pass")


def overlapping():
    """A lid that is sunk into its slab by 12 mm: one of them is carved."""
    return reconstruction(moving=box((0.2, 0.15, 0.03), (0, 0, 0.023)))


@pytest.fixture(scope="module")
def carved(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("carved") / "asset"
    export_result(overlapping(), out, ExportSettings(placement=PlacementSettings(zero="first")))
    return out


def test_asset_json_states_what_its_files_have_not_what_was_carved(carved: Path):
    source = json.loads((carved / "asset.json").read_text())["source"]
    seen, touched = read_link_shapes(carved / "object.urdf")
    assert {name: part["collision"] for name, part in source["parts"].items()} == {
        name: fidelity.to_json() for name, fidelity in measure_contact_fidelity(seen, touched).items()
    }
    assert source["penetration"]["carved"] in ("reference", "moving")
    assert source["penetration"]["before_carving_m"] > 0.008


def test_the_depth_in_asset_json_is_that_of_the_contact_shapes(carved: Path):
    source = json.loads((carved / "asset.json").read_text())["source"]["penetration"]
    _, touched = read_link_shapes(carved / "object.urdf")
    assert source["deepest_m"] == measure_contact_depth(carved / "object.urdf", "lid_joint", touched, 31)
    assert source["deepest_m"] < 1e-3 and source["deepest_visual_m"] < 1e-3 < source["before_carving_m"]


def test_numbers_in_asset_json_that_its_files_do_not_have_fail(carved: Path, tmp_path: Path):
    again = tmp_path / "asset"
    shutil.copytree(carved, again)
    document = json.loads((again / "asset.json").read_text())
    document["source"]["parts"]["moving"]["collision"]["worst_m"] = 0.1
    (again / "asset.json").write_text(json.dumps(document))
    row = row_of(again)
    assert row.verdict == "fail" and "asset.json states worst_m 100 mm of 'moving'" in row.reason
    for wrong in ([], {"moving": 3}, {"moving": {"collision": "good"}}, {"moving": {"collision": {"worst_m": "1"}}}):
        document["source"]["parts"] = wrong
        (again / "asset.json").write_text(json.dumps(document))
        assert "asset.json" not in row_of(again).reason
