"""`benchmarks.assets`: what it counts."""

from types import SimpleNamespace

import numpy as np
import pytest
from little_asset import write_little

from benchmarks import assets
from freeart21 import se3
from freeart21.camera import Camera
from freeart21.recording import Query


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


def test_views_of_supposed_and_of_seen_faces_are_counted_apart(tmp_path):
    """A grey box under its lid, which nobody saw, from above, closed and open; the truth is 51 brighter."""
    asset = SimpleNamespace(
        urdf=write_little(tmp_path),
        reference_link="box",
        moving_link="lid",
        joint="hinge",
        held={},
        state_zero=0.0,
        T_canonical_reference=np.eye(4),
        source={"parts": {"reference": {}, "moving": {"patch": {"first_face": 0}}}},
    )
    T = se3.pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))
    answer = SimpleNamespace(states=np.array([0.0, 1.2]), Ts_camera_reference=np.stack([T, T]))
    queries = (Query(0, 0, np.eye(4)), Query(0, 1, np.eye(4)))
    camera = Camera(np.array([[200.0, 0, 50], [0, 200, 50], [0, 0, 1]]), 100, 100)
    recording = SimpleNamespace(camera=camera, queries=queries)
    picture = np.full((100, 100, 3), 190 + 51, np.uint8)
    truth = SimpleNamespace(query_mask=lambda i: np.ones((100, 100), bool), query_rgb=lambda i: picture)
    both = assets.supposed_views(asset, answer, truth, recording)
    off = 20 * np.log10(255 / 51)
    assert both["supposed_psnr"] == pytest.approx(off) and both["seen_psnr"] == pytest.approx(off)
    assert 0.5 < both["supposed_pixels"] < 0.9
    recording.queries = queries[:1]
    closed = assets.supposed_views(asset, answer, truth, recording)
    assert closed["seen_psnr"] is None and closed["supposed_pixels"] == 1
