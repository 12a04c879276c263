"""What a shadow beside a robot costs: a sample through the filter, and all that an alarm needs."""

import time
from pathlib import Path

import numpy as np

from benchmarks.measurement import Measurement, Rounds
from twin.kernel.cosim.delay import play
from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.plant.component import Plant, rest_state
from twin.robot.run.trace import run_in_memory
from twin.studies.replay.samples import samples_of
from twin.studies.shadow.alarm import CHANNELS, Blocks, ShadowWatch, Tolerances
from twin.studies.shadow.filter_steps import filter_outputs, shadow_of

ROUNDS = 15


def measurements(path: Path) -> list[Measurement]:
    """Of the experiment at `path`, whose controller samples at 500 Hz."""
    experiment = load_experiment(path)
    samples = samples_of(run_in_memory(experiment, experiment.controller_ticks))
    parameters, n = plant_parameters(experiment.plant, experiment.contact), len(samples.t)
    x, theta_m = rest_state(parameters, experiment.start)
    held = np.tile(theta_m, (n, 1))
    # what is no news plays no role for the time
    limits = Tolerances(dict.fromkeys(CHANNELS, 1.0), dict.fromkeys(CHANNELS, 1.0))

    def filtered() -> float:
        shadow, began = shadow_of(experiment), time.perf_counter()
        filter_outputs(shadow, samples)
        return time.perf_counter() - began

    def stepped() -> float:
        plant, began = Plant(parameters, x, theta_m, 1), time.perf_counter()
        play(plant, samples.t, np.full(n, 2e-3), held)
        return time.perf_counter() - began

    def watched() -> float:
        shadow, watch, began = shadow_of(experiment), ShadowWatch(limits, 0.01), time.perf_counter()
        for end, means in Blocks().add_samples(samples.t, filter_outputs(shadow, samples)):
            watch.add_block(end, means)
        return time.perf_counter() - began

    rounds = Rounds({"filter": filtered, "plant": stepped, "alarm": watched}, ROUNDS)
    span = float(samples.t[-1] - samples.t[0])
    return [
        Measurement("shadow: a sample through the filter", 1e6 * rounds.typical("filter") / n, "us", 15.0),
        Measurement("shadow: a sample through the filter / a step of the plant", rounds.ratio("filter", "plant"), ""),
        Measurement("shadow: with alarm / the filter alone", rounds.ratio("alarm", "filter"), "", 2.0),
        Measurement(
            "shadow: samples at 500 Hz with alarm, times real time", span / rounds.typical("alarm"), "", None, 50.0
        ),
    ]
