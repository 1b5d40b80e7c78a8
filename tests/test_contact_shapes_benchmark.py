"""The benchmark of contact shapes, on a box: what its numbers say of shapes that are known."""

import sys

import pytest
import trimesh
from refusal import assert_refused
from solid_case import as_mesh, box

from benchmarks.contact_shapes import main, measure_shapes, read_parts
from export.collision import Collision
from export.outer_surface import sample_outer_surface

BOX = box((0.2, 0.15, 0.08))


def measured(*shapes: trimesh.Trimesh) -> dict:
    return measure_shapes(BOX, Collision(tuple(map(as_mesh, shapes)), (), sample_outer_surface(BOX)))


def test_a_box_as_itself_has_nothing_away_and_nothing_added():
    true = measured(trimesh.creation.box((0.2, 0.15, 0.08)))
    assert true["shapes"] == 1 and true["away_mm"] < 0.01 and true["out_mm"] < 0.01
    assert abs(true["added_pc"]) < 0.01 and abs(true["lacking_pc"]) < 0.01 and true["steps_per_s"] > 0


def test_what_lacks_is_away_and_what_is_added_stands_out():
    half = measured(trimesh.creation.box((0.2, 0.15, 0.08)).slice_plane((0, 0, 0), (1, 0, 0), cap=True))
    assert half["lacking_pc"] == pytest.approx(50, abs=0.1) and half["away_mm"] == pytest.approx(100, abs=2)
    large = measured(trimesh.creation.box((0.22, 0.15, 0.08)))
    assert large["added_pc"] == pytest.approx(10, abs=0.1) and large["out_mm"] == pytest.approx(10, abs=0.1)
    assert large["lacking_pc"] < 0.01 and large["away_mm"] < 0.2  # a point on a common face may count as outside


def test_without_coacd_or_a_urdf_it_says_so(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "coacd", None)
    assert_refused("pip install coacd", main, (str(tmp_path),))
    assert_refused("there is no URDF", read_parts, str(tmp_path))
