"""The rooms together: what is recorded, handed in, exported, reloaded and scored."""

from dataclasses import replace

import pytest
from synthetic_case import truth_as_answer

from benchmarks.assets import true_model, true_solids
from export.exporter import DENSITY, export_result
from export.settings import CollisionSettings, ExportSettings, MeshSettings
from freeart21.files.result import write_result
from freeart21.files.sequence import read_sequence
from freeart21.files.truth import read_truth
from freeart21.files.urdf import read_urdf
from generator.recorder import RecordSettings, record
from leaderboard.score import score_results

CHANGED = 0.8
"""% of the diagonal by which the export may change a surface: 20k faces, fragments below 1 % of the area dropped, and
what nobody can see closed."""
ROUGH = CollisionSettings(tolerance_m=0.02, pairs=4_000)
"""Contact is not scored."""
CLOSED = 0.83
"""F-score that the export may bring the truth down to: patches that close what nobody can see are surface, too."""
COARSE = MeshSettings(points=8_000)
SETTINGS = RecordSettings(frames=6, seed=11, queries=3, width=320, height=180, shader="trivial", edge=0.1)


def test_a_recorded_truth_handed_in_and_reloaded_scores_perfect(tmp_path):
    data, results = tmp_path / "data", tmp_path / "results"
    sequence = record("flip_lighter", data, SETTINGS)
    truth, recording = read_truth(data / "truth" / sequence), read_sequence(data / "sequences" / sequence)
    answer = replace(truth_as_answer(truth), seen=truth.seen > 0)
    write_result(results / sequence, answer, renders=[truth.query_rgb(i) for i in range(len(recording.queries))])
    asset = export_result(
        results / sequence, results / sequence / "asset", ExportSettings(meshes=COARSE, collision=ROUGH)
    )
    links = read_urdf(asset.urdf).links
    for link, solid in zip(
        (asset.reference_link, asset.moving_link), true_solids(truth, true_model(truth)), strict=True
    ):
        assert links[link].inertial.mass == pytest.approx(DENSITY * solid.volume, rel=0.2)
    (row,) = score_results(results, data, "strict-2").rows
    assert (row.status, row.measured_from, row.swapped) == ("ok", "asset", False)
    assert row.values["joint_type"] == row.values["fscore_parts"] == 1 and row.values["fscore"] > CLOSED
    assert row.values["miou"] == row.values["ssim"] == pytest.approx(1)
    assert row.values["psnr"] == 100
    for metric in (
        "axis",
        "position",
        "state",
        "state_all",
        "pose_rotation",
        "pose_translation",
        "pose_moving_rotation",
        "pose_moving_translation",
        "chamfer_w_parts",
        "chamfer_m_parts",
        "chamfer_s_parts",
    ):
        assert row.values[metric] == pytest.approx(0, abs=1e-3), metric
    for metric in ("chamfer_w", "chamfer_m", "chamfer_s"):  # the asset's meshes are decimated to 20k faces
        assert row.values[metric] == pytest.approx(0, abs=CHANGED), metric
