"""Control loops of an experiment at one operating point, for the page: margins, and Bode and Nyquist responses."""

import base64
from typing import Any

import numpy as np

from twin.kernel.errors import InputRefused
from twin.report.page.markup import DataBlock
from twin.robot.assembly.roles import refuse_third_party_parts
from twin.robot.experiment.experiment import Experiment
from twin.studies.analyse.linear.loops import spectral_radius
from twin.studies.analyse.linear.margins import frequencies, loop_response, margins
from twin.studies.analyse.linearised import Linearisation
from twin.studies.analyse.operating_point import operating_points
from twin.studies.analyse.text import decibels, loop_name, point_name

CURVE_FREQUENCIES = 400
HZ_PER_RAD_S = 1.0 / (2.0 * np.pi)


def loops(experiment: Experiment, chosen: int | None) -> dict[str, Any]:
    """Analyse an experiment's control loops, without its faults, at one operating point, JSON-serialisable.

    The block contains the frequencies (Hz), then the gain (dB) and the phase (deg) of each loop. `chosen` is the number
    of the point; None for the last one in contact, or else the last.
    """
    refuse_third_party_parts(experiment, "the loops", ("controller", "estimator"))
    if experiment.controller.force.schedule:
        raise InputRefused("its gains come from [controller.force] schedule; the loops are analysed for one set")
    points, _ = operating_points(experiment)
    pressing = [number for number, point in enumerate(points) if point.in_contact]
    number = (pressing or [len(points) - 1])[-1] if chosen is None else min(chosen, len(points) - 1)
    linear = Linearisation(experiment, points).linear_point(points[number])
    stable = spectral_radius(linear.loops, linear.gains) < 1.0
    whole = frequencies(linear.loops.dt)
    omega = np.geomspace(whole[0], whole[-1], CURVE_FREQUENCIES)
    block, rows = DataBlock(), []
    block.add(HZ_PER_RAD_S * omega)
    for name in linear.gains:
        L = loop_response(linear.loops, linear.gains, name, omega)
        block.add(decibels(np.abs(L)))
        block.add(np.degrees(np.unwrap(np.angle(L))))
        found = margins(linear.loops, linear.gains, name) if stable else None
        rows.append({
            "name": loop_name(name),
            "gain_dB": None if found is None or found.gain is None else float(decibels(found.gain)),
            "phase_deg": None if found is None or found.phase is None else float(np.degrees(found.phase)),
            "crossover_Hz": None if found is None or found.crossover is None else HZ_PER_RAD_S * found.crossover,
        })  # fmt: skip
    return {
        "points": [point_name(point) for point in points],
        "point": number,
        "stable": bool(stable),
        "loops": rows,
        "count": CURVE_FREQUENCIES,
        "block": base64.b64encode(block.content()).decode("ascii"),
    }
