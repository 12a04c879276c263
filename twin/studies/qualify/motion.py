"""Checks of a drive on the bench: its motion, steps, stall, repetition, frequency response.

How a drive follows a step of its command.

The load that a drive can no longer turn against. A load that grows finds it in one run, but too high: beyond the stall
torque tau_s a shaft of inertia J is still to be braked, J domega/dt = tau_s - tau_load. That takes until the load is
sqrt(2 J omega r) above tau_s if it grows with the rate r, 0.04 N m of 7e-3 kg m2. And it is too low if the drive's own
loop is slower than the load. Loads that are held know neither: they say whether the one that was found is right, and if
it is not they close in on the right one.

Whether a drive repeats itself, how much the step size matters, and what a step costs.

How fast a drive's speed follows small changes of its command: amplitudes over frequency, -3 dB bandwidth.
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
"""No drive for this robot is that far off by itself; rpm (9.5), degrees (57) and gears are."""
WRONG_RATE = 0.05
"""Twice what a register of 0.024 rad/s can be off at the speed in use."""
LOAD_WINDOW = 0.1
"""How long after the load step its effect is looked for (s): before an integral loop has made up for it."""
ANGLE_ROUNDING = 1e-9
"""rad. Rounding of the angle after seconds of turning."""


def direction_findings(plan: DrivePlan, cycle: Response) -> list[Finding]:
    """Checks `direction`, `scale` and `rate`; measures `speed` and `no_load_speed`.

    Args:
        plan: the drive.
        cycle: its work cycle.

    Raises:
        ComponentFailed: it failed in one of the runs.
    """
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
    """Check `load`, measure `droop`.

    Args:
        plan: the drive.
        cycle: its work cycle.

    Raises:
        ComponentFailed: it failed in the run without load.
    """
    free = response(plan, *work_cycle(load=0.0))
    first = round(LOAD_TIME / TICK)
    behind = (free.theta_m - cycle.theta_m)[first : first + round(LOAD_WINDOW / TICK)]
    most = float(behind[np.argmax(np.abs(behind))])
    felt = "not felt" if abs(most) <= ANGLE_ROUNDING else f"{abs(most):.3g} rad {'behind' if most > 0 else 'AHEAD'}"
    droop = (
        free.mean_speed(CYCLE_END - AVERAGE_TIME, CYCLE_END) - cycle.mean_speed(CYCLE_END - AVERAGE_TIME, CYCLE_END)
    ) / LOAD_IN_USE
    return [
        make_check(
            "load", most >= -ANGLE_ROUNDING, f"{felt} within {LOAD_WINDOW:g} s of a load of {LOAD_IN_USE:g} N m"
        ),
        Measure("droop", droop, "less than an encoder shows" if abs(droop) < NEGLIGIBLE_DROOP else ""),
    ]


def _remedy(plan: DrivePlan, forth: float, back: float) -> str:
    if forth < 0.0 < back:
        shaft = [b for b in plan.bindings if b.port.name in ("theta_m", "omega_m")]
        other = ", ".join(f'{b.port.name} = "{b.name if b.turned else f"-{b.name}"}"' for b in shaft)
        return f"; its command and its angle disagree, and sign turns over both: map {other}, or the command so"
    return "; it does not turn: does it need an enable, a supply or other inputs?" if forth == back else ""


SPEED_ROUNDING = 1e-9
"""rad/s. Of a mean speed."""


def step_findings(cycle: Response) -> list[Finding]:
    """Measures `ripple`, `rise_time`, `settling_time` and `overshoot`, from the work cycle's first step."""
    final = cycle.mean_speed(LOAD_TIME - AVERAGE_TIME, LOAD_TIME)
    steady = cycle.omega_m[cycle.window(LOAD_TIME - AVERAGE_TIME, LOAD_TIME)]
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
    """A measure of time (s) if the speed ever came so far."""
    return Measure(name, value, remark) if np.isfinite(value) else Measure(name, None, "omega_m does not get there")


RAMP_START = 0.5
"""s. The load starts to grow when the shaft turns steadily."""
RAMP_RATE = 0.25
"""N m/s. With which the load grows."""
HOLD_TIME = 1.0
"""s. How long a load is held. Its excess e stops a shaft of inertia J from 0.5 rad/s within 0.5 J/e, so that what is
carried that long is too high by at most 0.5 J: 0.0035 N m of 7e-3 kg m2. Longer, and a winding that heats is weaker."""
STALL_SHARE = 0.1
"""Of the commanded speed: friction that is smoothed around standstill lets a model creep below it for ever."""
SPEED_WINDOW = 0.05
"""s. Over which the speed is averaged: a stepper swings while it turns."""
STALL_UNCERTAINTY = 0.02
"""Of the stall torque: between a load that is carried and one that is not there is twice as much."""
STALL_TIME = 0.3
"""s. A shaft that has been slower than `STALL_SHARE` for that long is stalled."""


def overload(plan: DrivePlan) -> Response:
    """Commanded with the speed in use, the load grows until the shaft has stalled.

    Raises:
        ComponentFailed: the drive failed.
    """
    t = TICK * np.arange(round((RAMP_START + MAX_LOAD / RAMP_RATE) / TICK))
    tau_load = RAMP_RATE * np.maximum(0.0, t - RAMP_START)
    return response(plan, np.full(len(t), SPEED_IN_USE), tau_load, enough=_is_stall)


def stall_torque(plan: DrivePlan, done: Response) -> Measure:
    """Measure `stall_torque`.

    Args:
        plan: the drive.
        done: its `overload` run.

    Raises:
        ComponentFailed: the drive failed under a load that was held.
    """
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
    """The load (N m) at which the shaft of an `overload` run has stalled; 0: it never turned."""
    n = round(SPEED_WINDOW / TICK)
    turning = np.flatnonzero(done.theta_m[n:] - done.theta_m[:-n] >= STALL_SHARE * SPEED_IN_USE * SPEED_WINDOW)
    # the load in the middle of the last window in which it still turned
    return float(done.tau_load[turning[-1] + n // 2]) if len(turning) else 0.0


def held_torque(found: float, carries: Callable[[float], bool]) -> float:
    """`found` (N m) if loads `STALL_UNCERTAINTY` below and above it say so, else what they close in on, as exactly; not
    less than `MAX_LOAD` if that is carried.

    Args:
        found: > 0.
        carries: whether a load is carried for as long as it is held; those below one that is, are, too.
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
    # nothing follows from nothing
    while high - low > max(2.0 * STALL_UNCERTAINTY * high, RAMP_RATE * SPEED_WINDOW):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if carries(middle) else (low, middle)
    return 0.5 * (low + high)


def carries_load(plan: DrivePlan, load: float, rate: float = RAMP_RATE) -> bool:
    """Whether a drive, commanded with the speed in use, still turns when `load` (N m), grown by `rate`, has been held.

    Raises:
        ComponentFailed: the drive failed.
    """
    t = TICK * np.arange(round((RAMP_START + load / rate + HOLD_TIME) / TICK))
    tau_load = np.clip(rate * (t - RAMP_START), 0.0, load)
    return not _is_stall(response(plan, np.full(len(t), SPEED_IN_USE), tau_load).theta_m)


def _is_stall(theta_m: Curve) -> bool:
    n = round(STALL_TIME / TICK)
    return len(theta_m) > RAMP_START / TICK and bool(
        theta_m[-1] - theta_m[-n] < STALL_SHARE * SPEED_IN_USE * STALL_TIME
    )


USUAL_TOLERANCE = 1e-4
"""Relative, of the solver in an FMU that states none; what Dymola and OpenModelica export with is 1e-4 and 1e-6."""
TOLERANCE_FACTOR = 0.01
NEGLIGIBLE_ANGLE = 0.01 * ENCODER_RESOLUTION
"""rad. An error of the solver below it is not worth a word."""


def repetition_findings(plan: DrivePlan, cycle: Response) -> list[Finding]:
    """Check `repeats`, measure `cost`.

    Args:
        plan: the drive.
        cycle: its work cycle.

    Raises:
        ComponentFailed: it failed in the second or third run.
    """
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
    """Measure `step_error`: the work cycle once more, the FMU stepped twice as finely, its inputs held as before.

    A solver of ours that goes in steps of one length has them halved, too. And once with a solver that works more
    exactly: no finer step mends what its tolerance does.

    Args:
        plan: the drive.
        cycle: its work cycle.
    """
    steps, _ = rates(plan.label, plan.table, TICK)
    parts = {name: part.model_copy(update=_half_step(part)) for name, part in plan.table.parts.items()}
    halves = {"substeps": 2 * steps, "parts": parts, **_half_step(plan.table)}
    halved = replace(plan, table=plan.table.model_copy(update=halves))
    try:
        finer = response(halved, *work_cycle())
    # an FMU may insist on a step size of its own
    except (ComponentFailed, InputRefused) as refusal:
        return Measure("step_error", None, f"refuses a step of {0.5e3 * TICK / steps:g} ms: {refusal}")
    change = _angle_difference(finer, cycle)
    by_solver, tolerance = _tolerance_error(plan, cycle)
    if by_solver > max(change, NEGLIGIBLE_ANGLE):
        return Measure(
            "step_error", change, f"with tolerance = {tolerance:g} it moves by {by_solver:.2g} rad: set that"
        )
    solvers = [plan.solver(part) for part in plan.parts]
    remedy = "lower solver_step_ms" if any(s and s.method == "rk4" for s in solvers) else "raise substeps"
    return Measure(
        "step_error", change, "" if change < ENCODER_RESOLUTION else f"seen by the robot's encoder: {remedy}"
    )


def _half_step(table: Drive | DrivePart) -> dict[str, float]:
    return {} if table.solver_step is None else {"solver_step": 0.5 * table.solver_step}


def _tolerance_error(plan: DrivePlan, cycle: Response) -> tuple[float, float]:
    """(largest change of theta_m in the work cycle, rad; the relative tolerance of its solver that makes it)."""
    stated = [tolerance for part in plan.parts if (tolerance := plan.tolerance(part))]
    tolerance = TOLERANCE_FACTOR * min(stated, default=USUAL_TOLERANCE)
    parts = {name: part.model_copy(update={"tolerance": None}) for name, part in plan.table.parts.items()}
    table = plan.table.model_copy(update={"tolerance": tolerance, "parts": parts})
    try:
        exact = response(replace(plan, table=table), *work_cycle())
    # an FMU need not have an input that is not fed
    except (ComponentFailed, InputRefused):
        return 0.0, tolerance
    return _angle_difference(exact, cycle), tolerance


def _angle_difference(one: Response, other: Response) -> float:
    """Largest difference of theta_m (rad)."""
    return float(np.max(np.abs(one.theta_m - other.theta_m)))


LOWEST_FREQUENCY, HIGHEST_FREQUENCY = 0.25, 200.0
"""Hz. The lowest stands for none at all; the highest is a fifth of the rate at which the command changes."""
PER_OCTAVE = 2
FINE_FREQUENCIES = 5
"""Frequencies tried once more between the two that embrace the bandwidth."""
LEAD_IN_PERIODS, MEASURED_PERIODS = 0.25, 1.0
"""Periods run before, and looked at, at each frequency."""
MIN_LEAD_IN_TIME, MIN_MEASURED_TIME = 0.1, 0.2
"""Of each, at least that long (s): a drive's own transient, and ripple that has to average out."""
MIN_AMPLITUDE = 1e-6
"""Of the amplitude at the lowest frequency: what has fallen so far may have fallen to nothing."""
HALF_POWER = 1.0 / np.sqrt(2.0)


def frequency_response(plan: DrivePlan) -> tuple[Curve, Curve]:
    """(frequencies (n,) in Hz, amplitude of speed over amplitude of command (n,)), dense near the bandwidth.

    The drive's own: what holding the command for a tick H and averaging the speed over one take away, sin(x)/x with
    x = pi f H each, is given back.

    Raises:
        ComponentFailed: the drive failed.
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
    """Measure `bandwidth`: where `gain` first falls below 1/sqrt(2) of its value at the lowest frequency.

    Args:
        frequencies: Hz, ascending (n,).
        gain: (n,).
        steady_gain: speed over command at rest of both, for a drive too slow for the lowest frequency.
    """
    if gain[0] < HALF_POWER * abs(steady_gain):
        return Measure("bandwidth", None, f"less than {LOWEST_FREQUENCY:g} Hz")
    if not gain[0] > 0.0:
        return Measure("bandwidth", None, "does not follow its command")
    below = np.flatnonzero(gain < HALF_POWER * gain[0])
    if len(below) == 0:
        return Measure("bandwidth", None, f"more than {HIGHEST_FREQUENCY:g} Hz")
    last, first = below[0] - 1, below[0]
    # between two neighbours a gain over frequency is nearly straight on logarithmic axes
    falling = np.log(np.maximum(gain[[first, last]], MIN_AMPLITUDE * gain[0]))
    at = np.interp(np.log(HALF_POWER * gain[0]), falling, np.log(frequencies[[first, last]]))
    return Measure("bandwidth", float(np.exp(at)))


def _gains(plan: DrivePlan, frequencies: Curve) -> Curve:
    """Amplitude ratios (n,) at `frequencies`, one after the other in one run."""
    lead_in = np.round(np.maximum(LEAD_IN_PERIODS / frequencies, MIN_LEAD_IN_TIME) / TICK).astype(int)
    looked_at = np.round(np.maximum(MEASURED_PERIODS / frequencies, MIN_MEASURED_TIME) / TICK).astype(int)
    phase = np.cumsum(2.0 * np.pi * TICK * np.repeat(frequencies, lead_in + looked_at))
    omega_ref = BIAS_SPEED + SMALL_SPEED * np.sin(phase)
    done = response(plan, omega_ref, np.zeros(len(phase)))
    ends = np.cumsum(lead_in + looked_at)
    seen = [_amplitude(done, phase, slice(end - n, end)) for end, n in zip(ends, looked_at, strict=True)]
    return np.array(seen) / SMALL_SPEED / np.sinc(frequencies * TICK) ** 2


def _amplitude(done: Response, phase: Curve, part: slice) -> float:
    """Amplitude (rad/s) of the speed's sine in a part of the run, fitted beside a straight line.

    The speed is the mean over each tick, from the angle: encoder steps and ripple are noise that the fit averages out.
    """
    speed = np.diff(done.theta_m[part]) / TICK
    angle = phase[part][1:]
    t = done.t[part][1:] - done.t[part][0]
    columns = np.column_stack([np.sin(angle), np.cos(angle), np.ones_like(t), t])
    fitted = np.linalg.lstsq(columns, speed, rcond=None)[0]
    return float(np.hypot(fitted[0], fitted[1]))
