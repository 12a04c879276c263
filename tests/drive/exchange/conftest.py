"""The FMUs of exchange.c, compiled once."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.drive.exchange.fmus import exchange_fmu
from twin.experiment.schema import Drive
from twin.runs.assembly.drives import DrivePlan, planned

Planner = Callable[..., DrivePlan]


@pytest.fixture(scope="session")
def exchange_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("exchange")


@pytest.fixture(scope="session")
def motor(exchange_folder: Path) -> Planner:
    """The drive of motor.c: motor(fmi=2, solver="rk4", i_max=0.3): keys of [drive], all others its parameters."""

    def plan(fmi: int = 2, **given: Any) -> DrivePlan:
        keys = {key: given.pop(key) for key in set(given) & {"solver", "solver_step_ms", "tolerance", "substeps"}}
        fmu = str(exchange_fmu(exchange_folder, "motor", fmi))
        return planned(Drive.model_validate({"fmu": fmu, "parameters": given, **keys}))

    return plan
