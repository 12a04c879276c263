"""The measures of a run with a held force, from a recording with numpy alone, as an engineer would compute them."""

import json
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

UNDER_FORCE = (4, 5, 6)
"""Phases hold, circle, push."""


def at(run: Any, key: str, t: NDArray) -> NDArray:
    """A signal as it held at times `t`."""
    times = run.time(key.partition(".")[0])
    return np.asarray(run[key])[np.maximum(np.searchsorted(times, t + 5e-10, side="right") - 1, 0)]


def error_from(run: Any, begin: float) -> float:
    """Root mean square of the force minus its reference from `begin` (s) on."""
    t = run.time("plant")
    e = -run["plant.F_ee_B"][:, 2] - at(run, "controller.F_z_ref", t)
    return float(np.sqrt(np.mean(e[t >= begin - 5e-10] ** 2)))


def held_ticks(on: NDArray, R: NDArray, s0: int, two_seconds: int) -> NDArray[np.bool_]:
    """Ticks that hold a force in a run without tasks."""
    held = np.zeros(len(on), dtype=bool)
    since = 0
    for k in range(len(on)):
        since = since + 1 if k and abs(R[k] - R[k - 1]) <= 1e-9 else 0
        held[k] = on[k] and k >= s0 + two_seconds and since >= two_seconds and R[k] > 0.0
    return held


def chatter(e: NDArray, dt: float) -> tuple[float, float]:
    """(amplitude (N), frequency (Hz)) of one hold: two high-passes of 2 Hz by Tustin's rule, rms times sqrt 2."""
    from scipy.signal import bilinear, lfilter, lfilter_zi

    w = 2.0 * np.pi * 2.0
    b, a = bilinear([1.0, 0.0], [1.0, w], fs=1.0 / dt)
    y = e
    for _ in range(2):
        y, _ = lfilter(b, a, y, zi=lfilter_zi(b, a) * y[0])
    sign, ups = 0, 0
    for value in y:
        if value > 0.025:
            ups += sign <= 0
            sign = 1
        elif value < -0.025:
            sign = -1
    return float(np.sqrt(2.0 * np.mean(y**2))), ups / (len(e) * dt)


def efforts(run: Any) -> dict[str, Any]:
    """Largest motor torque (N m) and current (A), work of the shafts and electrical energy (J); None if unknown.

    Of a run in which the monitor does not trip.
    """
    t, known = run.time("plant"), run.fields()

    def of_drives(name: str) -> NDArray | None:
        keys = [f"drive/{joint}.{name}" for joint in (1, 2, 3)]
        if keys[0] in known:
            return np.column_stack([at(run, key, t) for key in keys])
        return at(run, f"drive.{name}", t) if f"drive.{name}" in known else None

    dt, load, speed = t[1] - t[0], run["plant.tau_load"], of_drives("omega_m")
    torque, current, power = map(of_drives, ("tau_motor", "current", "power"))
    assert speed is not None
    return {
        "torque": np.abs(load if torque is None else torque).max(),
        "current": None if current is None else np.abs(current).max(),
        "shaft_work": dt * np.sum(np.maximum(load * speed, 0.0)[:-1]),
        "energy": None if power is None else dt * np.sum(power[:-1]),
    }


def measures(run: Any) -> dict[str, Any]:
    """Measures of a recording in which a force is held, SI; None where there is no settling time."""
    t = run.time("plant")
    dt = round(float(t[1] - t[0]), 9)
    F, R = -run["plant.F_ee_B"][:, 2], at(run, "controller.F_z_ref", t)
    on, e = at(run, "controller.triggered", t) > 0, F - R
    tasks = json.loads(run.metadata["experiment"]["values"]).get("task", ())
    two_seconds = round(2.0 / dt)
    s0 = int(np.flatnonzero(on & (np.maximum.accumulate(F) > 0.0))[0])
    held = np.isin(at(run, "controller.phase", t), UNDER_FORCE) if tasks else held_ticks(on, R, s0, two_seconds)
    if "monitor.reason" in run.fields():
        held &= np.cumsum(at(run, "monitor.reason", t) > 0) == 0
    k = np.flatnonzero(held)
    p, ref, cmd = run["plant.p_B"], at(run, "controller.p_ref_B", t), at(run, "controller.p_cmd_B", t)
    found: dict[str, Any] = {
        "hold_error": np.sqrt(np.mean(e[k] ** 2)),
        "hold_mean_error": np.mean(e[k]),
        "hold_begin": t[k[0]],
        "hold_end": t[k[-1]],
        "held_lateral_error": np.sqrt(np.mean(np.sum((p - ref)[k, :2] ** 2, axis=1))),
        "held_z_error": np.sqrt(np.mean((p - cmd)[k, 2] ** 2)),
    }
    edges = [0, *np.flatnonzero(np.diff(k) > 1) + 1, len(k)]
    holds = [k[begin:end] for begin, end in pairwise(edges)]
    found["chatter"], found["chatter_frequency"] = max(chatter(e[hold], dt) for hold in holds)
    if tasks:
        number, worst = at(run, "controller.task", t), 0.0
        for task, values in enumerate(tasks, start=1):
            mine = np.flatnonzero((number == task) & held)
            if len(mine):
                first = np.flatnonzero((number == task) & on)[0]
                own = np.flatnonzero(number == task)
                own = own[(own >= first) & (own <= mine[0] + round(1.0 / dt))]
                worst = max(worst, float(F[own].max()) / values["force_N"] - 1.0)
        return found | {"hold_overshoot": worst}
    last = int(holds[0][-1])
    outside = np.flatnonzero(np.abs(e[s0 : last + 1]) > 0.05 * R[s0 : last + 1])
    never = len(outside) and s0 + outside[-1] == last
    found["hold_settling_time"] = None if never else dt * (outside[-1] + 1 if len(outside) else 0)
    found["hold_overshoot"] = max(0.0, float(e[s0 : s0 + two_seconds].max())) / R[s0]
    return found
