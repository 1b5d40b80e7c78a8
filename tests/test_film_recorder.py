"""Camera faults recorded by the recorder are recovered by `gap`."""

from __future__ import annotations

from dataclasses import replace

import pytest

from freeart21.camera_faults import CameraFaults
from freeart21.errors import FreeArtError
from freeart21.files.camera_faults import write_camera_faults
from generator.recorder import RecordSettings, record
from simgap.film.workflow import find_film_gap, read_film

SETTINGS = RecordSettings(frames=36, width=192, height=108, queries=0, shader="trivial", seed=5)


def filmed(folder, faults=None):
    """Data folder and sequence's name of the stapler, filmed with faults."""
    camera = None
    if faults is not None:
        camera = folder.parent / f"{folder.name}.json"
        write_camera_faults(camera, faults)
    return folder, record("stapler", folder, replace(SETTINGS, camera=camera))


def answer(data, name):
    return find_film_gap(read_film(data / "truth" / name / "object", data / "sequences" / name))[0]


def test_recorded_faults_are_recovered(tmp_path):
    faults = CameraFaults(
        depth_scale=0.03, noise=5e-4, noise_at=0.3, dark_share=0.9, dark_level=0.35, exposure=(0.0, 1.0)
    )
    verdict = answer(*filmed(tmp_path / "data", faults))
    names = {named.effect.name for named in verdict.effects} - {"noise_growth", "noise_grazing"}
    assert names == {"depth_scale", "axial_noise", "dark_holes", "exposure_drift"}, verdict.sentence
    assert verdict.camera.depth_scale == pytest.approx(0.03, abs=1e-3)
    assert verdict.camera.noise == pytest.approx(5e-4, rel=0.25)


def test_recorded_geometry_and_timing_faults_are_recovered(tmp_path):
    verdict = answer(*filmed(tmp_path / "late", CameraFaults(depth_delay=0.02, focal=0.03)))
    assert {named.effect.name for named in verdict.effects} == {"depth_delay", "focal_length"}, verdict.sentence
    assert verdict.camera.depth_delay == pytest.approx(0.02, abs=2e-3)
    assert verdict.camera.focal == pytest.approx(0.03, abs=3e-3)


def test_a_broken_fault_file_is_refused_before_recording(tmp_path):
    (tmp_path / "bad.json").write_text('{"schema": "freeart21/camera-faults/1", "depth_scale": "long"}')
    with pytest.raises(FreeArtError, match="depth_scale is 'long'"):
        replace(SETTINGS, camera=tmp_path / "bad.json").check()
