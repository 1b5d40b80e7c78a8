"""`benchmarks.assets`: what it counts, and that a row is kept while exporter and answer stay the same."""

import numpy as np
import pytest
import trimesh

from benchmarks import assets
from freeart21.errors import FreeArtError
from freeart21.mesh import Mesh


def test_goals_are_counted_over_the_rows_that_they_concern():
    rows = [
        {"status": "ok", "mass_pc": [-25.0, 3.0], "speed": 0.9, "failed_rules": 0, "ball": 1},
        {"status": "ok", "mass_pc": [10.0, -19.0], "speed": 0.5, "failed_rules": 2},
        {"status": "a failure, nothing to export"},
    ]
    found = assets.sum_up(rows)
    assert found["mass_pc"] == {"goal": 20, "reached": 1, "of": 3, "median": 22.0, "worst": 25.0}
    assert (found["speed"]["reached"], found["speed"]["of"], found["speed"]["worst"]) == (1, 3, 0.5)
    assert (found["ball"]["reached"], found["ball"]["of"]) == (1, 2), "no ball for what is no drawer, but for no asset"
    assert found["failed_rules"]["reached"] == 1


def test_voxel_iou_of_a_half_and_of_a_thin_wall_that_is_cut_otherwise():
    solid = trimesh.creation.box((0.2, 0.1, 0.003))
    half = trimesh.creation.box((0.1, 0.1, 0.003)).apply_translation((0.05, 0, 0))
    assert assets.voxel_iou(Mesh(half.vertices, half.faces), solid) == pytest.approx(0.5, abs=0.02)
    more = trimesh.util.concatenate([solid, trimesh.creation.box((0.01,) * 3).apply_translation((0.1043, 0.2, 0.1))])
    least = assets.voxel_iou(Mesh(np.asarray(more.vertices), np.asarray(more.faces)), solid)
    assert least > 0.9, "a crumb elsewhere moves no lattice"


def test_a_row_is_kept_until_the_answer_changes_and_a_failure_is_tried_again(tmp_path, monkeypatch):
    result, calls = tmp_path / "answer", []
    (result / "parts").mkdir(parents=True)
    (result / "prediction.json").write_text("{}")

    def measure(*given):
        calls.append(given)
        if len(calls) == 1:
            raise FreeArtError(f"no room in {tmp_path / 'work'}")
        return {"cpu_s": 1.0}

    monkeypatch.setattr(assets, "measure", measure)

    def row():
        return assets.make_row("lid", result, tmp_path, tmp_path, "fine", tmp_path / "work")

    assert row() == {"object": "lid", "status": "no room in WORK"}
    assert row() == row() == {"object": "lid", "status": "ok", "cpu_s": 1.0} and len(calls) == 2
    (result / "parts" / "moving.ply").write_bytes(b"other")
    row()
    assert len(calls) == 3
