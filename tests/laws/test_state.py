"""A state is all that there is to go on from: going on from it is never having stopped, to the last bit."""

import pickle
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import twin
from twin.kernel.cosim.component import Component, NativeComponent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import SavedState, stateless_reasons
from twin.kernel.cosim.subsystem import Subsystem
from twin.kernel.errors import InputRefused
from twin.robot.assembly.assemble import assemble
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import FAULT_KINDS

pytestmark = pytest.mark.slow

AT = 6501
"""An odd tick, at which the controller is between two calls, and in which tasks press and faults act."""
AHEAD = 700
STATELESS = {"modelica_dc"}
"""Drives whose FMU has no state."""
ROOT = Path(__file__).parents[2]


class Case(NamedTuple):
    """A run: its experiment, its drive (None: the experiment's own), and what is set besides."""

    experiment: str
    drive: str | None = None
    settings: tuple[str, ...] = ()

    def load(self) -> Experiment:
        return twin.load(self.experiment, self.settings, self.drive)

    def __str__(self) -> str:
        return " ".join(filter(None, (self.experiment, self.drive, *self.settings)))[:80]


def drives() -> list[str]:
    return sorted(path.parent.name for path in (ROOT / "fmus").glob("*/*.fmu"))


def fault(kind: str) -> str:
    known = FAULT_KINDS[kind]
    magnitude = f", {known.magnitude_key} = {known.magnitudes[1]}" if known.magnitudes else ""
    more = ", share = 0.01" if kind == "encoder_glitch" else ""
    return (
        f'fault=[{{kind = "{kind}", target = "{known.targets[0]}", onset_s = 6.0, duration_s = 2.0{magnitude}{more}}}]'
    )


EXPERIMENTS = sorted(path.stem for path in (ROOT / "experiments").glob("*.toml"))
SCHEMES = [
    (f"cosim.scheme={scheme}", f"cosim.inputs={inputs}", f"cosim.iterations={iterations}")
    for scheme in ("gauss_seidel", "jacobi")
    for inputs in ("hold", "linear")
    for iterations in (1, 2)
]
KINDS = [kind for kind in FAULT_KINDS if kind != "drive_failure"]
BODIES = sorted(path.stem for path in (ROOT / "experiments" / "bodies").glob("*.toml"))
CHANGE = ('change=[{t_s = 5.0, key = "controller.force.kp_mm_per_N", value = 1.5}]',)
KEEPING = [drive for drive in drives() if drive not in STATELESS]

CASES = [
    *(Case(name, KEEPING[n % len(KEEPING)]) for n, name in enumerate(EXPERIMENTS)),
    *(Case("pressing", drive) for drive in KEEPING),
    *(Case("pressing", KEEPING[n % len(KEEPING)], (fault(kind),)) for n, kind in enumerate(KINDS)),
    *(Case("fig4_force_position", ("pmsm_foc", "stepper")[n % 2], one) for n, one in enumerate(SCHEMES)),
    Case("pressing", None, ("controller.delay_ticks=3",)),
    Case("pressing", None, ("monitor.enabled=false",)),
    Case("pressing", None, ("plant.motor_noise_deg=0.02", "seed=7")),
    Case("fig4_force_position", None, CHANGE),
    Case("fig4_force_position", "pmsm_foc", ("plant.substeps=3",)),
]
"""Each experiment, each drive, each kind of fault, each scheme at least once."""


PRESSED_ON = [Case("pressing", None, (f"contact.body={body}", fault(kind))) for body in BODIES for kind in KINDS[::4]]
"""Every fourth kind of fault on each body; all other pairs are in `test_state_combinations.py`."""


def ticks_of(experiment: Experiment) -> tuple[int, int]:
    """At which tick the state is taken, and how many are gone on."""
    at = min(AT, experiment.duration_ticks // 2 | 1)
    return at, min(AHEAD, experiment.duration_ticks - at)


def came_to(simulation: Simulation, at: int) -> np.ndarray:
    rows = simulation.advance(at).copy()
    assert simulation.next_tick == at and simulation.failure is None
    return rows


def ahead(simulation: Simulation, ticks: int) -> np.ndarray:
    rows = simulation.advance(ticks).copy()
    assert simulation.failure is None
    return rows


def natives(components: Sequence[Component]) -> Iterator[NativeComponent]:
    for component in components:
        if isinstance(component, Subsystem):
            yield from natives(component.system.components)
        elif isinstance(component, NativeComponent):
            yield component


@pytest.mark.parametrize("case", CASES, ids=str)
def test_going_on_from_a_state_is_never_having_stopped(case: Case):
    experiment = case.load()
    at, ticks = ticks_of(experiment)
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, at + ticks)
        came_to(simulation, at)
        expected = ahead(simulation, ticks)
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, at + ticks)
        came_to(simulation, at)
        state = simulation.state()
        content = state.saved().to_bytes()
        # that it was saved is seen in no output
        np.testing.assert_array_equal(ahead(simulation, ticks), expected)
        for _ in range(2):
            simulation.restore(state)
            np.testing.assert_array_equal(ahead(simulation, ticks), expected)
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, at + ticks)
        simulation.restore(SavedState.from_bytes(content, str(case)))
        np.testing.assert_array_equal(ahead(simulation, ticks), expected)
    # Fig. 4 with three FMUs is asked for in 20 kB
    assert len(content) < 20_000


@pytest.mark.parametrize("part", range(2))
def test_pairs_of_faults_and_bodies_go_on_from_a_state(part: int):
    for case in PRESSED_ON[part::2]:
        experiment = case.load()
        at, ticks = ticks_of(experiment)
        with assemble(experiment) as assembly:
            simulation = Simulation(assembly.system, experiment.duration_ticks, at + ticks)
            came_to(simulation, at)
            content = simulation.state().saved().to_bytes()
            expected = ahead(simulation, ticks)
        np.testing.assert_array_equal(going_on(case, content), expected, err_msg=str(case))


def test_a_state_goes_on_in_another_process(tmp_path: Path):
    cases = [Case("pressing", drive) for drive in KEEPING]
    left = tmp_path / "states"
    script = (
        "import pickle, sys; from pathlib import Path; from tests.laws.test_state import going_on; "
        "cases = pickle.loads(Path(sys.argv[1]).read_bytes()); "
        "Path(sys.argv[2]).write_bytes(pickle.dumps([going_on(*case) for case in cases]))"
    )
    expected, states = [], []
    for case in cases:
        experiment = case.load()
        at, ticks = ticks_of(experiment)
        with assemble(experiment) as assembly:
            simulation = Simulation(assembly.system, experiment.duration_ticks, at + ticks)
            came_to(simulation, at)
            states.append((case, simulation.state().saved().to_bytes()))
            expected.append(ahead(simulation, ticks))
    left.write_bytes(pickle.dumps(states))
    subprocess.run([sys.executable, "-c", script, left, tmp_path / "rows"], cwd=ROOT, check=True, timeout=300)
    for rows, wanted in zip(pickle.loads((tmp_path / "rows").read_bytes()), expected, strict=True):
        np.testing.assert_array_equal(rows, wanted)


def going_on(case: Case, content: bytes) -> np.ndarray:
    """Rows from a state on, in this process."""
    experiment = case.load()
    _, ticks = ticks_of(experiment)
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, ticks)
        simulation.restore(SavedState.from_bytes(content, str(case)))
        return ahead(simulation, ticks)


@pytest.mark.parametrize("case", [case for case in CASES if not case.settings or "fault" in case.settings[0]], ids=str)
def test_steps_change_nothing_that_is_not_declared(case: Case):
    experiment = case.load()
    at, _ = ticks_of(experiment)
    with assemble(experiment) as assembly:
        parts = list(natives(assembly.system.components))
        before = [(part.memory.copy(), {name: array.copy() for name, array in part.pointers.items()}) for part in parts]
        broken = {int(part.memory["address"][0]) for part in parts if "address" in (part.memory.dtype.names or ())}
        came_to(Simulation(assembly.system, experiment.duration_ticks, at), at)
        for part, (memory, arrays) in zip(parts, before, strict=True):
            # what steps may change is set to what it was: nothing else may differ then
            for name, view in part.pieces().items():
                was = arrays.get(name)
                view[...] = of_name(memory, name) if was is None else was
            left = part.memory.view(np.uint8) != memory.view(np.uint8)
            places = part.memory.ctypes.data + np.flatnonzero(left)
            # a parameter fault writes into the memory of another component, in every tick anew
            assert all(any(0 <= place - address < 8 for address in broken) for place in places.tolist()), part.name
            assert all(part.pointers[name].tobytes() == array.tobytes() for name, array in arrays.items())


def of_name(memory: np.ndarray, name: str) -> np.ndarray:
    for field in name.split("."):
        memory = memory[field]
    return memory


UNSEEN = {
    **dict.fromkeys(
        (f"{name}.inputs" for name in ("encoder", "estimator", "controller", "scale", "delay", "plant")),
        "set anew before each step; kept for sentences on a failure",
    ),
    **dict.fromkeys((f"drive_{joint}.inputs" for joint in (1, 2, 3)), "likewise"),
    "delay.outputs": "evaluated in this very tick",
    "controller.force.error": "of the derivative, which has no gain here; so are the next three",
    "controller.force.started": "",
    "controller.position.error": "",
    "controller.position.started": "",
    "controller.low": "worked out anew where it does not fit",
    "controller.segment": "found anew from the first segment on",
    "controller.triggered": "the force is above the threshold, and triggers anew",
    "estimator.newest": "written before it is read",
    "estimator.estimated": "the next sample has a pose, too",
    "plant.last": "for the sentence of a step that fails",
}
"""Pieces of the state of the run below that no output of it shows, and why."""


def test_every_other_piece_of_a_state_is_noticed_where_it_is_left_out():
    """Sabotage of each: it stays as it was before the first step."""
    case = Case("fig4_force_position", "ideal_velocity", ("controller.delay_ticks=3", "plant.motor_noise_deg=0.02"))
    experiment = case.load()
    with assemble(experiment) as assembly:
        simulation = Simulation(assembly.system, experiment.duration_ticks, AT + AHEAD)
        fresh = {key: array.copy() for key, array in pieces_of(simulation).items()}
        came_to(simulation, AT)
        state = simulation.state()
        expected = ahead(simulation, AHEAD)
        simulation.restore(state)
        moved = {key for key, array in pieces_of(simulation).items() if not np.array_equal(array, fresh[key])}
        unnoticed = set()
        for key, array in pieces_of(simulation).items():
            simulation.restore(state)
            array[...] = fresh[key]
            if key in moved and np.array_equal(simulation.advance(AHEAD), expected):
                unnoticed.add(key)
    assert {"plant.outputs", "plant.x", "controller.force.integral", "encoder.random", "delay.ring"} <= moved
    assert unnoticed == set(UNSEEN)


def pieces_of(simulation: Simulation) -> dict[str, np.ndarray]:
    return {f"{component}.{name}".lstrip("."): array for component, name, array in simulation._places._pieces}


def test_which_drives_have_no_state_is_known_and_said():
    found = {}
    for drive in drives():
        with assemble(twin.load("fig4_force_position", drive=drive)) as assembly:
            found[drive] = stateless_reasons(assembly.system.components)
    assert {drive for drive, sentences in found.items() if sentences} == STATELESS
    assert found["modelica_dc"][0] == "modelica_dc.fmu (drive_1) has no FMU state (canGetAndSetFMUState)"


def test_a_state_of_another_system_is_refused_with_what_differs():
    with assemble(twin.load("pressing")) as assembly:
        simulation = Simulation(assembly.system, 100, 50)
        simulation.advance()
        saved = simulation.state().saved()
    with assemble(twin.load("fig4_force_position")) as assembly:
        simulation = Simulation(assembly.system, 100, 50)
        with pytest.raises(
            InputRefused, match=r"the state is of another system: it has controller.outputs \(<f8 \[1, "
        ):
            simulation.restore(saved)
