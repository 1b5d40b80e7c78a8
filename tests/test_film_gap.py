"""The gap between two films: camera faults are named alone and in pairs, and nothing else is."""

from __future__ import annotations

import json
from dataclasses import replace

import film_sensors as sensors
import numpy as np
import pytest
from browser import CHROMIUM, browser
from film_scene import film_with_truth

from freeart21 import se3
from freeart21.camera_faults import CameraFaults, incidence_cosine
from freeart21.errors import FreeArtError
from freeart21.files.camera_faults import read_camera_faults, write_camera_faults
from freeart21.files.sequence import read_sequence, write_sequence
from generator.recorder import RecordSettings, record
from simgap import commands
from simgap.film import samples
from simgap.film.scene import read_scene
from simgap.film.workflow import film_gap_folder, find_film_gap, is_sequence, read_film


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
        (lambda f: sensors.reads_long(f, -0.02), "depth_scale", "depth_scale", -0.02, 5e-4),
        (lambda f: sensors.reads_off(f, 0.006), "depth_offset", "depth_offset", 0.006, 3e-4),
        (lambda f: sensors.bends(f, 0.04), "depth_curve", "depth_curve", 0.04, 2e-3),
        (lambda f: sensors.rustles(f, 0.008, 0.0), "axial_noise", "noise", 0.008, 5e-4),
        (lambda f: sensors.blind_to_dark(f, 0.3), "dark_holes", "dark_level", 0.28, 0.15),
        (lambda f: sensors.blind_to_slopes(f, 55), "grazing_holes", "grazing_angle", np.radians(55), np.radians(5)),
        (lambda f: sensors.frays(f, 0.4), "flying_pixels", "flying_share", 0.25, 0.15),
        (lambda f: sensors.slips(f, 3.0, -2.0), "misregistration", "depth_shift_u", 3.0, 0.2),
        (lambda f: sensors.scale_focal(f, 0.03), "focal_length", "focal", 0.03, 2e-3),
        (lambda f: sensors.shift_centre(f, 2.0, -3.0), "principal_point", "centre_v", -3.0, 0.2),
        (lambda f: sensors.lags(f, 1), "depth_delay", "depth_delay", 1 / 30, 3e-3),
    ],
    ids=["scale", "offset", "curve", "noise", "dark", "grazing", "flying", "slip", "focal", "centre", "delay"],
)
def test_one_camera_fault_is_named_and_measured(film, change, name, parameter, value, tolerance):
    verdict = named(film, change)
    assert names(verdict) - {"noise_growth", "noise_grazing"} == {name}, verdict.sentence
    assert size(verdict, parameter) == pytest.approx(value, abs=tolerance)
    assert set(verdict.added) == names(verdict)
    assert getattr(verdict.camera, parameter) == size(verdict, parameter)


def test_exposure_drift_and_tone_drift_are_distinguished(film):
    assert names(named(film, lambda f: sensors.brightens(f, 1.0))) == {"exposure_drift"}
    assert names(named(film, lambda f: sensors.steepens(f, 0.25))) <= {"gamma_drift"}


def test_both_faults_of_a_pair_are_named(film):
    verdict = named(film, lambda f: sensors.rustles(sensors.reads_long(f, 0.02), 0.004, 0.0))
    assert names(verdict) == {"depth_scale", "axial_noise"}
    verdict = named(film, lambda f: sensors.blind_to_dark(sensors.lags(f, 1), 0.3))
    assert names(verdict) == {"depth_delay", "dark_holes"}


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
    assert is_sequence(lone) and not is_sequence(asset)
    with pytest.raises(FreeArtError, match="nothing says where .* was in .*: expected a result around"):
        read_film(asset, lone)
    with pytest.raises(FreeArtError, match="holds no part poses"):
        read_film(asset, lone, tmp_path)
    short = replace(read_film(asset, sequence), recording=replace(read_sequence(sequence), times_s=np.arange(12) / 30))
    with pytest.raises(FreeArtError, match="has 12 frames, but .* has poses of"):
        find_film_gap(short)


def test_camera_fault_files_hold_only_the_differences(tmp_path):
    faults = CameraFaults(depth_scale=0.01, exposure=(0.0, 0.5, -0.5), noise=1e-3, noise_at=0.5)
    write_camera_faults(tmp_path / "camera.json", faults)
    assert read_camera_faults(tmp_path / "camera.json") == faults
    assert set(json.loads((tmp_path / "camera.json").read_text())) == {
        "schema", "depth_scale", "exposure", "noise", "noise_at",
    }  # fmt: skip
    for text, match in (
        ('"depth_scale": 9', "depth_scale is 9.0, expected -0.5 to 1"),
        ('"depth_size": 1', "camera faults has 'depth_size', expected depth_scale"),
        ('"gamma": [0, -2]', "expected numbers above -1"),
        ('"noise": "loud"', "'noise' is 'loud', expected a finite number"),
    ):
        (tmp_path / "bad.json").write_text('{"schema": "freeart21/camera-faults/1", ' + text + "}")
        with pytest.raises(FreeArtError, match=match):
            read_camera_faults(tmp_path / "bad.json")


def test_camera_faults_act_by_their_parameters(film):
    camera = film.recording.camera
    depth = film.recording.frame(0).depth
    on = depth > 0
    bright, cosine = np.full(depth.shape, 0.5, np.float32), incidence_cosine(depth, camera)
    rng = np.random.default_rng(0)
    scaled = CameraFaults(depth_scale=0.1, depth_offset=0.01).depth(depth, bright, cosine, camera, rng)
    np.testing.assert_allclose(scaled[on], 1.1 * depth[on] + 0.01, rtol=1e-5)
    noisy = CameraFaults(noise=0.002, noise_at=1.0, noise_growth=0.0).depth(depth, bright, cosine, camera, rng)
    assert np.std((noisy - depth)[on]) == pytest.approx(0.002, rel=0.1)
    moved = CameraFaults(depth_shift_u=3.0, depth_shift_v=-2.0).depth(depth, bright, cosine, camera, rng)
    np.testing.assert_array_equal(moved[:-2, 3:], depth[2:, :-3])
    holes = CameraFaults(dark_share=0.9, dark_level=0.8).depth(depth, bright, cosine, camera, rng)
    assert np.mean(holes[on] == 0) == pytest.approx(0.9, abs=0.03)
    grey = np.full((4, 4, 3), 128, np.uint8)
    brighter = CameraFaults(exposure=(0.0, 1.0)).colour(grey, 1.0)
    assert int(brighter[0, 0, 0]) == pytest.approx(175, abs=2)  # twice the light of sRGB 128
    assert CameraFaults().is_ideal and not CameraFaults(holes=0.1).is_ideal
    assert CameraFaults(focal=0.1, centre_u=2).actual_camera(camera).K[0, 0] == pytest.approx(1.1 * camera.K[0, 0])


def test_a_delay_is_found_from_estimated_poses(film):
    """Estimated poses: every part has an unknown small error in every frame."""
    rng, placed = np.random.default_rng(3), film.scene.placed
    off = [[se3.pose(se3.exp_so3(rng.normal(size=3) * 4e-3), rng.normal(size=3) * 6e-4) for _ in T] for T in placed.Ts]
    Ts = tuple(np.array(o) @ T for o, T in zip(off, placed.Ts, strict=True))
    estimated = replace(film, scene=replace(film.scene, placed=replace(placed, Ts=Ts, exact=False)))
    verdict = named(estimated, lambda f: sensors.lags(f, 1))
    assert names(verdict) == {"depth_delay"} and size(verdict, "depth_delay") == pytest.approx(1 / 30, abs=4e-3)
    assert not named(estimated, lambda f: f).effects


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


def test_recorded_geometry_and_timing_faults_are_recovered(tmp_path):
    verdict = answer(*filmed(tmp_path / "late", CameraFaults(depth_delay=0.02, focal=0.03)))
    assert names(verdict) == {"depth_delay", "focal_length"}, verdict.sentence
    assert verdict.camera.depth_delay == pytest.approx(0.02, abs=2e-3)
    assert verdict.camera.focal == pytest.approx(0.03, abs=3e-3)


def test_a_broken_fault_file_is_refused_before_recording(tmp_path):
    (tmp_path / "bad.json").write_text('{"schema": "freeart21/camera-faults/1", "depth_scale": "long"}')
    with pytest.raises(FreeArtError, match="'depth_scale' is 'long'"):
        replace(SETTINGS, camera=tmp_path / "bad.json").check()
