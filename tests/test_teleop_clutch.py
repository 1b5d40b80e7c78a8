"""The maths of carrying by a controller, run in Chromium, against SE(3) in Python."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import headset_rig
import numpy as np
import pytest
from browser import Browser, browser

from freeart21 import se3

pytestmark = pytest.mark.skipif(not headset_rig.HAS_BROWSER, reason="needs Chromium")
UP_IS_MINUS_Y = np.diag([1.0, -1.0, -1.0])
"""Camera axes from those of a room whose forward is the camera's."""


@pytest.fixture(scope="module")
def page() -> Iterator[Browser]:
    with headset_rig.served() as address, browser() as shown:
        shown.open(address, ready="true")
        shown.run("import('/clutch.js').then((m) => { window.m = m; })")
        yield shown


def as_json(T: np.ndarray) -> str:
    return json.dumps({"position": T[:3, 3].tolist(), "quaternion": se3.wxyz(T).tolist()})


def pose(data: dict[str, Any]) -> np.ndarray:
    return se3.pose_from_wxyz(data["position"], data["quaternion"])


def some(rng: np.random.Generator, n: int) -> np.ndarray:
    return se3.exp_se3(rng.normal(size=(n, 6)))


def head(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """Rotation of a head that is turned to the left by `yaw`, then looks up by `pitch`."""
    return se3.exp_so3([0, yaw, 0]) @ se3.exp_so3([pitch, 0, 0]) @ se3.exp_so3([0, 0, roll])


def to_camera(page: Browser, R_head: np.ndarray) -> np.ndarray:
    q = page.run(f"m.roomToCamera(m.heading({se3.wxyz(R_head).tolist()}))")
    return se3.rotation_from_wxyz(q)


def carried(page: Browser, grasps: list[np.ndarray], T_object: np.ndarray, pivot: list[float], R: np.ndarray) -> list:
    """The object's poses (4, 4) while each row of `grasps` (n, 4, 4), a controller's way, is one grasp."""
    script = (
        f"(() => {{ const clutch = new m.Clutch({pivot}); const turn = {se3.wxyz(R).tolist()}; const out = [];"
        f"let object = {as_json(T_object)};"
        f"for (const way of [{','.join('[' + ','.join(map(as_json, way)) + ']' for way in grasps)}]) {{"
        "  clutch.grasp(object, way[0], turn);"
        "  for (const one of way) { object = clutch.carried(one); out.push(object); }"
        "  clutch.release(); }"
        "return out; })()"
    )
    return [pose(one) for one in page.run(script)]


@pytest.mark.parametrize("pitch", [0.0, 0.5, 1.2, -1.2, -1.5])
@pytest.mark.parametrize("yaw", [0.0, 1.0, np.pi, -2.0])
def test_right_is_right_up_is_up_and_away_is_away_however_one_stands(page: Browser, yaw: float, pitch: float) -> None:
    R = to_camera(page, head(yaw, pitch, roll=0.2))
    level = se3.exp_so3([0, yaw, 0])
    for in_person, in_camera in (((1, 0, 0), (1, 0, 0)), ((0, 1, 0), (0, -1, 0)), ((0, 0, -1), (0, 0, 1))):
        seen = R @ level @ np.array(in_person, float)
        # a head that is tilted does not face quite where it stands: 0.2 rad of roll at most
        assert np.dot(seen, in_camera) > (1 - 1e-9 if pitch == 0 else np.cos(0.25))
    np.testing.assert_allclose(R @ [0, 1, 0], [0, -1, 0], atol=1e-12)  # upright stays upright


def test_an_object_goes_and_turns_as_the_controller_does_about_its_own_centre(page: Browser) -> None:
    rng = np.random.default_rng(0)
    for yaw in (0.0, 0.7, -2.5):
        R = to_camera(page, head(yaw))
        np.testing.assert_allclose(R, UP_IS_MINUS_Y @ se3.exp_so3([0, -yaw, 0]), atol=1e-12)
        T_object, way, pivot = some(rng, 1)[0], some(rng, 6), rng.normal(size=3) * 0.1
        for T, C in zip(carried(page, [way], T_object, pivot.tolist(), R), way, strict=True):
            turn = R @ C[:3, :3] @ way[0, :3, :3].T @ R.T
            np.testing.assert_allclose(T[:3, :3], turn @ T_object[:3, :3], atol=1e-12)
            moved = se3.transform(T, pivot[None])[0] - se3.transform(T_object, pivot[None])[0]
            np.testing.assert_allclose(moved, R @ (C[:3, 3] - way[0, :3, 3]), atol=1e-12)


def test_nothing_jumps_and_grasps_add_up(page: Browser) -> None:
    rng = np.random.default_rng(1)
    R, T_object, pivot = to_camera(page, head(0.4)), some(rng, 1)[0], [0.05, -0.02, 0.1]
    step = se3.pose(se3.exp_so3([0.0, 0.0, np.radians(10)]), [0.01, 0.0, 0.0])
    grasps, whole = [], [some(rng, 1)[0]]
    for _ in range(12):  # each grasp turns by 90 degrees, from wherever the hand has come back to
        way = [some(rng, 1)[0]]
        for _ in range(9):
            turned = se3.pose(step[:3, :3] @ way[-1][:3, :3], way[-1][:3, 3] + step[:3, 3])
            way.append(turned)
            whole.append(se3.pose(step[:3, :3] @ whole[-1][:3, :3], whole[-1][:3, 3] + step[:3, 3]))
        grasps.append(np.array(way))
    pieces = carried(page, grasps, T_object, pivot, R)
    np.testing.assert_allclose(pieces[0], T_object, atol=1e-12)
    for k in range(1, len(grasps)):  # a grasp begins where the last one ended
        np.testing.assert_allclose(pieces[10 * k], pieces[10 * k - 1], atol=1e-12)
    one = carried(page, [np.array(whole)], T_object, pivot, R)
    np.testing.assert_allclose(pieces[-1], one[-1], atol=1e-9)  # three whole turns in twelve grasps
    centres = se3.transform(np.array(pieces), np.array([pivot]))[:, 0]
    np.testing.assert_allclose(np.linalg.norm(centres[-1] - centres[0]), 12 * 9 * 0.01, atol=1e-9)


def test_an_hour_of_grasps_keeps_a_quaternion_one(page: Browser) -> None:
    rng = np.random.default_rng(2)
    last = carried(page, [some(rng, 2) for _ in range(2000)], some(rng, 1)[0], [0, 0, 0], np.eye(3))[-1]
    np.testing.assert_allclose(last[:3, :3] @ last[:3, :3].T, np.eye(3), atol=1e-12)


# --- the joint --------------------------------------------------------------------------------------------------------


def moved(page: Browser, steps: list[tuple[float, float]], state: float, limits: tuple[float, float], dt: float = 0.01):
    """States (n,) after each of `steps` (stick, trigger), of one grip."""
    return np.array(
        page.run(
            f"(() => {{ const grip = new m.JointGrip(); let state = {state};"
            f"return {json.dumps(steps)}.map(([stick, trigger]) => "
            f"(state = grip.moved(state, stick, trigger, {list(limits)}, {dt}))); }})()"
        )
    )


LIMITS = (-0.2, 1.8)


def test_a_stick_is_a_speed_with_rest_and_stops_at_the_ends(page: Browser) -> None:
    assert np.ptp(moved(page, [(0.2, 0), (-0.2, 0)] * 20, 0.5, LIMITS)) == 0
    away = moved(page, [(-1.0, 0)] * 80, 0.0, LIMITS)  # pushed away, to the upper end: two ranges a second
    np.testing.assert_allclose(np.diff(away[:40]), 2 * 2 * 0.01, atol=1e-12)
    assert away[-1] == 1.8 and moved(page, [(1.0, 0)] * 80, 0.0, LIMITS)[-1] == -0.2
    half = np.diff(moved(page, [(-0.62, 0)] * 10, 0.0, LIMITS))
    np.testing.assert_allclose(half, 0.25 * 2 * 2 * 0.01, atol=1e-12)  # squared beyond its rest


@pytest.mark.parametrize(("state", "end"), [(0.1, 1.8), (1.5, -0.2)])
def test_a_trigger_is_a_place_from_where_the_joint_was_to_its_farther_end_and_back(
    page: Browser, state: float, end: float
) -> None:
    pull = np.concatenate([np.zeros(3), np.linspace(0, 1, 100), np.ones(10), np.linspace(1, 0, 100), np.zeros(3)])
    states = moved(page, [(0.0, float(v)) for v in pull], state, LIMITS)
    assert states[105] == pytest.approx(end) and states[-1] == pytest.approx(state)
    share = np.clip((pull[3:103] - 0.12) / 0.88, 0, 1)
    np.testing.assert_allclose(states[3:103], state + share * (end - state), atol=1e-9)


def test_a_trigger_that_snaps_moves_no_faster_than_a_hand(page: Browser) -> None:
    snapped = [(0.0, 0.0)] + [(0.0, 1.0)] * 40 + [(0.0, 0.0)] * 40
    states = moved(page, snapped, 0.0, LIMITS)
    assert np.abs(np.diff(states)).max() <= 4 * 2 * 0.01 + 1e-12
    assert states[40] == pytest.approx(1.8) and states[-1] == pytest.approx(0.0)


def test_a_trigger_means_nothing_until_it_was_let_go(page: Browser) -> None:
    assert np.ptp(moved(page, [(0.0, 0.8)] * 20, 0.5, LIMITS)) == 0
    late = moved(page, [(0.0, 0.8)] * 5 + [(0.0, 0.0)] + [(0.0, 1.0)] * 40, 0.5, LIMITS)
    assert late[5] == 0.5 and late[-1] == pytest.approx(1.8)


def test_a_button_is_short_or_held_once_and_silent_after_a_drop(page: Browser) -> None:
    def heard(pressed: str, longest: str = "1") -> list[str | None]:
        """Of a state each half second."""
        steps = json.dumps([c == "#" for c in pressed])
        return page.run(
            f"(() => {{ const b = new m.Button({longest}); return {steps}.map((p, k) => b.step(p, k / 2)); }})()"
        )

    assert heard(".#..") == [None, "press", "short", None]
    assert heard(".######.") == [None, "press", None, "long", None, None, None, None]
    assert heard("##.") == [None, None, None]  # pressed before anybody listened
    assert heard(".####.#", "undefined") == [None, "press", None, None, None, "short", "press"]
