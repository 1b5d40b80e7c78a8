"""benchmarks/gaussians.py counts what it says it counts."""

import json
from dataclasses import replace

import gaussian_reference as reference
import numpy as np
import pytest

from benchmarks import gaussians as bench
from freeart21.errors import FreeArtError


def test_pairs_are_pixels_in_ellipses():
    scene = bench._scene(60, 60, 45, 60.0, 0)
    thin = replace(scene.splats, opacities=np.full(60, 0.05, np.float32))  # so that no pixel closes
    counted = len(reference.draw(thin, scene.poses, scene.lens).blended)
    assert bench._pairs(replace(scene, splats=thin)) == pytest.approx(counted, rel=0.05)


def test_a_run_writes_rows_and_what_they_were_measured_with(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bench, "COPIED", 1 << 20)
    out = tmp_path / "gaussians.json"
    bench.main(counts=(400, 800), windows=("60x45",), focal=60.0, repeats=1, out=out)
    data = json.loads(out.read_text())
    assert [(row["gaussians"], row["window"], row["backend"]) for row in data["rows"]] == [
        (400, "60x45", "numba"),
        (800, "60x45", "numba"),
    ]
    for row in data["rows"]:
        n, pixels = row["gaussians"], 60 * 45
        moved = n * (57 + 57 + 61) + pixels * (24 + 24)
        assert row["limit_ms"] == pytest.approx(1e-6 * moved / data["summary"]["copy_gb_per_s"])
        assert row["share"] == pytest.approx(row["limit_ms"] / row["iteration_ms"])
    assert {"commit", "machine", "settings"} <= set(data) and data["settings"]["focal"] == 60


def test_a_window_that_is_none():
    with pytest.raises(FreeArtError, match="--windows: got '60by45', expected WIDTHxHEIGHT"):
        bench._size("60by45")
