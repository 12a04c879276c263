"""Fig. 4 as a system of FMUs, written by hand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.conftest import ROOT
from tests.studies.systems.archives import archive, component, connection, connector, line, structure, system, values

DRIVE = ROOT / "fmus" / "velocity_servo" / "velocity_servo.fmu"
LEGS = (1, 2, 3)


def fig4(file: Path, built: Callable[..., Path], droop: float, theta_m: np.ndarray, stop: float = 20.0) -> Path:
    """Fig. 4 as an SSP: computer, drives, plant; a drive counts from its own zero."""
    wires = []
    for i, zero in zip(LEGS, theta_m, strict=True):
        shift = line(offset=repr(float(zero)))
        wires += [
            connection(f"computer.controller.omega_ref[{i}]", f"drive_{i}.omega_ref"),
            connection(f"plant.plant.tau_load[{i}]", f"drive_{i}.tau_load"),
            connection(f"drive_{i}.theta_m", f"plant.theta_m[{i}]", shift),
            connection(f"drive_{i}.theta_m", f"computer.theta_m[{i}]", shift),
            connection(f"plant.plant.theta_l[{i}]", f"computer.theta_l[{i}]"),
        ]
    speed = connector("omega_ref", "input", "rad/s")
    parts = [
        component("computer", "resources/computer.fmu"),
        *(component(f"drive_{i}", "resources/drive.fmu", [speed], values(f"droop={droop!r}")) for i in LEGS),
        component("plant", "resources/plant.fmu"),
    ]
    resources = {"computer": built("computer"), "drive": DRIVE, "plant": built("plant")}
    return archive(
        file,
        structure(system(parts, wires), stop),
        {f"resources/{name}.fmu": path for name, path in resources.items()},
    )
