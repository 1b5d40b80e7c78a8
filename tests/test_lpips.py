"""`leaderboard.lpips`: the distance against one written out by hand, and its weights as strangers' files."""

import json

import numpy as np
import pytest
from command_line import run_command
from refusal import assert_refused

from leaderboard.lpips import _LAYERS, _PLACES, _SCALE, _SHIFT, Lpips

torch = pytest.importorskip("torch")
RNG = np.random.default_rng(0)
PICTURES = RNG.integers(0, 256, (2, 64, 80, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Weights of the published names and shapes, drawn at random."""
    folder, generator = tmp_path_factory.mktemp("weights"), torch.Generator().manual_seed(0)
    features, linear = {}, {}
    for k, ((out, into, side), place) in enumerate(zip(_LAYERS, _PLACES, strict=True)):
        size = (out, into, side, side)
        features[f"features.{place}.weight"] = torch.randn(size, generator=generator) / (into * side**2) ** 0.5
        features[f"features.{place}.bias"] = 0.1 * torch.randn(out, generator=generator)
        linear[f"lin{k}.model.1.weight"] = torch.rand((1, out, 1, 1), generator=generator)
    torch.save(features, folder / "alexnet.pth")
    torch.save(linear, folder / "linear.pth")
    return folder / "alexnet.pth", folder / "linear.pth"


def test_the_distance_is_that_of_the_paper(files):
    """AlexNet as torchvision builds it, in torch's own modules, and equation 1 of the paper."""
    nn, weights, linear = torch.nn, torch.load(files[0]), torch.load(files[1])
    network = nn.Sequential(
        nn.Conv2d(3, 64, 11, 4, 2), nn.ReLU(), nn.MaxPool2d(3, 2), nn.Conv2d(64, 192, 5, padding=2), nn.ReLU(),
        nn.MaxPool2d(3, 2), nn.Conv2d(192, 384, 3, padding=1), nn.ReLU(), nn.Conv2d(384, 256, 3, padding=1),
        nn.ReLU(), nn.Conv2d(256, 256, 3, padding=1), nn.ReLU(),
    )  # fmt: skip
    network.load_state_dict({name.removeprefix("features."): value for name, value in weights.items()})
    layers = []
    for picture in PICTURES:
        x = torch.tensor((picture / 255.0 * 2 - 1 - _SHIFT) / _SCALE).permute(2, 0, 1)[None].float()
        outputs = []
        for module in network:
            x = module(x).detach()
            if isinstance(module, nn.ReLU):
                outputs.append((x / (x.norm(dim=1, keepdim=True) + 1e-10))[0])
        layers.append(outputs)
    expected = sum(
        float((linear[f"lin{k}.model.1.weight"][0] * (a - b) ** 2).sum(0).mean())
        for k, (a, b) in enumerate(zip(*layers, strict=True))
    )
    measured = Lpips(*files)
    assert measured.distance(*PICTURES) == pytest.approx(expected, rel=1e-4)
    assert measured.distance(PICTURES[0], PICTURES[0]) == 0


def test_the_command_prices_a_missing_view_as_an_empty_one(files, data, tmp_path, monkeypatch, capsys):
    from adapters_case import truth_of
    from synthetic_case import truth_as_answer

    from freeart21.files.result import write_result

    monkeypatch.setattr("leaderboard.lpips._find_linear", lambda: files[1])
    for name in "ab":
        write_result(tmp_path / "r" / name, truth_as_answer(truth_of(name)))
    out = tmp_path / "l.json"
    code, shown, errors = run_command(
        capsys, "lpips", tmp_path / "r", "--data", data, "--alexnet", files[0], "--out", out
    )
    assert code == 0, errors
    found = json.loads(out.read_text())["sequences"]
    assert set(found) == {"a", "b", "c"} and all(value > 0 for value in found.values())
    assert f"{found['a']:.4f}" in shown


def test_files_that_are_no_weights_are_refused_in_one_line(files, tmp_path):
    (tmp_path / "x.pth").write_bytes(b"junk")
    assert_refused("x.pth holds no weights", Lpips, tmp_path / "x.pth", files[1])
    assert_refused("'features.0.weight' is nothing, expected 64 x 3 x 11 x 11", Lpips, files[1], files[1])
