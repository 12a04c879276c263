"""The small-signal frequency response of a drive, measured through its FMU.

Where FMI offers partial derivatives (fmi2GetDirectionalDerivative, fmi3GetDirectionalDerivative), a co-simulation FMU
returns those of its outputs at one instant, not of the master's step: solver, sampled loops and delays inside are left
out, and its states cannot be listed. No drive of fmus/ offers them. Therefore the step itself is measured, which works
for every FMU.

A periodic sum of sines with random phases is added to the steady command, once on the command and once on the load, for
several draws of the phases. For a slightly nonlinear drive, their mean is the best linear approximation (Pintelon and
Schoukens 2012, System Identification, Ch. 3). It is measured at rest and with small sines, as at the operating point:
friction that is smooth about zero speed damps there much more than while the shaft turns. A drive whose small signals
drown in the quantisation of its registers, or in stiction, is measured while it turns instead.
"""

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import InputRefused
from twin.robot.assembly.drives import DrivePlan
from twin.studies.analyse.linear.loops import DriveModel, fit_drive
from twin.studies.metrics.response import Curve
from twin.studies.qualify.bench import on_bench, refuse_impossible
from twin.studies.qualify.definitions import LOAD_IN_USE, SPEED_IN_USE

SINE_PERIOD = 1.0
"""Period of the sum of sines (s)."""
LINE_COUNT = 32
"""Number of sines, evenly spaced over the logarithm of the frequency as far as whole periods allow."""
MAX_FREQUENCY_RATIO = 0.2
"""Highest frequency over the tick rate."""
PHASE_DRAWS = 4
PHASE_SEED = 1
MAX_LINEAR_RESIDUAL = 0.05
"""Maximum residual of the fit of a drive that counts as linear for small signals."""
Inputs = tuple[float, float]
"""Command (rad/s) and load (N m)."""


class Excitation(NamedTuple):
    """Excitation of a drive: steady command, largest added command (rad/s), largest added load (N m)."""

    steady: float
    command: float
    load: float


AT_REST = Excitation(0.0, 0.02 * SPEED_IN_USE, 0.02 * LOAD_IN_USE)
WHILE_TURNING = Excitation(3.0 * SPEED_IN_USE, SPEED_IN_USE, LOAD_IN_USE)
"""Excitation of a shaft so fast that friction keeps its sign, with the sines and under load."""


def identify_drive(plan: DrivePlan, tick: float, tau_load: float) -> DriveModel:
    """Identify a drive's linear model around a steady load `tau_load` (N m), through its FMU, with a fixed seed."""
    measured = frequency_response(plan, tick, tau_load, AT_REST)
    # if the fit at rest is refused, the measurement of the turning shaft may still be fitted
    with suppress(InputRefused):
        at_rest = fit_drive(*measured, tick, plan.label)
        if at_rest.residual <= MAX_LINEAR_RESIDUAL:
            return at_rest
    turning = fit_drive(*frequency_response(plan, tick, tau_load, WHILE_TURNING), tick, plan.label)
    return replace(turning, turning=True)


def frequency_response(
    plan: DrivePlan, tick: float, tau_load: float, excitation: Excitation
) -> tuple[Curve, NDArray[np.complex128], Curve]:
    """Measure the frequency response of a drive: advance of its shaft per tick over command and load (SI).

    Return (frequencies (n,) in Hz from 0, response (n, 2), its standard deviation (n, 2)).
    """
    samples = round(SINE_PERIOD / tick)
    lines = np.unique(np.round(np.geomspace(1.0, MAX_FREQUENCY_RATIO * samples, LINE_COUNT)).astype(int))
    steady = (excitation.steady, tau_load)
    drawn = np.zeros((PHASE_DRAWS, 1 + len(lines), 2), dtype=complex)
    for channel, step in enumerate((excitation.command, excitation.load)):
        drawn[:, 0, channel] = _steady_gain(plan, tick, samples, steady, channel, step)
        random = np.random.default_rng(PHASE_SEED)
        for draw in range(PHASE_DRAWS):
            wave = step * sum_of_sines(samples, lines, random.uniform(0.0, 2.0 * np.pi, len(lines)))
            advance = _advance(plan, tick, _input_samples(steady, channel, np.tile(wave, 2)))[samples:]
            drawn[draw, 1:, channel] = np.fft.rfft(advance)[lines] / np.fft.rfft(wave)[lines]
    frequencies = np.concatenate([[0.0], lines / (samples * tick)])
    return frequencies, drawn.mean(axis=0), drawn.std(axis=0, ddof=1) / np.sqrt(PHASE_DRAWS)


def sum_of_sines(samples: int, lines: NDArray[np.int64], phases: Curve) -> Curve:
    """Return one period (samples,) of a sum of sines, maximum 1; amplitudes fall with frequency to avoid saturation."""
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(1j * phases) / np.sqrt(lines)
    wave = np.fft.irfft(spectrum, samples)
    return wave / np.max(np.abs(wave))


def _steady_gain(plan: DrivePlan, tick: float, samples: int, steady: Inputs, channel: int, step: float) -> float:
    """Measure the mean advance of a drive's shaft per unit of one constant input, command or load."""
    means = [
        np.mean(_advance(plan, tick, _input_samples(steady, channel, np.full(2 * samples, sign * step)))[samples:])
        for sign in (1.0, -1.0)
    ]
    return float(means[0] - means[1]) / (2.0 * step)


def _input_samples(steady: Inputs, channel: int, added: Curve) -> Curve:
    inputs = np.tile(steady, (len(added), 1))
    inputs[:, channel] += added
    return inputs


def _advance(plan: DrivePlan, tick: float, inputs: Curve) -> Curve:
    """Simulate a drive on its own and return the advance of its shaft in each tick (n,), rad."""
    with on_bench(plan, tick, inputs) as system:
        rows = Simulation(system, len(inputs), len(inputs) + 1).run()
        refuse_impossible(plan, system, rows)
        return np.diff(rows[:, system.columns("drive.theta_m").start])
