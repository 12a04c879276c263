"""What states cost: saved, restored in memory and from bytes in a new process, branched, and while a run goes on."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from benchmarks.measurement import Measurement, Rounds
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState, SystemState
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment

AT, AHEAD = 7000, 500
BRANCHES = 1000
TURNS = 200
ROUNDS = 7
MINUTE = ("duration_s=60",)


def measurements(path: Path) -> list[Measurement]:
    """Of the experiment at `path`, Fig. 4 with three FMUs."""
    experiment = load_experiment(path)
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, AHEAD)
        while simulation.next_tick < AT:
            simulation.advance()
        state = simulation.state()
        content = state.saved().to_bytes()
        found = [
            Measurement("state: saved to bytes", _typical(lambda: simulation.state().saved().to_bytes()), "ms", 1.0),
            Measurement("state: restored in memory", _typical(lambda: simulation.restore(state)), "ms", 0.1),
            Measurement("state: size", len(content) / 1e3, "kB", 20.0),
            Measurement("1,000 branches of 0.5 s / their stepping", _branches(simulation, state), "", 1.3),
        ]
    return [
        *found,
        Measurement("state: restored in a new process", _new_process(path, content), "ms", 2.0),
        Measurement("60 s with a state every 10 s / with none", _run_with_states(path), "", 1.02),
    ]


def _typical(work: Callable[[], object]) -> float:
    """Median time of `work` (ms)."""
    seconds = []
    for _ in range(TURNS):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return 1e3 * median(seconds)


def _branches(simulation: Simulation, state: SystemState) -> float:
    stepping, began = 0.0, time.perf_counter()
    for _ in range(BRANCHES):
        simulation.restore(state)
        before = time.perf_counter()
        simulation.advance()
        stepping += time.perf_counter() - before
    return (time.perf_counter() - began) / stepping


def _new_process(path: Path, content: bytes) -> float:
    """Time (ms) of the first restoring from bytes in a process, whose code is loaded and system assembled."""
    script = "import sys; from benchmarks.state import restored; print(restored(sys.argv[1], sys.argv[2]))"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "state"
        file.write_bytes(content)
        line = [sys.executable, "-c", script, str(path), str(file)]
        return median(float(subprocess.check_output(line, text=True)) for _ in range(ROUNDS))


def restored(path: str, file: str) -> float:
    """How long this process takes for the state in `file` (ms)."""
    experiment, content = load_experiment(Path(path)), Path(file).read_bytes()
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, AHEAD)
        began = time.perf_counter()
        simulation.restore(SavedState.from_bytes(content, file))
        return 1e3 * (time.perf_counter() - began)


def _run_with_states(path: Path) -> float:
    """`twin run` of a minute with states over without, wall time."""

    def subject(*settings: str) -> Callable[[], float]:
        sets = [word for one in (*MINUTE, *settings) for word in ("--set", one)]
        return lambda: _timed([sys.executable, "-m", "twin", "run", str(path), *sets])

    rounds = Rounds({"none": subject(), "states": subject("recording.state_every_s=10")}, ROUNDS)
    return rounds.ratio("states", "none")


def _timed(line: list[str]) -> float:
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        subprocess.run([*line, "--out", f"{folder}/run"], check=True, capture_output=True)
        return time.perf_counter() - began
