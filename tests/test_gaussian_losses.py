"""What a picture of the model is held to, against the same written anew in double precision."""

import numpy as np
import pytest
from scipy.ndimage import correlate1d
from skimage.metrics import structural_similarity

from reconstruct.gaussians.losses import COVERED, Target, loss, ssim
from reconstruct.gaussians.rasteriser import Picture
from reconstruct.settings import GaussianSettings

SIZE = (19, 23)
SETTINGS = GaussianSettings(ssim=0.3, depth=0.7, mask=1.3)
UNIT = 0.4
BACKGROUND = np.float32([0.2, 0.9, 0.5])


def case(seed=0):
    """A picture of a model, and a target that it misses: some pixels without depth, some with something before them."""
    rng = np.random.default_rng(seed)
    alpha = rng.uniform(0, 1, SIZE)
    alpha[np.abs(alpha - COVERED) < 0.01] = 0.6
    depth = alpha * rng.uniform(0.9, 1.1, SIZE)
    picture = Picture(
        (alpha[..., None] * rng.uniform(0, 1, (*SIZE, 3))).astype(np.float32),
        depth.astype(np.float32),
        alpha.astype(np.float32),
        np.zeros(SIZE, np.float32),
    )
    mask = rng.random(SIZE) < 0.6
    target = Target(
        rng.uniform(0, 1, (*SIZE, 3)).astype(np.float32),
        np.where(mask & (rng.random(SIZE) < 0.7), rng.uniform(0.9, 1.1, SIZE), 0).astype(np.float32),
        mask,
        np.where(~mask & (rng.random(SIZE) < 0.6), rng.uniform(0.8, 1.3, SIZE), 0).astype(np.float32),
    )
    return picture, target


def hidden_by(picture, target):
    depth = picture.depth / picture.alpha
    return ~target.mask & (target.around > 0) & (target.around < depth) & (picture.alpha > COVERED)


def plain_ssim(x, y):
    """Per pixel (h, w, 3), black beyond the border."""
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    taps /= taps.sum()

    def mean(image):
        return correlate1d(correlate1d(image, taps, 0, mode="constant"), taps, 1, mode="constant")

    mx, my = mean(x), mean(y)
    vx, vy, c = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    return (2 * mx * my + 1e-4) * (2 * c + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))


def plain_loss(colour, depth, alpha, target, hidden, frozen):
    """The whole loss of float64 pictures; hidden pixels are as `frozen` (h, w, 3), by which nothing is derived."""
    seen = np.where(hidden[..., None], frozen, colour + (1 - alpha)[..., None] * BACKGROUND.astype(float))
    wanted = np.where(target.mask[..., None], target.colour.astype(float), BACKGROUND.astype(float))
    wanted = np.where(hidden[..., None], frozen, wanted)
    s = SETTINGS
    rgb = (1 - s.ssim) * np.abs(seen - wanted).mean() + s.ssim * (1 - plain_ssim(seen, wanted).mean())
    given = (target.depth > 0) & (alpha > COVERED)
    far = np.abs(depth / alpha - target.depth)[given].sum() / alpha.size / UNIT
    outline = np.where(hidden, 0, np.abs(alpha - target.mask)).mean()
    return np.array([rgb, far, outline])


def differences(function, at, by, step=1e-6):
    """Central, of `function` at the float64 arrays `at`, by the one called `by`."""
    found = np.zeros_like(at[by])
    for k in np.ndindex(found.shape):
        ends = []
        for sign in (1, -1):
            moved = {name: value.copy() for name, value in at.items()}
            moved[by][k] += sign * step
            ends.append(function(**moved))
        found[k] = (ends[0] - ends[1]) / (2 * step)
    return found


def test_similarity_is_that_of_scikit_image():
    rng = np.random.default_rng(1)
    x, y = (np.pad(rng.random((*SIZE, 3)).astype(np.float32), ((10, 10), (10, 10), (0, 0))) for _ in range(2))
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0}
    _, everywhere = structural_similarity(x.astype(float), y.astype(float), channel_axis=2, full=True, **options)
    inside = np.s_[10:-10, 10:-10]
    value, _ = ssim(x[inside], y[inside])
    assert value == pytest.approx(everywhere[inside].mean(), abs=1e-6)
    assert ssim(x, x)[0] == pytest.approx(1, abs=1e-6)


def test_the_loss_and_its_derivatives():
    picture, target = case()
    hidden = hidden_by(picture, target)
    assert 20 < hidden.sum() < 0.5 * hidden.size
    at = {name: getattr(picture, name).astype(float) for name in ("colour", "depth", "alpha")}
    frozen = at["colour"] + (1 - at["alpha"])[..., None] * BACKGROUND
    s = SETTINGS
    found = loss(picture, target, BACKGROUND, UNIT, s)
    expected = plain_loss(**at, target=target, hidden=hidden, frozen=frozen)
    np.testing.assert_allclose([found.rgb, found.depth, found.mask], expected, rtol=1e-5)

    def whole(**pictures):
        return plain_loss(**pictures, target=target, hidden=hidden, frozen=frozen) @ [1, s.depth, s.mask]

    for name in at:
        d, difference = getattr(found, f"d_{name}"), differences(whole, at, name)
        assert d.dtype == np.float32 and d.shape == difference.shape
        assert np.abs(d - difference).max() < 1e-3 * np.abs(difference).max(), name
