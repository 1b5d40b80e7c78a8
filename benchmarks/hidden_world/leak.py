"""Whether anything but the measurement itself tells what is hidden: simple classifiers on names, sizes, lengths and
metadata, cross-validated. They must be at chance.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def features(folder: Path) -> NDArray[np.float64]:
    """(k,) all that can be known of a case without its readings; for one rig and type of joint, k is the same."""
    found = [float(int(letter, 16)) for letter in folder.name]
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        found += [float(path.stat().st_size), float(len(str(path.relative_to(folder))))]
        if path.suffix == ".csv":
            lines = path.read_text().splitlines()
            found += [float(len(lines)), float(len(lines[0])), float(len(lines[1]))]
        elif path.suffix == ".json":
            found += _numbers(json.loads(path.read_text()))
        elif path.suffix == ".urdf":
            found += [float(n) for n in _NUMBER.findall(path.read_text().split("?>", 1)[1])]
    return np.array(found)


def _numbers(value: object) -> list[float]:
    if isinstance(value, dict):
        return [n for v in value.values() for n in _numbers(v)]
    if isinstance(value, list):
        return [n for v in value for n in _numbers(v)]
    return [float(value)] if isinstance(value, int | float) else [float(len(str(value)))]


def _standard(x: NDArray[np.float64]) -> NDArray[np.float64]:
    spread = x.std(0)
    return np.asarray((x - x.mean(0))[:, spread > 0] / spread[spread > 0])


def logistic(train: NDArray[np.float64], y: NDArray[np.int64], test: NDArray[np.float64]) -> NDArray[np.int64]:
    """Classes of `test` by ridged multinomial logistic regression, by gradient descent."""
    k = int(y.max()) + 1
    weights = np.zeros((train.shape[1] + 1, k))
    X = np.column_stack([train, np.ones(len(train))])
    share = 1.0 / np.bincount(y, minlength=k)[y]
    for _ in range(300):
        score = X @ weights
        p = np.exp(score - score.max(1, keepdims=True))
        p = p / p.sum(1, keepdims=True)
        p[np.arange(len(y)), y] -= 1
        weights -= 0.3 * (X.T @ (p * share[:, None]) + 1e-2 * weights)
    return np.asarray((np.column_stack([test, np.ones(len(test))]) @ weights).argmax(1))


def nearest(train: NDArray[np.float64], y: NDArray[np.int64], test: NDArray[np.float64]) -> NDArray[np.int64]:
    """Classes of `test` by their five nearest neighbours, classes counting alike."""
    k = int(y.max()) + 1
    share = 1.0 / np.bincount(y, minlength=k)
    distance = (test**2).sum(1)[:, None] - 2 * test @ train.T + (train**2).sum(1)
    votes = np.zeros((len(test), k))
    for row, neighbours in enumerate(np.argsort(distance, axis=1)[:, :5]):
        np.add.at(votes[row], y[neighbours], share[y[neighbours]])
    return np.asarray(votes.argmax(1))


def accuracy(x: NDArray[np.float64], y: NDArray[np.int64], classify, folds: int = 5, seed: int = 0) -> float:
    """Balanced accuracy of a classifier, cross-validated."""
    x = _standard(x)
    part = np.random.default_rng(seed).permutation(len(y)) % folds
    said = np.empty(len(y), int)
    for fold in range(folds):
        said[part == fold] = classify(x[part != fold], y[part != fold], x[part == fold])
    return float(np.mean([np.mean(said[y == c] == c) for c in np.unique(y)]))


def p_value(x: NDArray[np.float64], y: NDArray[np.int64], classify, rounds: int = 99) -> float:
    """How often labels dealt out anew are guessed as well."""
    rng = np.random.default_rng(1)
    real = accuracy(x, y, classify)
    dealt = [accuracy(x, rng.permutation(y), classify) for _ in range(rounds)]
    return float((1 + np.sum(np.array(dealt) >= real)) / (rounds + 1))
