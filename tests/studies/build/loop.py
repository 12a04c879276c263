"""A master in some lines: it steps slaves in their order, and hands their values on at once or between steps."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.studies.build.slaves import Ends, Slave
from twin.robot.run.trace import Trace

PLANT = [
    "plant.p_B", "plant.v_B", "plant.theta_l", "plant.omega_l", "plant.tau_l", "plant.tau_load", "plant.F_ee_B",
    "plant.F_n", "plant.z_b", "scale.F_z",
]  # fmt: skip
COMPUTER = [
    "encoder.count_m", "encoder.count_l", "estimator.theta_m", "estimator.p_B", "estimator.J", "estimator.tau_l",
    "estimator.F_ee_B", "controller.omega_ref", "controller.p_ref_B", "controller.p_cmd_B", "controller.dp_z",
    "controller.triggered", "controller.F_z",
]  # fmt: skip

Source = tuple[str, int | None]
"""A signal, and which value of it, or all."""
Wires = Mapping[str, Mapping[str, Sequence[Source]]]
"""By slave and input what feeds it, joined."""
Signals = dict[str, NDArray[np.float64]]


def stepped(slaves: Mapping[str, Slave], wires: Wires, ticks: int, jacobi: bool, zeros: Mapping[str, float]) -> Signals:
    """All outputs of `slaves` at every tick (ticks + 1, size), `plant.p_B`, `drive_1.theta_m`; they are closed then.

    Args:
        slaves: initialised, in the order in which they are stepped.
        wires: between them.
        ticks: how many steps of 1 ms.
        jacobi: whether all see what was valid at the beginning of the step; else each sees the newest values.
        zeros: where the shaft of a slave counts from, rad.
    """
    columns: dict[str, list[int]] = {}
    places, width = {}, 0
    for name, slave in slaves.items():
        first = width
        for output in slave.outputs():
            size = sum(slave.sizes[reference] for reference in slave.references(output))
            columns[output if "." in output else f"{name}.{output}"] = list(range(width, width + size))
            width += size
        places[name] = slice(first, width)
    gives = {name: Ends(slave, _references(slave, slave.outputs())) for name, slave in slaves.items()}
    takes = {name: Ends(slave, _references(slave, wires[name])) for name, slave in slaves.items()}
    fed = {
        name: np.array([c for port in wires[name].values() for of, n in port for c in columns[of][_chosen(n)]])
        for name in slaves
    }
    rows = np.zeros((ticks + 1, width))
    shift = {name: (columns[f"{name}.theta_m"][0], zero) for name, zero in zeros.items()}
    order = [
        (slave.step, takes[name], fed[name], gives[name], places[name], shift.get(name))
        for name, slave in slaves.items()
    ]
    for k in range(-1, ticks):
        row = rows[k + 1]
        row[:] = rows[max(k, 0)]
        seen = rows[k] if jacobi else row
        for step, end, sources, given, place, zero in order:
            if k >= 0:
                end.put(seen[sources])
                step(k)
            row[place] = given.take()
            if zero is not None:
                row[zero[0]] += zero[1]
    for slave in slaves.values():
        slave.close()
    return {name: rows[:, at] if len(at) > 1 else rows[:, at[0]] for name, at in columns.items()}


def _references(slave: Slave, names: Iterable[str]) -> list[int]:
    return [reference for name in names for reference in slave.references(name)]


def _chosen(n: int | None) -> slice:
    return slice(None) if n is None else slice(n, n + 1)


def looped(
    plant: Slave,
    computer: Slave,
    drive: Path,
    droop: float,
    theta_m: NDArray[np.float64],
    ticks: int,
    jacobi: bool,
    command: str = "controller.omega_ref",
    behind_second: Slave | None = None,
) -> Signals:
    """The robot: what `plant`, `computer`, `drive_1` to `drive_3` and, if there is one, `fault_1` gave.

    Args:
        plant, computer: initialised.
        drive: FMU of each joint, with the parameter droop.
        theta_m: motor angles at the start (3,), rad: a drive counts from its own zero.
        ticks, jacobi: see `stepped`.
        command: the output of the computer that the drives get.
        behind_second: a fault between the second drive and all who see its shaft.
    """
    torque = plant.get("plant.tau_load")
    drives = {f"drive_{i + 1}": Slave(drive, {"droop": droop}, {"tau_load": torque[i]}).ready() for i in range(3)}
    shafts: list[Source] = [(f"{name}.theta_m", None) for name in drives]
    slaves = {"computer": computer} | drives
    wires: dict[str, dict[str, list[Source]]] = {
        name: {"omega_ref": [(command, i)], "tau_load": [("plant.tau_load", i)]} for i, name in enumerate(drives)
    }
    if behind_second is not None:
        slaves["fault_1"] = behind_second
        wires["fault_1"] = {
            "theta_m": [shafts[1]], "tau_load": [("plant.tau_load", 1)], "power": [("monitor.power", None)]
        }  # fmt: skip
        shafts[1] = ("fault_1.theta_m", None)
    wires["computer"] = {"theta_m": shafts, "theta_l": [("plant.theta_l", None)]}
    wires["plant"] = {"theta_m": shafts}
    zeros = {name: float(theta_m[i]) for i, name in enumerate(drives)}
    return stepped(slaves | {"plant": plant}, wires, ticks, jacobi, zeros)


def differing(signals: Signals, run: Trace) -> list[str]:
    """Signals of a loop that are not the twin's own in every bit of every tick."""
    found = []
    for name in signals.keys() - {"plant.theta_m_rest"}:
        signal, own = signals[name], run.held(re.sub(r"^(drive|fault)_", r"\1/", name))
        # what is sampled is published at the end of its step
        continuous = name.startswith(("plant.", "drive_", "fault_"))
        same = np.array_equal(signal, own) if continuous else np.array_equal(signal[1:], own[:-1])
        found += [] if same else [name]
    return found
