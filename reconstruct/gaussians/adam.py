"""Adam (Kingma and Ba 2015) over the Gaussians that a frame shows; the others keep their moments."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from freeart21.se3 import Bools, Floats
from reconstruct.gaussians.model import Parameters
from reconstruct.kernels import run_in_threads

BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-15
"""Of 3D Gaussian splatting (Kerbl et al. 2023)."""


class Adam:
    """Steps `Parameters` in place. Each Gaussian has its own step count, since not every frame shows it."""

    def __init__(self, parameters: Parameters) -> None:
        self.first, self.second = parameters.zeros(), parameters.zeros()
        self.steps = np.zeros(len(parameters), np.int32)
        self.light_steps = np.zeros(1, np.int32)

    def step(
        self, parameters: Parameters, gradient: dict[str, Floats], shown: NDArray[np.bool_], rates: dict[str, float]
    ) -> None:
        """One step of the Gaussians `shown` (N,), and of the light, at `rates` by name."""
        self.steps += shown
        self.light_steps += 1
        everywhere = np.ones(1, bool)
        of_rows, of_light = _corrections(self.steps, shown), _corrections(self.light_steps, everywhere)
        for name, values in parameters.arrays().items():
            if rates[name] == 0:
                continue
            rows, corrections = (everywhere, of_light) if name == "light" else (shown, of_rows)
            n = len(rows)
            flat = [
                a.reshape(n, -1)
                for a in (values, gradient[name], getattr(self.first, name), getattr(self.second, name))
            ]
            run_in_threads(partial(_step_some, (*flat, rows, corrections, np.float32(rates[name]))), n, 2000)

    def select(self, which: NDArray[np.int64], fresh: NDArray[np.bool_]) -> None:
        """Continue with the Gaussians `which` (M,); the moments of `fresh` (M,) ones start from zero."""
        for moments in (self.first, self.second):
            for name, values in moments.arrays().items():
                if name != "light":
                    taken = values[which]
                    taken[fresh] = 0
                    setattr(moments, name, taken)
        self.steps = np.where(fresh, 0, self.steps[which]).astype(np.int32)


def _step_some(arguments: tuple[Any, ...], begin: int, end: int) -> None:
    _step(begin, end, *arguments)


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _corrections(steps: NDArray[np.int32], shown: Bools) -> Floats:  # pragma: no cover
    """(n, 2) factors of both moments after so many steps, where `shown`."""
    one, beta1, beta2 = np.float32(1), np.float32(BETA1), np.float32(BETA2)
    found = np.ones((len(steps), 2), np.float32)
    for n in range(len(steps)):
        if shown[n]:
            found[n, 0], found[n, 1] = one / (one - beta1 ** steps[n]), one / (one - beta2 ** steps[n])
    return found


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"contract"})
def _step(
    begin: int, end: int, values: Floats, gradient: Floats, first: Floats, second: Floats, shown: Bools,
    corrections: Floats, rate: Floats,
) -> None:  # pragma: no cover  # fmt: skip
    one, beta1, beta2 = np.float32(1), np.float32(BETA1), np.float32(BETA2)
    for n in range(begin, end):
        if not shown[n]:
            continue
        correction1, correction2 = rate * corrections[n, 0], corrections[n, 1]
        for k in range(values.shape[1]):
            g = gradient[n, k]
            first[n, k] = beta1 * first[n, k] + (one - beta1) * g
            second[n, k] = beta2 * second[n, k] + (one - beta2) * g * g
            root = math.sqrt(second[n, k] * correction2) + np.float32(EPSILON)
            values[n, k] -= correction1 * first[n, k] / root
