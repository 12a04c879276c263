"""The FMUs of exchange.c, compiled once."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.kernel.fmi.exchange.fmus import NoCompiler, exchange_fmu
from twin.robot.assembly.drives import DrivePlan, plan_drive
from twin.robot.experiment.schema import Drive

Planner = Callable[..., DrivePlan]


@pytest.fixture(scope="session")
def exchange_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the FMUs are made; skips without a compiler, but not on CI, which has one."""
    folder = tmp_path_factory.mktemp("exchange")
    try:
        exchange_fmu(folder, "motor", 2)
    except NoCompiler as problem:
        assert "CI" not in os.environ, "this test compiles a drive and CI has to have a C compiler"
        pytest.skip(str(problem))
    return folder


@pytest.fixture(scope="session")
def motor(exchange_folder: Path) -> Planner:
    """The drive of motor.c: motor(fmi=2, solver="rk4", i_max=0.3): keys of [drive], all others its parameters."""

    def plan(fmi: int = 2, **given: Any) -> DrivePlan:
        keys = {key: given.pop(key) for key in set(given) & {"solver", "solver_step_ms", "tolerance", "substeps"}}
        fmu = str(exchange_fmu(exchange_folder, "motor", fmi))
        return plan_drive(Drive.model_validate({"fmu": fmu, "parameters": given, **keys}))

    return plan
