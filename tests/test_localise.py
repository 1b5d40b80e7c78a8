"""Localisation of a missing force on independent motions, and the false positive rate on noise."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from freeart21.joint import Joint
from freeart21.measured import Measured, Run
from freeart21.mechanics import JointMechanics
from simgap.models.equation_error import estimate_missing_force
from simgap.models.localise import flagged_regions, make_residual_maps

INERTIA, WEIGHT = 0.05, 1.2  # kg m^2, N m of m g l
MECHANICS = JointMechanics(
    Joint("j", "revolute", np.array([0.0, 1, 0]), np.zeros(3), -np.inf, np.inf),
    1.0,
    INERTIA,
    np.array([0.0, 0, -WEIGHT / 9.81]),
    np.array([0, 0, -9.81]),
)


def swings(torque, seed=0, runs=6, seconds=6.0, noise=5e-4, starts=None, restitution=None, stop=9.0):
    """Runs of a pendulum under `torque(t, q, qd)` besides gravity; at the stop it keeps `restitution` of its speed."""
    rng = np.random.default_rng(seed)
    made = []
    for r in range(runs):
        t = np.arange(round(200 * seconds)) / 200
        state = [rng.uniform(0.5, 1.2) if starts is None else starts[r], rng.uniform(-0.5, 0.5)]
        q, now = np.full(len(t), np.nan), 0.0
        while now < t[-1]:

            def slope(t, y):
                return [y[1], (torque(t, *y) - WEIGHT * np.sin(y[0])) / INERTIA]

            def met(t, y):
                return stop - y[0]

            met.terminal, met.direction = True, -1  # type: ignore[attr-defined]
            done = solve_ivp(slope, (now, t[-1]), state, events=met, dense_output=True, rtol=1e-7, atol=1e-9)
            here = (t >= now) & (t <= done.t[-1])
            q[here] = done.sol(t[here])[0]
            now = done.t[-1] + 1e-9
            state = [stop - 1e-9, -(restitution or 0) * done.y[1, -1]]
        made.append(Run(f"run_{r}", t, q + rng.normal(size=len(t)) * noise))
    return Measured("j", "revolute", np.array([0, 0, -9.81]), 200.0, "recorded", runs=tuple(made))


def maps_of(measured, effects=(), upper=9.0, **more):
    found = estimate_missing_force(measured, MECHANICS, -9.0, upper, effects, **more)
    maps = make_residual_maps(found)
    return {m.quantity: m for m in maps}, flagged_regions(maps, found, "revolute"), found


def friction(t, q, qd):
    return -0.02 * np.tanh(qd / 0.01)


def notch(t, q, qd):
    x = (q - 0.35) / 0.06
    return -0.15 * x * np.exp(0.5 - 0.5 * x * x) - 0.004 * qd


def test_false_positive_rate_without_a_gap():
    flagged = 0
    for seed in range(12):
        maps, places, _ = maps_of(swings(lambda t, q, qd: 0.0, seed))
        flagged += bool(places)
        assert len(maps) >= 6
    assert flagged <= 3  # 5 % of sets are expected to


def test_a_notch_is_localised():
    maps, places, _ = maps_of(swings(notch, runs=8))
    local = maps["position, by itself"]
    assert local.adjusted < 0.01
    flagged = [0.5 * (a + b) for a, b, f in zip(local.edges[:-1], local.edges[1:], local.flagged, strict=True) if f]
    assert min(abs(x - 0.35) for x in flagged) < 0.12
    spans = [w for w in places if w.quantity in ("position", "position, by itself")]
    below = [w for w in spans if w.high < 0.5 and "forwards" in w.text]
    above = [w for w in spans if w.low > 0.2 and "backwards" in w.text]
    assert below and above  # pulled into it from both sides
    assert "°" in below[0].text and "N m" in below[0].text


def test_restitution_is_seen_at_the_stop():
    data = swings(lambda t, q, qd: -0.004 * qd, restitution=0.6, stop=0.3, starts=[-1.0, -0.8, -0.7, -0.9, -1.1, -0.6])
    _, places, found = maps_of(data, upper=0.3)
    assert len(found.impacts) > 8
    at_stops = [w for w in places if "stop" in w.text]
    assert at_stops and 0.4 < float(at_stops[0].text.split("about ")[1].split("%")[0]) / 100 < 0.75
    dead = swings(lambda t, q, qd: -0.004 * qd, restitution=0.0, stop=0.3, starts=[-1.0, -0.8, -0.7, -0.9, -1.1, -0.6])
    _, places, _ = maps_of(dead, upper=0.3)
    assert not [w for w in places if "stop" in w.text and "comes back" in w.text]


def test_too_little_data_gives_no_map():
    data = swings(friction, runs=1, seconds=0.2)
    assert make_residual_maps(estimate_missing_force(data, MECHANICS, -9, 9)) == ()
