"""Checks of a drive on the bench: motion, step response, stall torque, repeatability, step size, frequency response.

The stall torque is first found by a growing load, in one run, but too high: beyond the stall torque tau_s the shaft of
inertia J must still be braked, J domega/dt = tau_s - tau_load, which takes until the load is sqrt(2 J omega r) above
tau_s if it grows with the rate r: 0.04 N m for 7e-3 kg m2. If the drive's own loop is slower than the load, the result
is too low. Held loads have neither error: they confirm the result, or bisect to the right one.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from twin.kernel.errors import ComponentFailed, InputRefused
from twin.robot.assembly.drives import DrivePlan, rates
from twin.robot.experiment.schema import Drive, DrivePart
from twin.robot.run.hold import SETTLING_BAND
from twin.studies.metrics.response import Curve, overshoot, rise_time, settling_time
from twin.studies.qualify.bench import Response, response
from twin.studies.qualify.definitions import (
    AVERAGE_TIME,
    BIAS_SPEED,
    COMMAND_TIME,
    CYCLE_END,
    ENCODER_RESOLUTION,
    LOAD_IN_USE,
    LOAD_PEAK,
    LOAD_TIME,
    MAX_LOAD,
    NEGLIGIBLE_DROOP,
    SMALL_SPEED,
    SPEED_IN_USE,
    SPEED_LIMIT,
    TICK,
    Finding,
    Measure,
    make_check,
    work_cycle,
)

WRONG_SCALE = 1.5
"""Factor between actual and commanded speed above which units are wrong: rpm give 9.5, degrees 57, gears similar."""
WRONG_RATE = 0.05
"""Relative deviation of omega_m from theta_m's rate; twice the error of a 0.024 rad/s register at the speed in use."""
LOAD_WINDOW = 0.1
"""Time window after the load step for measuring its effect (s): before an integral loop compensates it."""
ANGLE_ROUNDING = 1e-9
"""Rounding error of the angle after seconds of turning (rad)."""
SPEED_ROUNDING = 1e-9
"""Rounding error of a mean speed (rad/s)."""
RAMP_START = 0.5
"""Start of the load ramp (s), when the shaft turns steadily."""
RAMP_RATE = 0.25
"""Rate of the load ramp (N m/s)."""
HOLD_TIME = 1.0
"""Holding time of a load (s). Its excess e stops a shaft of inertia J from 0.5 rad/s within 0.5 J/e, so a load carried
that long is too high by at most 0.5 J: 0.0035 N m for 7e-3 kg m2. A longer time would heat and weaken the winding.
"""
STALL_SHARE = 0.1
"""Stall threshold (share of the commanded speed): smoothed friction lets a model creep below it forever."""
SPEED_WINDOW = 0.05
"""Averaging time of the speed (s): a stepper oscillates while it turns."""
STALL_UNCERTAINTY = 0.02
"""Relative uncertainty of the stall torque; carried and not carried loads are twice as far apart."""
STALL_TIME = 0.3
"""Time below `STALL_SHARE` after which a shaft is stalled (s)."""
USUAL_TOLERANCE = 1e-4
"""Assumed relative solver tolerance of an FMU without one; Dymola and OpenModelica export 1e-4 and 1e-6."""
TOLERANCE_FACTOR = 0.01
NEGLIGIBLE_ANGLE = 0.01 * ENCODER_RESOLUTION
"""Threshold of a solver error worth reporting (rad)."""
LOWEST_FREQUENCY, HIGHEST_FREQUENCY = 0.25, 200.0
"""Frequency range (Hz): the lowest represents the static gain, the highest is a fifth of the sampling rate."""
PER_OCTAVE = 2
FINE_FREQUENCIES = 5
"""Number of extra frequencies between the two neighbours of the bandwidth."""
LEAD_IN_PERIODS, MEASURED_PERIODS = 0.25, 1.0
"""Number of periods before the measurement, and measured, at each frequency."""
MIN_LEAD_IN_TIME, MIN_MEASURED_TIME = 0.1, 0.2
"""Minimum duration of both (s), for the drive's own transient, and for averaging ripple."""
MIN_AMPLITUDE = 1e-6
"""Minimum relative amplitude: a response below it may be zero."""
HALF_POWER = 1.0 / np.sqrt(2.0)


def direction_findings(plan: DrivePlan, cycle: Response) -> list[Finding]:
    """Check a drive's direction, scale and rate; measure its speed and no-load speed."""
    back = response(plan, *work_cycle(speed=-SPEED_IN_USE, end=LOAD_TIME))
    fast = response(plan, *work_cycle(speed=SPEED_LIMIT, end=LOAD_TIME))
    window = (LOAD_TIME - AVERAGE_TIME, LOAD_TIME)
    forth, back_speed = cycle.mean_speed(*window), back.mean_speed(*window)
    reported = float(np.mean(cycle.omega_m[cycle.window(*window)]))
    share = forth / SPEED_IN_USE
    return [
        make_check(
            "direction",
            forth > 0.0 > back_speed,
            f"{forth:+.3f} and {back_speed:+.3f} rad/s at {SPEED_IN_USE:+g} and {-SPEED_IN_USE:+g} commanded"
            + _remedy(plan, forth, back_speed),
        ),
        make_check(
            "scale",
            1.0 / WRONG_SCALE < abs(share) < WRONG_SCALE,
            f"{abs(share):.3g} times the command",
        ),
        make_check(
            "rate",
            abs(reported - forth) <= WRONG_RATE * abs(forth),
            f"{reported:.4g} rad/s reported, {forth:.4g} rad/s from the angle",
        ),
        Measure("speed", forth),
        Measure("no_load_speed", fast.mean_speed(*window)),
    ]


def load_findings(plan: DrivePlan, cycle: Response) -> list[Finding]:
    """Check a drive's response to load, and measure its droop."""
    free = response(plan, *work_cycle(load=0.0))
    first = round(LOAD_TIME / TICK)
    behind = (free.theta_m - cycle.theta_m)[first : first + round(LOAD_WINDOW / TICK)]
    most = float(behind[np.argmax(np.abs(behind))])
    felt = "not felt" if abs(most) <= ANGLE_ROUNDING else f"{abs(most):.3g} rad {'behind' if most > 0 else 'AHEAD'}"
    end = (CYCLE_END - AVERAGE_TIME, CYCLE_END)
    droop = (free.mean_speed(*end) - cycle.mean_speed(*end)) / LOAD_IN_USE
    text = f"{felt} within {LOAD_WINDOW:g} s of a load of {LOAD_IN_USE:g} N m"
    return [
        make_check("load", most >= -ANGLE_ROUNDING, text),
        Measure("droop", droop, "less than an encoder shows" if abs(droop) < NEGLIGIBLE_DROOP else ""),
    ]


def _remedy(plan: DrivePlan, forth: float, back: float) -> str:
    if forth < 0.0 < back:
        shaft = [b for b in plan.bindings if b.port.name in ("theta_m", "omega_m")]
        other = ", ".join(f'{b.port.name} = "{b.name if b.turned else f"-{b.name}"}"' for b in shaft)
        return f"; its command and its angle disagree, and sign turns over both: map {other}, or the command so"
    return "; it does not turn: does it need an enable, a supply or other inputs?" if forth == back else ""


def step_findings(cycle: Response) -> list[Finding]:
    """Measure a drive's ripple, rise time, settling time and overshoot, from the command step of the work cycle."""
    before_load = (LOAD_TIME - AVERAGE_TIME, LOAD_TIME)
    final, steady = cycle.mean_speed(*before_load), cycle.omega_m[cycle.window(*before_load)]
    ripple = float(np.max(np.abs(steady - np.mean(steady))))
    if final < SETTLING_BAND * SPEED_IN_USE:
        still = "does not turn forward"
        return [Measure(name, None, still) for name in ("ripple", "rise_time", "settling_time", "overshoot")]
    after = cycle.window(COMMAND_TIME, LOAD_TIME)
    t, omega_m = cycle.t[after] - COMMAND_TIME, cycle.omega_m[after]
    rise = rise_time(t, omega_m, 0.0, final)
    hidden = f"hidden by a ripple of {ripple / final:.0%}" if ripple > SETTLING_BAND * final else ""
    peak = overshoot(omega_m, final)
    seen = peak if peak * final > 1.05 * ripple + SPEED_ROUNDING else 0.0
    settled = settling_time(t, omega_m, final, SETTLING_BAND * final)
    return [
        Measure("ripple", ripple),
        _in_time("rise_time", rise, "within one tick" if rise == 0.0 else ""),
        Measure("settling_time", None, hidden) if hidden else _in_time("settling_time", settled),
        Measure("overshoot", None if hidden else 100.0 * seen, hidden),
    ]


def _in_time(name: str, value: float, remark: str = "") -> Measure:
    """Return a measure of time (s), without a value if the speed never reaches the level."""
    return Measure(name, value, remark) if np.isfinite(value) else Measure(name, None, "omega_m does not get there")


def overload(plan: DrivePlan) -> Response:
    """Run a drive at the speed in use under a growing load until its shaft has stalled; return the response."""
    t = TICK * np.arange(round((RAMP_START + MAX_LOAD / RAMP_RATE) / TICK))
    tau_load = RAMP_RATE * np.maximum(0.0, t - RAMP_START)
    return response(plan, np.full(len(t), SPEED_IN_USE), tau_load, enough=_is_stall)


def stall_torque(plan: DrivePlan, done: Response) -> Measure:
    if not _is_stall(done.theta_m):
        return Measure("stall_torque", None, f"more than {MAX_LOAD:g} N m")
    found = ramped_torque(done)
    torque = found and held_torque(found, lambda load: carries_load(plan, load))
    if torque == 0.0:
        return Measure("stall_torque", None, "does not turn forward")
    if torque >= MAX_LOAD:
        return Measure("stall_torque", None, f"more than {MAX_LOAD:g} N m")
    weak = torque < (1.0 - STALL_UNCERTAINTY) * LOAD_PEAK
    return Measure("stall_torque", torque, f"less than the peak of {LOAD_PEAK:g} N m" if weak else "")


def ramped_torque(done: Response) -> float:
    """Return the load (N m) at which a drive stalled under a growing load; 0 if the shaft never turned."""
    n = round(SPEED_WINDOW / TICK)
    turning = np.flatnonzero(done.theta_m[n:] - done.theta_m[:-n] >= STALL_SHARE * SPEED_IN_USE * SPEED_WINDOW)
    # The load in the middle of the last window with a turning shaft.
    return float(done.tau_load[turning[-1] + n // 2]) if len(turning) else 0.0


def held_torque(found: float, carries: Callable[[float], bool]) -> float:
    """Confirm or correct a ramp's stall torque `found` > 0 (N m) by held loads, to within `STALL_UNCERTAINTY`.

    Return `found` if loads `STALL_UNCERTAINTY` below and above it confirm it, else the result of a bisection;
    `MAX_LOAD` if that load is carried. If `carries` a load, then all smaller ones.
    """
    below, above = (1.0 - STALL_UNCERTAINTY) * found, (1.0 + STALL_UNCERTAINTY) * found
    if not carries(below):
        low, high = 0.0, below
    elif carries(above):
        if above >= MAX_LOAD or carries(MAX_LOAD):
            return MAX_LOAD
        low, high = above, MAX_LOAD
    else:
        return found
    # A purely relative resolution would never be reached if the stall torque is zero.
    while high - low > max(2.0 * STALL_UNCERTAINTY * high, RAMP_RATE * SPEED_WINDOW):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if carries(middle) else (low, middle)
    return 0.5 * (low + high)


def carries_load(plan: DrivePlan, load: float, rate: float = RAMP_RATE) -> bool:
    """Whether a drive at the speed in use still turns after a load (N m) has been held."""
    t = TICK * np.arange(round((RAMP_START + load / rate + HOLD_TIME) / TICK))
    tau_load = np.clip(rate * (t - RAMP_START), 0.0, load)
    return not _is_stall(response(plan, np.full(len(t), SPEED_IN_USE), tau_load).theta_m)


def _is_stall(theta_m: Curve) -> bool:
    n = round(STALL_TIME / TICK)
    return len(theta_m) > RAMP_START / TICK and bool(
        theta_m[-1] - theta_m[-n] < STALL_SHARE * SPEED_IN_USE * STALL_TIME
    )


def repetition_findings(plan: DrivePlan, cycle: Response) -> list[Finding]:
    """Check whether a drive repeats its response bit by bit, and measure its computing cost."""
    again = [response(plan, *work_cycle()) for _ in range(2)]
    differs = (cycle.theta_m != again[0].theta_m) | (cycle.omega_m != again[0].omega_m)
    sentence = f"bit for bit over {len(cycle.t)} steps"
    if differs.any():
        at, most = cycle.t[np.argmax(differs)], _angle_difference(cycle, again[0])
        sentence = f"differs from t = {at:g} s on, by up to {most:.3g} rad"
    return [
        make_check("repeats", not differs.any(), sentence),
        Measure("cost", min(run.cost for run in (cycle, *again))),
    ]


def step_error(plan: DrivePlan, cycle: Response) -> Measure:
    """Measure a drive's error due to its step size, by repeating the work cycle with the FMU stepped twice as finely.

    Fixed steps of twin's own solver are halved too. Another run uses a tighter solver tolerance, whose error finer
    steps cannot reduce.
    """
    steps, _ = rates(plan.label, plan.table, TICK)
    parts = {name: part.model_copy(update=_half_step(part)) for name, part in plan.table.parts.items()}
    halves = {"substeps": 2 * steps, "parts": parts, **_half_step(plan.table)}
    halved = replace(plan, table=plan.table.model_copy(update=halves))
    try:
        finer = response(halved, *work_cycle())
    # An FMU may insist on its own step size.
    except (ComponentFailed, InputRefused) as refusal:
        return Measure("step_error", None, f"refuses a step of {0.5e3 * TICK / steps:g} ms: {refusal}")
    change = _angle_difference(finer, cycle)
    by_solver, tolerance = _tolerance_error(plan, cycle)
    remark = ""
    if by_solver > max(change, NEGLIGIBLE_ANGLE):
        remark = f"with tolerance = {tolerance:g} it moves by {by_solver:.2g} rad: set that"
    elif change >= ENCODER_RESOLUTION:
        solvers = [plan.solver(part) for part in plan.parts]
        remedy = "lower solver_step_ms" if any(s and s.method == "rk4" for s in solvers) else "raise substeps"
        remark = f"seen by the robot's encoder: {remedy}"
    return Measure("step_error", change, remark)


def _half_step(table: Drive | DrivePart) -> dict[str, float]:
    return {} if table.solver_step is None else {"solver_step": 0.5 * table.solver_step}


def _tolerance_error(plan: DrivePlan, cycle: Response) -> tuple[float, float]:
    """Return (largest change of a drive's angle (rad) under a tighter solver tolerance, that tolerance)."""
    stated = [tolerance for part in plan.parts if (tolerance := plan.tolerance(part))]
    tolerance = TOLERANCE_FACTOR * min(stated, default=USUAL_TOLERANCE)
    parts = {name: part.model_copy(update={"tolerance": None}) for name, part in plan.table.parts.items()}
    table = plan.table.model_copy(update={"tolerance": tolerance, "parts": parts})
    try:
        exact = response(replace(plan, table=table), *work_cycle())
    # An FMU need not support a tolerance.
    except (ComponentFailed, InputRefused):
        return 0.0, tolerance
    return _angle_difference(exact, cycle), tolerance


def _angle_difference(one: Response, other: Response) -> float:
    return float(np.max(np.abs(one.theta_m - other.theta_m)))


def frequency_response(plan: DrivePlan) -> tuple[Curve, Curve]:
    """Measure frequencies (n,) in Hz, more near the bandwidth, and a drive's amplitudes (n,) of speed over command.

    The effects of holding the command for a tick H and averaging the speed over one, sin(x)/x with x = pi f H each, are
    compensated.
    """
    count = 1 + round(PER_OCTAVE * np.log2(HIGHEST_FREQUENCY / LOWEST_FREQUENCY))
    coarse = np.geomspace(LOWEST_FREQUENCY, HIGHEST_FREQUENCY, count)
    gain = _gains(plan, coarse)
    below = np.flatnonzero(gain < HALF_POWER * gain[0])
    if len(below) == 0:
        return coarse, gain
    fine = np.geomspace(coarse[below[0] - 1], coarse[below[0]], FINE_FREQUENCIES + 2)[1:-1]
    order = np.argsort(np.concatenate([coarse, fine]))
    return np.concatenate([coarse, fine])[order], np.concatenate([gain, _gains(plan, fine)])[order]


def bandwidth(frequencies: Curve, gain: Curve, steady_gain: float) -> Measure:
    """Measure where the gain first falls below 1/sqrt(2) of that at the lowest frequency, else of `steady_gain`."""
    if gain[0] < HALF_POWER * abs(steady_gain):
        return Measure("bandwidth", None, f"less than {LOWEST_FREQUENCY:g} Hz")
    if not gain[0] > 0.0:
        return Measure("bandwidth", None, "does not follow its command")
    below = np.flatnonzero(gain < HALF_POWER * gain[0])
    if len(below) == 0:
        return Measure("bandwidth", None, f"more than {HIGHEST_FREQUENCY:g} Hz")
    last, first = below[0] - 1, below[0]
    # Between neighbouring frequencies a gain is nearly straight on logarithmic axes.
    falling = np.log(np.maximum(gain[[first, last]], MIN_AMPLITUDE * gain[0]))
    at = np.interp(np.log(HALF_POWER * gain[0]), falling, np.log(frequencies[[first, last]]))
    return Measure("bandwidth", float(np.exp(at)))


def _gains(plan: DrivePlan, frequencies: Curve) -> Curve:
    """Measure a drive's amplitude ratios (n,) at some frequencies, one after the other in one run."""
    lead_in = np.round(np.maximum(LEAD_IN_PERIODS / frequencies, MIN_LEAD_IN_TIME) / TICK).astype(int)
    looked_at = np.round(np.maximum(MEASURED_PERIODS / frequencies, MIN_MEASURED_TIME) / TICK).astype(int)
    phase = np.cumsum(2.0 * np.pi * TICK * np.repeat(frequencies, lead_in + looked_at))
    omega_ref = BIAS_SPEED + SMALL_SPEED * np.sin(phase)
    done = response(plan, omega_ref, np.zeros(len(phase)))
    ends = np.cumsum(lead_in + looked_at)
    seen = [_amplitude(done, phase, slice(end - n, end)) for end, n in zip(ends, looked_at, strict=True)]
    return np.array(seen) / SMALL_SPEED / np.sinc(frequencies * TICK) ** 2


def _amplitude(done: Response, phase: Curve, part: slice) -> float:
    """Fit sine and line to the speed (mean over each tick, by the angle); return the sine's amplitude (rad/s)."""
    speed = np.diff(done.theta_m[part]) / TICK
    angle = phase[part][1:]
    t = done.t[part][1:] - done.t[part][0]
    columns = np.column_stack([np.sin(angle), np.cos(angle), np.ones_like(t), t])
    fitted = np.linalg.lstsq(columns, speed, rcond=None)[0]
    return float(np.hypot(fitted[0], fitted[1]))
