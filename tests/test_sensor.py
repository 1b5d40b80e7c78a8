"""Sensors: each adds the stated errors, independently of the order of frames, and the truth stays true."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from freeart21 import se3
from freeart21.camera import Camera
from freeart21.errors import FreeArtError
from generator import partnet, tof
from generator.model import Hinge, Link, Material, ObjectModel, Piece
from generator.motion import Plan
from generator.partnet_writer import write_partnet
from generator.scene import Scene, decode_srgb
from generator.sensor import Sensor
from generator.sensors import SENSORS, phone
from generator.sensors.noise2 import NOISE2_SHARE, Noise2
from generator.shapes import box
from generator.tof import TimeOfFlight
from generator.urdf_object import LoadedObject

CAMERA = Camera.from_fov(160, 120, np.radians(40))
FRAMES = 90
UPRIGHT = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""Looks along the object's +x, its z up."""


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> LoadedObject:
    """A board of 12 x 10 cm with a small lid above it."""
    red, blue = (Material(n, c, "plastic", 1000) for n, c in (("red", (0.8, 0.2, 0.2)), ("blue", (0.2, 0.2, 0.8))))
    lid = Link(
        "rotation lid",
        (Piece("lid", box((0.02, 0.1, 0.03), (0, 0, 0.075)), red),),
        Hinge("revolute", "link_1", (0, 1, 0), (0, 0, 0.06), 0.0, 1.2),
    )
    board = Link("heavy board", (Piece("board", box((0.02, 0.1, 0.12), (0, 0, 0)), blue),))
    model = ObjectModel("toy", "Box", (lid, board), 0, 0)
    return partnet.load(write_partnet(model, tmp_path_factory.mktemp("toy") / "90210001"))


def _plan(twist: np.ndarray, frames: int = FRAMES) -> Plan:
    """The object half a metre away, moved by `twist` (6,) in the camera's frame from frame to frame."""
    start = se3.pose(UPRIGHT, [0, 0, 0.3])
    turns = se3.exp_se3(np.arange(frames)[:, None] * twist)
    centre = se3.pose(np.eye(3), [0, 0, 0.3])
    Ts = centre @ turns @ se3.inverse(centre) @ start
    world = se3.pose(UPRIGHT, np.zeros(3))
    return Plan(Ts, np.linspace(0, 1.2, frames), np.broadcast_to(world, (frames, 4, 4)))


TURN = _plan(np.array([0, 0, 0, 0.01, 0.03, 0.0]))


@pytest.fixture(scope="module")
def scene(loaded: LoadedObject) -> Scene:
    return Scene(loaded.asset.urdf, [s.links for s in loaded.sides], CAMERA, 0.01, 3.0, "trivial")


def _sensor(name: str, scene: Scene, loaded: LoadedObject, plan: Plan = TURN, seed: int = 0) -> Sensor:
    meshes = loaded.parent_side.surface.mesh(), loaded.child_side.surface.mesh()
    return Sensor(name, scene, plan, loaded, meshes, seed, 30.0)


# --- all of them ------------------------------------------------------------------------------------------------------


def test_clean_is_what_is_rendered(scene: Scene, loaded: LoadedObject) -> None:
    shot = _sensor("clean", scene, loaded).shoot(7)
    picture = scene.render(TURN.Ts_camera_object[7], {loaded.joint.name: float(TURN.states[7])})
    assert np.array_equal(shot.rgb, picture.rgb) and np.array_equal(shot.depth, picture.depth)
    assert np.array_equal(shot.side, picture.side) and np.array_equal(shot.side > 0, shot.depth > 0)
    assert set(np.unique(shot.side)) == {0, 1, 2} and (shot.side > 0).sum() > 1000


@pytest.mark.parametrize("name", [*SENSORS, "tof+blur+hand"])
def test_a_frame_is_the_same_in_any_order_and_frames_differ(name: str, scene: Scene, loaded: LoadedObject) -> None:
    sensor = _sensor(name, scene, loaded)
    forth = [sensor.shoot(i) for i in (3, 40, 41)]
    again = _sensor(name, scene, loaded)
    back = [again.shoot(i) for i in (41, 40, 3)][::-1]
    for a, b in zip(forth, back, strict=True):
        for field in ("rgb", "depth", "side"):
            assert getattr(a, field).tobytes() == getattr(b, field).tobytes()
        assert a.rgb.dtype == a.side.dtype == np.uint8 and a.depth.dtype == np.float32


def test_unknown_names_get_one_line(scene: Scene, loaded: LoadedObject) -> None:
    for name, message in (
        ("fog", f"unknown sensor 'fog'; sensors: {', '.join(SENSORS)}"),
        ("tof+fog", "unknown sensor 'fog'"),
        ("clean+blur", "'clean\\+blur' joins"),
        ("noise2+tof", "joins"),
        ("blur+blur", "joins"),
    ):
        with pytest.raises(FreeArtError, match=message) as caught:
            _sensor(name, scene, loaded)
        assert "\n" not in str(caught.value)


# --- noise2 -----------------------------------------------------------------------------------------------------------


def test_noise2_is_two_percent_everywhere_and_fresh() -> None:
    depth = np.tile(np.linspace(0.2, 4, 400, dtype=np.float32), (400, 1))
    depth[:, :10] = 0
    one, other = (Noise2(None).depth(depth, np.random.default_rng([0, 4, i])) for i in (0, 1))
    assert np.array_equal(one[:, :10], depth[:, :10])
    x, y = ((d[:, 10:] / depth[:, 10:] - 1) / NOISE2_SHARE for d in (one, other))
    assert NOISE2_SHARE == 0.02 and abs(x.mean()) < 0.01
    for part in (x, x[:, :100], x[:, -100:]):
        assert part.std() == pytest.approx(1, rel=0.03)
    assert abs(np.mean(x * y)) < 0.01 and abs(np.mean(x[:, 1:] * x[:, :-1])) < 0.01


# --- tof --------------------------------------------------------------------------------------------------------------

NARROW = Camera.from_fov(160, 120, np.radians(6))


def _measured(
    camera: Camera, depth: np.ndarray, albedo: float, gloss: float = 0.0, seed: int = 0, frame: int = 0
) -> np.ndarray:
    depth = depth.astype(np.float32)
    fill = [np.full(depth.shape, x, np.float32) for x in (albedo, gloss)]
    return TimeOfFlight(camera, seed).measure(depth, *fill, np.random.default_rng([seed, 4, frame]))


def _tilted(camera: Camera, degrees: float, distance: float) -> np.ndarray:
    """Depth of a plane through (0, 0, distance), tilted about the picture's upright axis."""
    n = np.array([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))])
    return np.maximum(n[2] * distance / (camera.rays() @ n), 0)


@pytest.mark.parametrize(("distance", "published_mm"), [(0.8, 0.61), (1.5, 0.89), (3.0, 1.78)])
def test_tof_noise_on_a_white_wall_is_as_published(distance: float, published_mm: float) -> None:
    wall = np.full((120, 160), distance)
    frames = np.array([_measured(NARROW, wall, 0.8, frame=k)[4:-4, 4:-4] for k in range(4)])
    noise = np.sqrt(frames.astype(float).var(axis=(1, 2)).mean() * 1e6 - 1 / 12)  # without the steps of 1 mm
    assert noise == pytest.approx(published_mm, rel=0.03)
    assert abs(np.corrcoef(frames[0].ravel(), frames[1].ravel())[0, 1]) < 0.05


def test_tof_error_is_within_the_data_sheet_for_every_specimen() -> None:
    z = np.linspace(0.2, 4, 500)
    for seed in range(20):
        error = TimeOfFlight(NARROW, seed).systematic_error(z)
        assert (np.abs(error) < 0.011 + 0.001 * z).all() and np.abs(error).max() > 1e-3
    one, other = (TimeOfFlight(NARROW, seed).systematic_error(z) for seed in (1, 2))
    assert np.abs(one - other).max() > 1e-3, "each specimen has an error of its own"
    assert tof.noise_m(np.array([0.15 / 0.8 / 3.86**2])) < 0.017  # 15 % at the end of the range


def _valid_share(depth: np.ndarray, albedo: float, gloss: float = 0.0) -> float:
    inner = slice(8, -8)
    return float((_measured(NARROW, depth, albedo, gloss)[inner, inner] > 0).mean())


def test_tof_loses_grazing_dark_and_glossy_surfaces() -> None:
    grazing = [_valid_share(_tilted(NARROW, degrees, 0.5), 0.5) for degrees in (0, 60, 75, 82, 88)]
    assert grazing[:2] == [1, 1] and grazing[2] > 0.98 and 0.2 < grazing[3] < 0.8 and grazing[4] < 0.05
    wall = np.full((120, 160), 3.6)
    dark = [_valid_share(wall, albedo) for albedo in (0.5, 0.1, 0.045, 0.02)]
    assert dark[0] == 1 and dark == sorted(dark, reverse=True) and dark[-1] == 0 and dark[0] > dark[2]
    assert _valid_share(np.full((120, 160), 0.3), 0.03) == 1  # near enough, the dark is seen
    facing, turned = (_valid_share(_tilted(NARROW, degrees, 0.3), 0.3, 0.55) for degrees in (0, 30))
    assert facing < 0.1 and turned == 1 and _valid_share(np.full((120, 160), 0.3), 0.3) == 1


def test_tof_pixels_fly_backwards_and_only_at_edges() -> None:
    depth = np.zeros((120, 160), np.float32)
    cv2.circle(depth, (80, 60), 40, 0.5, -1)
    camera = Camera.from_fov(160, 120, np.radians(12))
    measured = _measured(camera, depth, 0.3)
    assert (measured[depth == 0] == 0).all()
    inside = cv2.distanceTransform((depth > 0).astype(np.uint8), cv2.DIST_L2, 5)
    reach = 2.5 * tof.FOOTPRINT_RAD * camera.K[0, 0] + 1.5
    error = np.where(measured > 0, measured - depth, 0)[depth > 0]
    far = np.abs(error) > 0.02
    rim = inside[depth > 0]
    assert (rim[far] <= reach).all() and far.sum() > 20 and (error[far] > 0).all()
    assert (measured[(depth > 0) & (inside > reach)] > 0).all()
    assert 0.02 < (measured[(depth > 0) & (inside <= 2)] == 0).mean() < 0.8


# --- blur -------------------------------------------------------------------------------------------------------------


def test_blur_widens_edges_by_the_motion_and_keeps_the_light(scene: Scene, loaded: LoadedObject) -> None:
    step_px = 14.0  # a frame; half of it while the shutter is open
    shift = np.array([step_px * (0.3 - 0.01) / CAMERA.K[0, 0], 0, 0, 0, 0, 0])
    plan = _plan(shift, 3)
    plan = Plan(plan.Ts_camera_object, np.zeros(3), plan.Ts_camera_world)
    sharp, sensor = _sensor("clean", scene, loaded, plan).shoot(1), _sensor("blur", scene, loaded, plan)
    assert sensor.motion_px(1) == pytest.approx(step_px / 2, rel=0.05)
    blurred = sensor.shoot(1)
    assert np.array_equal(sharp.side, blurred.side) and np.array_equal(sharp.depth, blurred.depth)
    light = [decode_srgb(s.rgb.astype(np.float32) / 255) for s in (sharp, blurred)]
    assert light[1].mean() == pytest.approx(light[0].mean(), rel=0.02)
    row = np.median(light[1][55:65, :, 2], axis=0)  # across the blue board
    edge = row[: int(np.argmax(row)) + 1] / row.max()
    width = np.interp(0.95, edge, np.arange(len(edge))) - np.interp(0.05, edge, np.arange(len(edge)))
    assert width == pytest.approx(0.9 * step_px / 2, abs=1.2)
    hard = np.median(light[0][55:65, :, 2], axis=0)
    assert np.sum((hard > 0.05 * hard.max()) & (hard < 0.95 * hard.max())) == 0


# --- hand -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 3])
def test_the_hand_hides_some_of_the_object_and_nothing_else_changes(
    seed: int, scene: Scene, loaded: LoadedObject
) -> None:
    sensor = _sensor("hand", scene, loaded, TURN, seed)
    shares = []
    for i in range(0, FRAMES, 9):
        with_hand = sensor.shoot(i)
        positions = {loaded.joint.name: float(TURN.states[i])}
        bare = scene.render(TURN.Ts_camera_object[i], positions, TURN.Ts_camera_world[i])  # and the hand is gone
        hidden = (bare.side > 0) & (with_hand.side == 0)
        assert np.array_equal(np.where(hidden, 0, bare.side), with_hand.side)
        shown = with_hand.side > 0
        assert np.array_equal(with_hand.rgb[shown], bare.rgb[shown])
        assert np.array_equal(with_hand.depth[shown], bare.depth[shown])
        assert (with_hand.depth[hidden] > 0).all() and (with_hand.depth[hidden] < bare.depth[hidden]).all()
        shares.append(hidden.sum() / (bare.side > 0).sum())
        beside = (bare.side == 0) & (with_hand.depth > 0)
        assert beside.sum() > 50
        assert (np.abs(with_hand.rgb[beside].astype(int) - bare.rgb[beside]).max(1) > 20).mean() > 0.9
    assert 0.04 < np.mean(shares) < 0.35 and np.std(shares) > 0.01


# --- phone ------------------------------------------------------------------------------------------------------------


def _phone_map(depth: np.ndarray, colour: np.ndarray, frame: int) -> np.ndarray:
    """(192, 256) of a picture twice as large."""
    measured = phone.measure(depth.astype(np.float32), colour.astype(np.float32), np.random.default_rng([0, 4, frame]))
    return cv2.resize(measured, (256, 192), interpolation=cv2.INTER_AREA).astype(float)


def test_phone_errors_are_as_large_and_as_correlated_as_measured() -> None:
    camera = Camera.from_fov(512, 384, np.radians(60))
    wall, grey = _tilted(camera, 20, 0.6), np.full((384, 512, 3), 0.5)
    y, x = np.indices((24, 24)).reshape(2, -1)
    A = np.column_stack([np.ones(24 * 24), x, y])
    rms, lags = [], []
    for frame in range(3):
        inverse = 1 / _phone_map(wall, grey, frame)
        for top, left in np.ndindex(6, 8):
            window = inverse[24 + 24 * top :, 24 + 24 * left :][:24, :24].ravel()
            if len(window) == 24 * 24:
                r = (window - A @ np.linalg.lstsq(A, window)[0]).reshape(24, 24) * 0.6**2
                rms.append(r.std())
                lags.append([(r[:, k:] * r[:, :-k]).mean() / r.var() for k in (2, 4, 12)])
    near, middle, far = np.median(lags, 0)
    assert 0.6 * 1.7e-3 < np.median(rms) / 0.6 < 1.4 * 1.7e-3
    assert near > 0.75 and 0.4 < middle < 0.85 and far < 0.15
