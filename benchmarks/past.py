"""What a shared past saves: the fault matrix of pressing, made from the start and from the healthy run's states."""

import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.measurement import Measurement, Rounds
from twin.robot.assembly.load import load_experiment
from twin.studies.faults.matrix import cases, healthy_trial, known_kinds, matrix_rows, onsets_of

ROUNDS = 3


def measurements(experiments: Path) -> list[Measurement]:
    """All cases of `twin faults`, with the monitor and without, without start-up and picture; processor time."""
    experiment = load_experiment(experiments / "pressing.toml")
    healthy = healthy_trial(experiment)
    planned = cases(experiment, known_kinds(()), onsets_of(experiment, healthy, ()), None)

    def subject(share: bool) -> Callable[[], float]:
        def work() -> float:
            began = time.process_time()
            for _ in matrix_rows(experiment, healthy, planned, share):
                pass
            return time.process_time() - began

        return work

    # compiles what it needs before anyone's clock runs
    for _ in matrix_rows(experiment, healthy, planned[::6], True):
        pass
    rounds = Rounds({"shared": subject(True), "alone": subject(False)}, ROUNDS)
    return [
        Measurement("fault matrix: from the start / shared past", rounds.ratio("alone", "shared"), "x", at_least=1.7),
        Measurement("fault matrix: 160 cases", rounds.typical("shared"), "s"),
    ]
