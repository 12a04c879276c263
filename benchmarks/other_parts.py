"""What a controller FMU costs beyond its own time, and a Python class: Fig. 4 with each of them."""

import tempfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from benchmarks.c_loop import CLoop, NoCompiler
from benchmarks.measurement import Measurement, Rounds
from twin.kernel.cosim.observers import simulate
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.assembly.roles import third_party_part
from twin.robot.experiment.experiment import Experiment

ROUNDS = 15
CALLS = 10_000
OTHERS = {
    "FMU": "controller.fmu=fmus/parts/paper_law",
    "class": "controller.python=examples/my_controller.py:Controller",
}


def call_seconds(experiment: Experiment) -> float:
    """Time of a call of the controller in a run (s), and of its tank; what the loop does around them included."""
    with assemble(experiment) as assembly:
        done = simulate(assembly, experiment.duration_ticks, timed=True).require_success()
    return (done.costs["controller"] + done.costs.get("tank", 0.0)) * experiment.controller_ticks


def calls_alone(loop: CLoop, component: Any) -> float:
    """The same calls from C with inputs that never change (s per call)."""
    widths = {f"{side}_width": sum(p.size for p in getattr(component, side)) for side in ("inputs", "outputs")}
    system: Any = SimpleNamespace(components=(component,), tick=2e-3, **widths)
    return loop.calls_alone(system, CALLS) / CALLS


def measurements(experiment: Path) -> list[Measurement]:
    """The lines of the table."""
    title = "controller FMU: per call beyond its own time"
    own, others = load_experiment(experiment), {k: load_experiment(experiment, [s]) for k, s in OTHERS.items()}
    table = others["FMU"].stand_ins["controller"]
    component = third_party_part("controller", table).make(own.cosim.tick, own.controller_ticks, own.duration_ticks)
    try:
        with tempfile.TemporaryDirectory() as folder:
            loop = CLoop(Path(folder))
            rounds = Rounds(
                {
                    "own": lambda: call_seconds(own),
                    "FMU": lambda: call_seconds(others["FMU"]),
                    "class": lambda: call_seconds(others["class"]),
                    "alone": lambda: calls_alone(loop, component),
                },
                ROUNDS,
            )
    except NoCompiler as problem:
        return [Measurement(title, None, "us", at_most=1.0, remark=str(problem))]
    finally:
        component.close()
    beyond = sorted(a - b for a, b in zip(rounds.seconds["FMU"], rounds.seconds["alone"], strict=True))
    return [
        Measurement("controller: twin's own, per call", 1e6 * rounds.typical("own"), "us"),
        Measurement("controller FMU: its own time, per call", 1e6 * rounds.typical("alone"), "us"),
        Measurement(title, 1e6 * beyond[len(beyond) // 2], "us", at_most=1.0),
        Measurement("controller FMU / twin's own, per call", rounds.ratio("FMU", "own"), "x"),
        Measurement("controller in Python, per call", 1e6 * rounds.typical("class"), "us"),
    ]
