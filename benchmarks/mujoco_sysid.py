"""MuJoCo's own system identification (`mujoco.sysid`) on an asset and a measured set, for `gap_peers`.

Everything that it can express of one joint is free at once: damping as a polynomial, dry friction, a spring, armature,
mass and centre of mass, the drive's gains and lateness, and gain, bias and lateness of the encoder. So are the states
in which runs start: parameters of a rollout of ours, since the toolbox takes them as known.

Needs `pip install mujoco[sysid]`.
"""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from scipy.optimize import least_squares

from freeart21.measured import Measured, Run
from freeart21.se3 import Array

TIMESTEP_S = 2e-3
"""Of `implicitfast`; halving it moves a swing by less than the encoders' noise."""
TORQUE, COMMAND = "torque", "command"
NAMES = {
    "viscous": "viscous_damping", "quadratic": "quadratic_drag", "cubic": "cubic_drag", "dry": "coulomb_friction",
    "spring": "return_spring", "armature": "armature", "part_inertia": "inertia", "gain": "actuator_gain",
    "kp": "actuator_gain", "kd": "drive_damping", "delay": "actuator_delay", "bias": "encoder_offset",
    "scale": "encoder_scale", "late": "time_offset",
}  # fmt: skip
"""Parameter to what a claim of it says, in the library's words where it has one."""
_NEUTRAL = {"gain": 1.0, "kp": 1.0, "kd": 1.0, "scale": 1.0}
_PARTS = (0.08, 0.2, 0.45, 1.0)
"""Of a run to which its start is fitted, one after another: a far impact misleads a first guess."""


class OutOfTime(Exception):
    """The time is over; what was best so far stands."""


@dataclass
class Identified:
    """Parameters at their best."""

    params: Any
    """A `ParameterDict` with its values."""
    names: list[str] = field(default_factory=list)
    """What its 95 % intervals say is not nothing."""
    finished: bool = True


class Identification:
    """One measured set before the toolbox. `fit_runs` are fitted; `score` is asked of others."""

    def __init__(self, urdf: Path, measured: Measured, fit_runs: tuple[Run, ...]):
        self.measured, self.runs = measured, fit_runs
        self.driven = measured.actuator is not None and any(_has(r.q_command) for r in fit_runs)
        self.spec = self._read(urdf)
        model = self.spec.compile()
        q, v = (np.concatenate([f(run) for run in fit_runs]) for f in (_positions, _speeds))
        acceleration = np.concatenate([np.gradient(_speeds(run), _times(run)) for run in fit_runs])
        data = mujoco.MjData(model)
        data.qpos[0] = float(np.median(q))
        mujoco.mj_forward(model, data)
        inertia = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, inertia, np.ones(model.nv))
        self.inertia = float(inertia[0])
        self.speed, self.range = float(np.quantile(np.abs(v), 0.99)), float(np.ptp(q))
        self.middle = float(0.5 * (q.min() + q.max()))
        self.force = max(self.inertia * float(np.sqrt(np.mean(acceleration**2))), 1e-9)
        self._built: dict[bytes, Any] = {}
        self._sequences: dict[tuple[str, float], Any] = {}

    def _read(self, urdf: Path) -> Any:
        """The asset's URDF, with what drives it and its encoder; nothing touches."""
        spec, law = mujoco.MjSpec.from_file(str(urdf)), self.measured.actuator
        spec.option.timestep, spec.option.integrator = TIMESTEP_S, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.gravity = self.measured.gravity
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.joint = self.measured.joint or spec.joints[0].name
        self.body = spec.joint(self.joint).parent.name
        motor = spec.add_actuator(name=TORQUE, target=self.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        drive = spec.add_actuator(name=COMMAND, target=self.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        drive.set_to_position(kp=law.stiffness if law else 0.0, kv=law.damping if law else 0.0)
        spec.add_sensor(
            name="q", type=mujoco.mjtSensor.mjSENS_JOINTPOS, objtype=mujoco.mjtObj.mjOBJ_JOINT, objname=self.joint
        )
        return spec

    def parameters(self) -> Any:
        """All that the toolbox can express of these runs, about nothing missing."""
        force, speed, span, params = self.force, self.speed, self.range, sysid.ParameterDict()

        def add(name: str, nominal: float, low: float, high: float, write: Callable | None = None) -> None:
            modifier = None if write is None else (lambda spec, p: write(spec, float(p.value[0])))
            params.add(sysid.Parameter(name, nominal, low, high, modifier=modifier))

        def damp(k: int) -> Callable:
            def write(spec: Any, value: float) -> None:
                spec.joint(self.joint).damping[k] += value

            return write

        def set_joint(name: str) -> Callable:
            return lambda spec, value: setattr(spec.joint(self.joint), name, value)

        def stiffen(spec: Any, value: float) -> None:
            spec.joint(self.joint).stiffness[0] = value

        for k, name in enumerate(("viscous", "quadratic", "cubic")):
            add(name, 1e-3 * force / speed ** (k + 1), 0.0, 10 * force / speed ** (k + 1), damp(k))
        add("dry", 1e-2 * force, 0.0, 3 * force, set_joint("frictionloss"))
        add("spring", 1e-3 * force / span, 0.0, 10 * force / span, stiffen)
        add("rest", self.middle, self.middle - span, self.middle + span, set_joint("springref"))
        add("armature", 1e-3 * self.inertia, 0.0, 10 * self.inertia, set_joint("armature"))
        kind, model = sysid.InertiaType.MassIpos, self.spec.compile()
        params.add(sysid.body_inertia_param(self.spec, model, self.body, kind, True, param_name="part_inertia"))
        if self.driven:
            law = self.measured.actuator
            add("kp", 1.0, 0.1, 10.0, lambda s, v: sysid.apply_pgain(s, COMMAND, v * law.stiffness))
            add("kd", 1.0, 0.0, 10.0, lambda s, v: sysid.apply_dgain(s, COMMAND, v * law.damping))
        if self.measured.effort_kind == "commanded":
            add("gain", 1.0, 0.1, 5.0, lambda s, v: s.actuator(TORQUE).gainprm.__setitem__(0, v))
        if self.driven or self.measured.effort_kind == "commanded":
            add("delay", 5e-3, 0.0, 0.1)
        if self.driven or self.measured.effort_kind is not None:
            add("late", 0.0, -0.1, 0.1)
        add("bias", 0.0, -0.3 * span, 0.3 * span)
        add("scale", 1.0, 0.5, 2.0)
        return params

    def build(self, params: Any, spec: Any) -> Any:
        """The model with these parameters; the last ones are cached, for start states change nothing."""
        own = [p for p in params.values() if p.modifier is not None]
        key = np.concatenate([p.as_vector() for p in own]).tobytes() + spec.modelname.encode()
        if key not in self._built:
            if len(self._built) > 400:
                self._built.clear()
            copied = spec.copy()
            for parameter in own:
                if not (parameter.name in ("kp", "kd") and spec.modelname.endswith("off")):
                    parameter.apply_modifier(copied)
            self._built[key] = copied.compile()
        return self._built[key]

    def sequence(self, run: Run, part: float = 1.0) -> Any:
        """A run, or its first part, as the toolbox takes it."""
        spec, times, q = self.spec.copy(), _times(run), _positions(run)
        keep = max(8, round(part * len(q)))
        times, q, clock = times[:keep], q[:keep], run.times_s
        on = self.driven and _has(run.q_command)
        spec.modelname = "on" if on else "off"
        if not on:
            spec.actuator(COMMAND).gainprm[0] = 0.0
            spec.actuator(COMMAND).biasprm[1:3] = 0.0
        inputs = [_filled(run.effort, clock), _filled(run.q_command if on else None, clock)]
        end = np.append(clock, clock[-1] + 0.3)
        data = np.column_stack([np.append(x, x[-1]) for x in inputs])
        model = spec.compile()
        mapping = {name: (sysid.SignalType.MjCtrl, np.array([k])) for k, name in enumerate((TORQUE, COMMAND))}
        held = self.measured.interpolation == "held"
        grid = np.arange(times[0], times[-1] + 3 * TIMESTEP_S, TIMESTEP_S)
        rows = np.clip(np.searchsorted(end, grid, side="right") - 1, 0, None)
        even = data[rows] if held else np.column_stack([np.interp(grid, end, x) for x in data.T])
        control = sysid.TimeSeries(grid, even, mapping)
        sensor = sysid.TimeSeries(times, q[:, None], {"q": (sysid.SignalType.MjSensor, np.array([0]))})
        begin = sysid.create_initial_state(model, np.array([q[0]]), np.array([_speeds(run)[0]]))
        return sysid.ModelSequences(run.name, spec, run.name, begin, control, sensor)

    def residual(self, params: Any, run: Run, x: Array, part: float = 1.0) -> list:
        """What the toolbox's residual says of one run at x (p,) or (p, m)."""
        if (run.name, part) not in self._sequences:
            self._sequences[run.name, part] = self.sequence(run, part)
        return sysid.residual(
            x,
            params,
            [self._sequences[run.name, part]],
            build_model=self.build,
            modify_residual=self._compare,
            custom_rollout=lambda **given: self._roll(run.name, **given),
            n_threads=1,
        )[0]

    def _roll(self, name: str, models: Any, datas: Any, control_signal: Any, param_dicts: Any, **given: Any) -> list:
        """`sysid_rollout` from the starts that are parameters; equal rows are simulated once."""
        given.pop("initial_states")
        jobs, order = {}, []
        for model, params, control in zip(models, param_dicts, control_signal, strict=True):
            start = params[f"start {name}"].value
            delay = float(params["delay"].value[0]) if "delay" in params else 0.0
            key = (id(model), start.tobytes(), delay)
            if key not in jobs:
                late = sysid.TimeSeries(control.times, _shifted(control, delay), control.signal_mapping)
                state = sysid.create_initial_state(model, start[:1], start[1:])
                jobs[key] = (len(jobs), model, late, state)
            order.append(jobs[key][0])
        _, chosen, controls, states = zip(*jobs.values(), strict=True)
        found = sysid.sysid_rollout(list(chosen), datas, list(controls), list(states), **given)
        return [found[k] for k in order]

    def _compare(self, params: Any, predicted: Any, measured: Any, model: Any, whole: bool, state: Any) -> tuple:
        """Readings less what the encoder would say, rad or m; of equal length whatever the lateness is."""
        late = float(params["late"].value[0]) if "late" in params else 0.0
        begin = [0.0, state[0, 1] - TIMESTEP_S * state[0, 2]]  # a rollout leaves its start out; that is one step back
        times, path = (np.append(first, column) for first, column in zip(begin, state[:, :2].T, strict=True))
        q = np.interp(measured.times - measured.times[0] - late, times, path)
        read = params["scale"].value[0] * q + params["bias"].value[0]
        series = sysid.TimeSeries(measured.times, read[:, None], measured.signal_mapping)
        return measured.data[:, 0] - read, series, measured

    def with_starts(self, params: Any, runs: tuple[Run, ...]) -> Any:
        """The parameters and the start states of runs."""
        out = params.copy()
        for run in runs:
            at = np.array([_positions(run)[0], _speeds(run)[0]])
            room = np.array([0.3 * self.range, self.speed])
            out.add(sysid.Parameter(f"start {run.name}", at, at - room, at + room))
        return out

    def fit(self, seconds: float, iterations: int = 60) -> Identified:
        """All parameters by the toolbox's `optimize`, or the best so far when `seconds` of processor time are over."""
        params, end = self.with_starts(self.parameters(), self.runs), time.process_time() + seconds
        best: list[Any] = [np.inf, params.as_vector()]

        def residual(x: Array, of: Any) -> tuple:
            if time.process_time() > end:
                raise OutOfTime
            parts = [part for run in self.runs for part in self.residual(of, run, x)]
            costs = np.atleast_1d(sum((np.asarray(part) ** 2).sum(0) for part in parts))
            k = int(np.argmin(costs))
            if costs[k] < best[0]:
                best[:] = [costs[k], x.reshape(len(x), -1)[:, k].copy()]
            return parts, None, None

        finished = True
        with contextlib.redirect_stdout(io.StringIO()):
            try:
                params = sysid.optimize(params, residual, verbose=False, max_iters=iterations, x_scale="jac")[0]
            except OutOfTime:
                finished = False
        at = params.as_vector() if finished else best[1]
        low, high = params.get_bounds()
        steps = 1e-6 * (high - low) * np.where(at > 0.5 * (low + high), -1.0, 1.0)
        columns = np.column_stack([at, at[:, None] + np.diag(steps)])
        table = np.concatenate([part for run in self.runs for part in self.residual(params, run, columns)])
        _, width = sysid.calculate_intervals([table[:, 0]], (table[:, 1:] - table[:, :1]) / steps)
        params.update_from_vector(at)
        return Identified(params, self._claims(params, width), finished)

    def _claims(self, params: Any, width: Array) -> list[str]:
        """Names of parameters whose interval leaves nothing out but what is missing."""
        claimed, at = [], 0
        for parameter in params.values():
            of = width[at : at + parameter.size]
            at += parameter.size
            if parameter.name not in NAMES:
                continue
            none = _NEUTRAL.get(parameter.name, parameter.nominal if parameter.name == "part_inertia" else 0.0)
            if np.any(np.abs(parameter.as_vector() - none) > of):
                claimed.append(NAMES[parameter.name])
        return sorted(set(claimed))

    def score(self, found: Identified, run: Run) -> float:
        """Root mean square error of a run, rad or m: its start state free, all else as it was found."""
        params = self.with_starts(found.params, () if f"start {run.name}" in found.params else (run,))
        own = params[f"start {run.name}"]
        for parameter in params.values():
            parameter.frozen = parameter is not own
        for part in _PARTS:
            at = least_squares(
                lambda x, part=part: np.ravel(self.residual(params, run, x, part)[0]),
                own.as_vector(),
                bounds=own.get_bounds(),
                x_scale=np.array([0.1 * self.range, 0.1 * self.speed]) + 1e-9,
                max_nfev=25,
            )
            own.update_from_vector(at.x)
        return float(np.sqrt(np.mean(at.fun**2)))


def _has(values: Array | None) -> bool:
    return values is not None and bool(np.isfinite(values).any())


def _times(run: Run) -> Array:
    return run.times_s[np.isfinite(run.q)]


def _positions(run: Run) -> Array:
    return run.q[np.isfinite(run.q)]


def _speeds(run: Run) -> Array:
    """(n,) by lines through the readings of some 30 ms."""
    times, q = _times(run), _positions(run)
    count = int(np.clip(0.03 / float(np.median(np.diff(times))), 2, 60))
    wide = np.ones(2 * count + 1) / (2 * count + 1)
    t, x = (
        np.convolve(np.pad(values, count, mode="reflect", reflect_type="odd"), wide, "valid") for values in (times, q)
    )
    return np.asarray(np.gradient(x, t))


def _filled(values: Array | None, clock: Array) -> Array:
    """(n,) inputs without gaps; 0 where there are none."""
    if not _has(values):
        return np.zeros(len(clock))
    known = np.isfinite(values)
    return np.asarray(np.interp(clock, clock[known], np.asarray(values)[known]))


def _shifted(control: Any, delay: float) -> Array:
    """(n, 2) torque and command, `delay` s later."""
    if delay == 0.0:
        return np.asarray(control.data)
    return np.column_stack([np.interp(control.times - delay, control.times, x) for x in control.data.T])
