"""The robot of an experiment taken apart for another master: FMUs, wires, and what the twin's own run gave."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from shutil import copyfile

import numpy as np
from fmpy import read_model_description
from numpy.typing import NDArray

from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import Trace, run_in_memory
from twin.studies.build.fmu import build_fmu

ROOT = Path(__file__).parents[2]
PLACE = ROOT / "results" / "validation"
"""Where the parts are left, to be opened in another tool."""
JACOBI = ("cosim.scheme=jacobi", "controller.bus_delay_ticks=1")
"""What a master in which all exchange their values between steps comes to."""
DRIVES = ("drive_1", "drive_2", "drive_3")
UNMATCHED = {"plant.theta_m_rest", "bus.omega_ref", "bus.power"}
"""An output that no recording has, and the delay that in another master is its own."""

Signals = Mapping[str, NDArray[np.float64]]
"""Values after each step by `component.name`, (ticks + 1, size); the first row, before any step, is not compared."""


@dataclass(frozen=True)
class Case:
    """What is run.

    Attributes:
        experiment: name of the file.
        duration: of the run (s).
        settings: laid over the experiment.
        remark: what they do, in a word.
    """

    experiment: str
    duration: float
    settings: tuple[str, ...] = ()
    remark: str = ""

    def __str__(self) -> str:
        return f"{self.duration:g} s of {self.experiment}{self.remark and f' {self.remark}'}"


@dataclass(frozen=True)
class Wire:
    """From an output to an input.

    Attributes:
        source: component and variable.
        target: the same.
        offset: that is added on the way: a drive counts from a zero of its own.
    """

    source: tuple[str, str]
    target: tuple[str, str]
    offset: float = 0.0


@dataclass(frozen=True)
class Robot:
    """What another master is given, and what is expected of it.

    Attributes:
        folder: where its FMUs are.
        files: FMU of each component; FMI 2.0, arrays are scalars `p_B[1]`..
        parameters: of components, set before initialisation.
        wires: all of them.
        outputs: names of the outputs of each component.
        zeros: angle of each motor where its drive counts 0 (rad): where the robot rests at the beginning.
        own: the twin's own run in the corresponding scheme.
    """

    folder: Path
    files: Mapping[str, Path]
    parameters: Mapping[str, Mapping[str, float]]
    wires: tuple[Wire, ...]
    outputs: Mapping[str, tuple[str, ...]]
    zeros: Mapping[str, float]
    own: Trace

    @property
    def ticks(self) -> int:
        """How many steps of `own.tick` there are."""
        return len(self.own.t) - 1

    def starting_inside(self) -> "Robot":
        """The same for a master whose wires cannot add: the drives are given their start angles."""
        parameters = {name: {**self.parameters[name], "theta_m": self.zeros[name]} for name in DRIVES}
        wires = tuple(replace(wire, offset=0.0) for wire in self.wires)
        return replace(self, parameters=parameters, wires=wires, zeros=dict.fromkeys(DRIVES, 0.0))


class Rows:
    """What a master gives, written down tick by tick.

    Attributes:
        values: of each component, (ticks + 1, number of its outputs), in the order of `Robot.outputs`.
    """

    def __init__(self, robot: Robot):
        self.values = {name: np.full((robot.ticks + 1, len(names)), np.nan) for name, names in robot.outputs.items()}
        self._robot = robot

    def signals(self) -> Signals:
        """The same by signal; those of a drive are called after it, and its angle is the motor's."""
        columns: dict[str, list[NDArray[np.float64]]] = {}
        for component, names in self._robot.outputs.items():
            for i, name in enumerate(names):
                key = f"{component}.{name}" if component in DRIVES else name.partition("[")[0]
                zero = self._robot.zeros[component] if component in DRIVES and name == "theta_m" else 0.0
                columns.setdefault(key, []).append(self.values[component][:, i] + zero)
        return {key: np.column_stack(found) for key, found in columns.items()}


@cache
def robot(case: Case) -> Robot:
    """The robot of an experiment for a Jacobi master.

    Raises:
        InputRefused: a part cannot be built here.
    """
    path = ROOT / "experiments" / f"{case.experiment}.toml"
    settings = [f"duration_s={case.duration}", *case.settings]
    loaded = load_experiment(path, [*settings, *JACOBI])
    own = run_in_memory(loaded)
    folder = PLACE / f"{case.experiment}{case.remark and '_' + case.remark.replace(' ', '_').replace('/', '_')}"
    folder.mkdir(parents=True, exist_ok=True)
    files = {part: folder / f"{part}.fmu" for part in ("plant", "computer")}
    for part, file in files.items():
        # without the delay: the computer has that of its own step
        build_fmu(path, part, "2.0", (), file, settings, lambda what: None)
    drive = folder / "drive.fmu"
    copyfile(str(loaded.drives[0].fmu), drive)
    files |= dict.fromkeys(DRIVES, drive)
    outputs = {
        component: tuple(v.name for v in read_model_description(str(file)).modelVariables if v.causality == "output")
        for component, file in files.items()
    }
    zeros = dict(zip(DRIVES, own.of_drives("theta_m")[0].tolist(), strict=True))
    parameters = {name: {"droop": float(str(loaded.drives[0].parameters["droop"]))} for name in DRIVES}
    return Robot(folder, files, parameters, _wires(outputs, zeros), outputs, zeros, own)


def _wires(outputs: Mapping[str, tuple[str, ...]], zeros: Mapping[str, float]) -> tuple[Wire, ...]:
    command = "monitor.omega_ref" if "monitor.omega_ref[1]" in outputs["computer"] else "controller.omega_ref"
    wires: list[Wire] = []
    for i, drive in enumerate(DRIVES, 1):
        wires += [
            Wire((drive, "theta_m"), ("plant", f"theta_m[{i}]"), zeros[drive]),
            Wire((drive, "theta_m"), ("computer", f"theta_m[{i}]"), zeros[drive]),
            Wire(("plant", f"plant.theta_l[{i}]"), ("computer", f"theta_l[{i}]")),
            Wire(("plant", f"plant.tau_load[{i}]"), (drive, "tau_load")),
            Wire(("computer", f"{command}[{i}]"), (drive, "omega_ref")),
        ]
    return tuple(wires)


def differences(signals: Signals, own: Trace) -> dict[str, float]:
    """Largest difference of each signal as a part of the range it has in the twin's run; of a constant as it is.

    What is sampled at the start of a step is published at its end: a tick later than in the twin.

    Args:
        signals: of another master in which all exchange their values between steps.
        own: the twin's own run in that scheme.

    Raises:
        ValueError: the other master does not have exactly the signals of the run.
    """
    known = {key.replace("drive/", "drive_"): key for key in own.fields()}
    if odd := (signals.keys() ^ known.keys()) - UNMATCHED:
        raise ValueError(f"on one side only: {', '.join(sorted(odd))}")
    found = {}
    for signal in (key for key in known if key in signals):
        theirs, ours = signals[signal], own.held(known[signal]).astype(float).reshape(len(own.t), -1)
        ours = ours[1:] if signal.startswith(("drive_", "plant.")) else ours[:-1]
        found[signal] = float(np.max(np.abs(theirs[1:] - ours))) / (float(np.ptp(ours)) or 1.0)
    return found
