"""What a shared past saves: the fault matrix of pressing, made from the start and from the healthy run's states."""

import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.measurement import Measurement, Rounds
from twin.studies.faults.cases import cases, known_kinds
from twin.studies.faults.matrix import matrix_rows
from twin.studies.faults.stage import Stage, load_stage

ROUNDS = 3


def measurements(experiments: Path) -> list[Measurement]:
    """All cases of `twin faults`, with the monitor and without, without start-up and picture; processor time."""
    shared = load_stage(experiments / "pressing.toml")
    alone = Stage(shared.experiment, share=False)
    planned = cases(shared.experiment, known_kinds(()), shared.onsets, None)

    def subject(stage: Stage) -> Callable[[], float]:
        def work() -> float:
            began = time.process_time()
            for _ in matrix_rows(stage, planned):
                pass
            return time.process_time() - began

        return work

    # compiles what it needs before anyone's clock runs
    for _ in matrix_rows(shared, planned[::6]):
        pass
    rounds = Rounds({"shared": subject(shared), "alone": subject(alone)}, ROUNDS)
    return [
        Measurement("fault matrix: from the start / shared past", rounds.ratio("alone", "shared"), "x", at_least=1.7),
        Measurement("fault matrix: 160 cases", rounds.typical("shared"), "s"),
    ]
