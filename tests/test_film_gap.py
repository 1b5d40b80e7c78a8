"""The gap between two films: camera faults are named alone and in pairs, and nothing else is."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from browser import CHROMIUM, browser
from film_scene import film_with_truth

from benchmarks import film_faults as sensors
from freeart21.camera_faults import CameraFaults
from freeart21.errors import FreeArtError
from freeart21.files.camera_faults import read_camera_faults, write_camera_faults
from freeart21.files.sequence import read_sequence, write_sequence
from generator.recorder import RecordSettings, record
from simgap import commands
from simgap.film import samples
from simgap.film.scene import read_scene
from simgap.film.workflow import film_gap_folder, find_film_gap, read_film


@pytest.fixture(scope="module", autouse=True)
def fewer_rows():
    """Use a third of the pixels to keep the tests short."""
    with pytest.MonkeyPatch.context() as patch:
        for name, most in (("MOST_INNER", 500), ("MOST_EDGE", 150), ("MOST_BAND", 200)):
            patch.setattr(samples, name, most)
        yield


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A clean film on disk with its truth and its asset."""
    return film_with_truth(tmp_path_factory.mktemp("film"))


@pytest.fixture(scope="module")
def film(scene):
    asset, sequence = scene
    found = read_film(asset, sequence)
    return replace(found, recording=sensors.film_of(found.recording))


def named(film, change):
    verdict, _ = find_film_gap(replace(film, recording=change(film.recording)))
    return verdict


def names(verdict):
    return {named.effect.name for named in verdict.effects}


def size(verdict, parameter):
    return next(getattr(n.effect, parameter) for n in verdict.effects if parameter in n.effect.parameters())


def test_a_clean_film_has_no_gap(film):
    verdict = named(film, lambda f: f)
    assert verdict.verdict == "no_gap" and not verdict.effects and not verdict.left and verdict.camera.is_ideal
    assert verdict.next_experiment is None


@pytest.mark.parametrize(
    "change, name, parameter, value, tolerance",
    [
        (lambda f: sensors.reads_off(f, 0.006), "depth_offset", "depth_offset", 0.006, 3e-4),
        (lambda f: sensors.bends(f, 0.04), "depth_curve", "depth_curve", 0.04, 2e-3),
        (lambda f: sensors.blind_to_slopes(f, 55), "grazing_holes", "grazing_angle", np.radians(55), np.radians(5)),
        (lambda f: sensors.frays(f, 0.4), "flying_pixels", "flying_share", 0.25, 0.15),
        (lambda f: sensors.slips(f, 3.0, -2.0), "misregistration", "depth_shift_u", 3.0, 0.2),
        (lambda f: sensors.scale_focal(f, 0.03), "focal_length", "focal", 0.03, 2e-3),
        (lambda f: sensors.shift_centre(f, 2.0, -3.0), "principal_point", "centre_v", -3.0, 0.2),
        (lambda f: sensors.lags(f, 1), "depth_delay", "depth_delay", 1 / 30, 3e-3),
    ],
    ids=["offset", "curve", "grazing", "flying", "slip", "focal", "centre", "delay"],
)
def test_one_camera_fault_is_named_and_measured(film, change, name, parameter, value, tolerance):
    """A scale, noise and dark holes are those of the tests below."""
    verdict = named(film, change)
    assert names(verdict) - {"noise_growth", "noise_grazing"} == {name}, verdict.sentence
    assert size(verdict, parameter) == pytest.approx(value, abs=tolerance)
    assert set(verdict.added) == names(verdict)
    assert getattr(verdict.camera, parameter) == size(verdict, parameter)


@pytest.mark.parametrize(
    "change",
    [
        lambda f: sensors.rolling_vignette(f, 0.6),
        lambda f: sensors.second_bounce(f, 0.008),
        lambda f: sensors.breathes(f, 0.004),
    ],
    ids=["vignette", "bounce", "breathing"],
)
def test_an_unknown_camera_fault_is_not_named(film, change):
    verdict = named(film, change)
    assert not verdict.effects and verdict.verdict == "unexplained" and verdict.left
    assert verdict.next_experiment and "board" in verdict.next_experiment


def test_missing_geometry_is_found_on_its_part(scene, film, tmp_path):
    _, sequence = scene
    poorer = film_with_truth(tmp_path, knob=False, only_asset=True)[0]
    lacking = replace(film, scene=read_scene(poorer, sequence))
    verdict, _ = find_film_gap(lacking)
    part = verdict.missing_part
    assert part is not None and part.part == "moving" and part.share_explained > 0.7
    assert named(film, lambda f: f).missing_part is None
    assert verdict.verdict == "named" and "lacks" in verdict.sentence


def test_the_answer_is_atomic_and_read_by_the_recorder(scene, tmp_path):
    asset, sequence = scene
    far = tmp_path / "data" / "sequences" / "far"
    write_sequence(far, sensors.reads_long(read_sequence(sequence), 0.02), 1e-4)
    out = tmp_path / "gap"
    seen = []
    verdict = film_gap_folder(
        asset,
        far,
        out,
        poses=sequence.parent.parent / "truth" / sequence.name,
        progress=lambda a, b: seen.append((a, b)),
    )
    written = json.loads((out / "verdict.json").read_text())
    assert written["schema"] == "freeart21/verdict/1" and written["verdict"] == "named"
    assert sorted(written["files"]) == ["camera.json", "index.html"]
    assert read_camera_faults(out / "camera.json") == verdict.camera
    assert read_camera_faults(out / "camera.json").depth_scale == pytest.approx(0.02, abs=1e-3)
    assert (
        all(a <= b for a, b in seen) and "Where simulation and measurement differ" in (out / "index.html").read_text()
    )
    if CHROMIUM:
        with browser() as page:
            for width in (1280, 390):
                page.open(out / "index.html", width, ready="true")
                assert page.run("document.documentElement.scrollWidth") <= width and not page.errors
    again = film_gap_folder(asset, far, out, poses=sequence.parent.parent / "truth" / sequence.name)
    assert again.to_json("revolute") == verdict.to_json("revolute")


def test_bad_film_input_is_a_one_line_error(scene, tmp_path):
    asset, sequence = scene
    with pytest.raises(FreeArtError, match="--poses goes with a video"):
        commands.gap(asset, tmp_path, tmp_path / "out", poses=sequence)
    lone = tmp_path / "lone"
    write_sequence(lone, read_sequence(sequence), 1e-4)
    with pytest.raises(FreeArtError, match="nothing says where .* was in .*: expected a result around"):
        read_film(asset, lone)
    with pytest.raises(FreeArtError, match="holds no part poses"):
        read_film(asset, lone, tmp_path)
    short = replace(read_film(asset, sequence), recording=replace(read_sequence(sequence), times_s=np.arange(12) / 30))
    with pytest.raises(FreeArtError, match="has 12 frames, but .* has poses of"):
        find_film_gap(short)


# --- faults that the recorder puts in ---------------------------------------------------------------------------------

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
    found = names(verdict) - {"noise_growth", "noise_grazing"}
    assert found == {"depth_scale", "axial_noise", "dark_holes", "exposure_drift"}, verdict.sentence
    assert verdict.camera.depth_scale == pytest.approx(0.03, abs=1e-3)
    assert verdict.camera.noise == pytest.approx(5e-4, rel=0.25)


def test_a_broken_fault_file_is_refused_before_recording(tmp_path):
    (tmp_path / "bad.json").write_text('{"schema": "freeart21/camera-faults/1", "depth_scale": "long"}')
    with pytest.raises(FreeArtError, match="'depth_scale' is 'long'"):
        replace(SETTINGS, camera=tmp_path / "bad.json").check()
