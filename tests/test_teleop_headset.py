"""A headset with two controllers, emulated in Chromium, as PICO and as Quest: carrying, the joint, buttons, losses."""

from __future__ import annotations

import contextlib
import functools
import ipaddress
import json
from collections.abc import Callable, Iterator

import headset_rig
import numpy as np
import pytest
from browser import Browser, browser
from headset_rig import GRIP, Rig

from freeart21 import se3
from generator.teleop.certificate import local_addresses

pytestmark = pytest.mark.skipif(not headset_rig.HAS_IWER, reason="needs Chromium and iwer, see CONTRIBUTING.md")
both = pytest.mark.parametrize("rig", ["pico", "quest"], indirect=True)
OTHER = {"left": "right", "right": "left"}
CENTRE = np.array([0.01, -0.02, 0.03])
TO_CAMERA = np.diag([1.0, -1.0, -1.0])  # of a person who looks along the room's -z
REST = {side: se3.pose(np.eye(3), [x, 1.2, -0.4]) for side, x in (("left", -0.25), ("right", 0.25))}


@pytest.fixture(scope="module")
def pages() -> Iterator[Callable[[str], tuple[Browser, str]]]:
    """A page in each headset that is asked for."""
    with contextlib.ExitStack() as open_ones:
        address = open_ones.enter_context(headset_rig.served())

        @functools.cache
        def page(name: str) -> tuple[Browser, str]:
            shown = open_ones.enter_context(browser())
            headset_rig.emulate(shown, name)
            return shown, address

        yield page


@pytest.fixture
def rig(request: pytest.FixtureRequest, pages: Callable[[str], tuple[Browser, str]]) -> Iterator[Rig]:
    shown, address = pages(getattr(request, "param", "pico"))
    shown.errors.clear()
    shown.open(address, 320, 240, ready="true")  # small: both eyes are drawn without a GPU
    shown.run(headset_rig.ALONE)
    made = Rig(shown)
    for side, T in REST.items():
        made.pose(side, T)
    made.enter()
    yield made
    assert not shown.errors


def expected(T_object: np.ndarray, side: str, before: np.ndarray, after: np.ndarray, R: np.ndarray) -> np.ndarray:
    """The object's pose after a controller that carries it went from `before` to `after` (4, 4) in the room."""
    a, b = before @ GRIP[side], after @ GRIP[side]
    turn = R @ b[:3, :3] @ a[:3, :3].T @ R.T @ T_object[:3, :3]
    centre = se3.transform(T_object, CENTRE[None])[0] + R @ (b[:3, 3] - a[:3, 3])
    return se3.pose(turn, centre - turn @ CENTRE)


def moved(rig: Rig, side: str, before: np.ndarray, twist: list[float], steps: int = 5) -> np.ndarray:
    """Move a controller (v in the room, m; w in its own frame, rad) in some steps; where it is then."""
    after = before
    for k in range(1, steps + 1):
        v, w = np.array(twist[:3]) * k / steps, np.array(twist[3:]) * k / steps
        after = se3.pose(before[:3, :3] @ se3.exp_so3(w), before[:3, 3] + v)
        rig.pose(side, after)
        rig.frames(1)
    rig.frames(2)
    return after


@both
@pytest.mark.parametrize("side", ["right", "left"])
def test_whoever_squeezes_carries_and_grasps_add_up(rig: Rig, side: str) -> None:
    T, state = rig.object()
    at = REST[side]
    at = moved(rig, side, at, [0.1, 0, 0, 0, 0.5, 0])
    np.testing.assert_array_equal(rig.object()[0], T)  # nobody squeezes
    for twist in ([0.05, 0.03, -0.04, 0.3, 0.9, -0.2], [0, 0, 0, 0, 1.0, 0], [-0.02, 0.01, 0.06, -0.5, 0, 0.7]):
        rig.press(side, "squeeze", 1)
        rig.frames()
        np.testing.assert_allclose(rig.object()[0], T, atol=1e-9)  # nothing jumps
        after = moved(rig, side, at, twist)
        T = expected(T, side, at, after, TO_CAMERA)
        np.testing.assert_allclose(rig.object()[0], T, atol=1e-5)  # iwer's poses are of single precision
        T = rig.object()[0]
        rig.press(side, "squeeze", 0)
        rig.frames()
        at = moved(rig, side, after, [-0.1, 0.2, 0.1, 1, -1, 0.5])  # back for another grasp
        np.testing.assert_allclose(rig.object()[0], T, atol=1e-9)
    assert rig.object()[1] == state
    ways = np.array([one["position"] for one in rig.page.run("sent")])
    assert np.linalg.norm(np.diff(ways, axis=0), axis=1).max() < 0.06  # no step is longer than the hand's


@both
def test_who_has_turned_round_presses_the_stick_and_right_is_right_again(rig: Rig) -> None:
    yaw = se3.exp_so3([0, 2.0, 0])
    rig.head(se3.pose(yaw @ se3.exp_so3([-0.4, 0, 0]), [0.3, 1.7, 0.2]))
    rig.press("right", "squeeze", 1)
    rig.frames()
    T, _ = rig.object()
    rig.press("left", "thumbstick", 1)
    rig.frames()
    rig.press("left", "thumbstick", 0)
    np.testing.assert_allclose(rig.object()[0], T, atol=1e-9)  # even while it is carried, nothing jumps
    moved(rig, "right", REST["right"], [*(yaw @ [0.1, 0.05, -0.07]), 0, 0, 0])
    np.testing.assert_allclose(rig.object()[0][:3, 3] - T[:3, 3], [0.1, -0.05, 0.07], atol=1e-6)
    panel = rig.page.run("headset().room.panel")
    height = 1.7 if rig.page.run("headset().floor") else 0.1  # above where the head was, for who knows no floor
    np.testing.assert_allclose(panel["position"], np.array([0.3, height, 0.2]) + yaw @ [0, 0, -1.5], atol=1e-6)


@both
@pytest.mark.parametrize("side", ["right", "left"])
def test_the_other_hand_s_stick_and_trigger_move_the_joint_and_the_carrier_s_do_not(rig: Rig, side: str) -> None:
    rig.press(side, "squeeze", 1)
    rig.frames()
    T, state = rig.object()
    rig.stick(side, 0, -1)
    rig.press(side, "trigger", 1)
    rig.frames(5)
    assert rig.object()[1] == state
    states = [state]
    for y in (-1, 1):  # pushed away, pulled near
        rig.stick(OTHER[side], 0, y)
        rig.frames()
        rig.stick(OTHER[side], 0, 0)
        rig.frames()
        states.append(rig.object()[1])
    assert states[1] > max(states[0], states[2])
    start_state = states[2]
    rig.press(OTHER[side], "trigger", 1)
    rig.until("Math.min(hand.state - 0.1, 1.3 - hand.state) < 1e-9")
    rig.press(OTHER[side], "trigger", 0)
    rig.until(f"Math.abs(hand.state - {start_state}) < 1e-9")
    np.testing.assert_allclose(rig.object()[0], T, atol=1e-9)


def test_from_hand_to_hand_nothing_jumps(rig: Rig) -> None:
    rig.press("left", "squeeze", 1)
    rig.frames()
    rig.press("right", "squeeze", 1)
    rig.frames()
    T, _ = rig.object()
    moved(rig, "right", REST["right"], [0.2, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(rig.object()[0], T, atol=1e-9)  # the first carries
    rig.press("left", "squeeze", 0)
    rig.frames()
    np.testing.assert_allclose(rig.object()[0], T, atol=1e-9)
    moved(rig, "left", REST["left"], [0, 0.3, 0, 0, 0, 0])
    np.testing.assert_allclose(rig.object()[0], T, atol=1e-9)
    at = se3.pose(np.eye(3), REST["right"][:3, 3] + [0.2, 0, 0])
    moved(rig, "right", at, [0.05, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(rig.object()[0][:3, 3] - T[:3, 3], [0.05, 0, 0], atol=1e-6)


def _out_of_sight(rig: Rig) -> None:
    rig.set_visible("right", False)
    rig.frames()


def _guessed(rig: Rig) -> None:
    rig.page.run("device.controllers.right.inputSource.gripSpace[IWER.P_SPACE].emulated = true")
    rig.frames()


@pytest.mark.parametrize("lose", [_out_of_sight, _guessed])
def test_a_controller_that_is_lost_lets_go_and_has_to_squeeze_again(rig: Rig, lose) -> None:
    back = "device.controllers.right.inputSource.gripSpace[IWER.P_SPACE].emulated = false"
    rig.page.run(back)
    rig.press("right", "squeeze", 1)
    rig.frames()
    at = moved(rig, "right", REST["right"], [0.05, 0, 0, 0, 0, 0])
    T, state = rig.object()
    lose(rig)
    at = moved(rig, "right", at, [0.3, 0.3, 0, 0, 2, 0])
    rig.set_visible("right", True)
    rig.page.run(back)
    at = moved(rig, "right", at, [0.1, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(rig.object()[0], T, atol=1e-12)
    assert rig.object()[1] == state
    rig.press("right", "squeeze", 0)
    rig.frames()
    rig.press("right", "squeeze", 1)
    rig.frames()
    moved(rig, "right", at, [0.02, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(rig.object()[0][:3, 3] - T[:3, 3], [0.02, 0, 0], atol=1e-6)


def test_one_controller_alone_does_both(rig: Rig) -> None:
    rig.set_visible("left", False)
    rig.press("right", "squeeze", 1)
    rig.frames()
    state = rig.object()[1]
    rig.stick("right", 0, -1)
    rig.frames(5)
    assert rig.object()[1] > state


def test_an_undo_while_it_is_carried_is_carried_on_from_there(rig: Rig) -> None:
    rig.press("right", "squeeze", 1)
    rig.press("left", "trigger", 1)
    rig.frames()
    at = moved(rig, "right", REST["right"], [0.05, 0, 0, 0, 0.4, 0])
    rig.until("hand.state > 1.3 - 1e-9")
    placed = se3.pose(se3.exp_so3([0.1, 0.2, 0.3]), [0.03, 0.02, 0.7])
    rig.page.run(
        f"hand.place({{position: {placed[:3, 3].tolist()}, quaternion: {se3.wxyz(placed).tolist()}, state: 0.5}}, 1)"
    )
    rig.frames()
    np.testing.assert_allclose(rig.object()[0], placed, atol=1e-9)
    rig.frames()
    assert rig.object()[1] == 0.5  # although the trigger is still pulled
    after = moved(rig, "right", at, [0, 0.04, 0, 0.2, 0, 0])
    np.testing.assert_allclose(rig.object()[0], expected(placed, "right", at, after, TO_CAMERA), atol=1e-5)


BUTTONS = {"left": ("x-button", "y-button"), "right": ("a-button", "b-button")}


@both
@pytest.mark.parametrize("side", ["right", "left"])
def test_buttons_of_either_hand_record_pause_undo_and_save(rig: Rig, side: str) -> None:
    record, undo = BUTTONS[side]

    def press(button: str, frames: int = 2) -> list[str]:
        rig.press(side, button, 1)
        rig.frames(frames)
        rig.press(side, button, 0)
        rig.frames(2)
        return rig.take_messages()

    assert press(record) == ["record"]
    rig.page.run("link.status.recording = true")
    assert press(undo) == ["undo"]
    assert press(record) == ["pause"]
    for recording, wanted in ((True, ["pause", "save"]), (False, ["save"])):
        rig.page.run(f"link.status.recording = {json.dumps(recording)}")
        rig.press(side, record, 1)
        rig.page.run("new Promise((done) => setTimeout(done, 1050))")
        rig.frames(3)
        assert rig.take_messages() == wanted
        rig.press(side, record, 0)
        rig.frames()
        assert rig.take_messages() == []


@pytest.mark.parametrize("state", ["hidden", "visible-blurred"])
def test_the_headset_s_menu_pauses_and_lets_go(rig: Rig, state: str) -> None:
    rig.page.run("link.status.recording = true")
    rig.press("right", "squeeze", 1)
    rig.frames()
    T, _ = rig.object()
    rig.page.run(f"device.updateVisibilityState('{state}')")
    rig.page.run("new Promise((done) => setTimeout(done, 200))")
    assert rig.take_messages() == ["pause"]
    rig.page.run("link.status.recording = false")
    rig.pose("right", se3.pose(np.eye(3), [0.6, 1.5, -0.7]))
    rig.page.run("new Promise((done) => setTimeout(done, 100))")
    rig.page.run("device.updateVisibilityState('visible')")
    rig.frames(5)
    np.testing.assert_allclose(rig.object()[0], T, atol=1e-12)


def test_a_session_that_ends_pauses_and_another_can_begin(rig: Rig) -> None:
    rig.page.run("link.status.recording = true")
    rig.press("right", "squeeze", 1)
    rig.frames()
    words = rig.page.run("document.querySelector('#headset').textContent")
    assert rig.page.run("link.immersive")
    rig.page.run("headset().session.end()")
    assert not rig.page.run("link.immersive")
    assert rig.take_messages() == ["pause"]
    assert words == "Leave headset"
    assert rig.page.run("viewed") == [[1280, 720], [300, 200]]
    assert rig.page.run("[now.session, document.querySelector('#headset').textContent]") == [None, "Enter headset"]
    T, _ = rig.object()
    rig.pose("right", se3.pose(np.eye(3), [0.6, 1.5, -0.7]))
    rig.enter()
    rig.frames(5)
    np.testing.assert_allclose(rig.object()[0], T, atol=1e-12)  # still squeezed: that means nothing


def test_who_only_watches_moves_nothing_and_a_line_that_breaks_lets_go(rig: Rig) -> None:
    rig.page.run("link.drives = false")
    T, _ = rig.object()
    rig.page.run("headset().room.tell = (facts) => { window.facts = facts; }")
    for state, line in (("open", "You watch."), ("lost", "It is tried again and again; a recording is paused.")):
        rig.page.run(f"link.state = '{state}'")
        rig.until(f"window.facts?.lines[1] === '{line}'")
    rig.press("right", "squeeze", 1)
    rig.press("right", "a-button", 1)
    rig.frames()
    rig.press("right", "a-button", 0)
    at = moved(rig, "right", REST["right"], [0.05, 0, 0, 0, 0, 0])
    assert rig.take_messages() == [] and rig.page.run("sent.length") == 0
    rig.page.run("link.drives = true")
    moved(rig, "right", at, [0.05, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(rig.object()[0], T)


@both
def test_the_picture_hangs_before_the_eyes(rig: Rig) -> None:
    rig.page.run(
        "(() => { const x = picture.getContext('2d'); x.fillStyle = '#00ff00'; x.fillRect(0, 0, 640, 360);"
        "x.fillStyle = '#ff0000'; x.fillRect(0, 0, 320, 180); link.shown(picture); })()"
    )
    rig.frames(3)
    look = """
    new Promise((done) => headset().session.requestAnimationFrame(() => {
      const { gl } = headset().room, { drawingBufferWidth: w, drawingBufferHeight: h } = gl;
      const at = (x, y) => {
        const pixel = new Uint8Array(4);
        gl.readPixels(Math.round(w * x), Math.round(h * y), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
        return [...pixel];
      };
      done([at(0.4, 0.6), at(0.6, 0.6), at(0.4, 0.4), at(0.5, 0.95)]);
    }))
    """
    upper_left, upper_right, lower_left, above = rig.page.run(look)
    assert upper_left[:3] == [255, 0, 0] and upper_right[:3] == [0, 255, 0] == lower_left[:3]
    assert max(above[:3]) < 40


# --- where there is none ----------------------------------------------------------------------------------------------


def test_without_a_headset_the_button_stays_hidden_and_without_https_it_says_why() -> None:
    others = [a for a in local_addresses() if "." in a and not ipaddress.ip_address(a).is_loopback]
    with browser() as page:
        for host in ("127.0.0.1", *others[:1]):
            with headset_rig.served(host) as address:
                page.open(address, ready="true")
                page.run(headset_rig.ALONE)
                button = "document.querySelector('#headset')"
                hidden, disabled, title = page.run(f"[{button}.hidden, {button}.disabled, {button}.title]")
                if host == "127.0.0.1":
                    assert hidden and not disabled
                else:
                    assert not hidden and disabled and "https" in title
