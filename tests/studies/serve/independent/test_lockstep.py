"""Controllers that nobody of twin wrote drive the served robot in lockstep as `twin run` drives it."""

from pathlib import Path

import numpy as np
import pytest

from tests.studies.serve.independent.conftest import Start, ended, serve_command
from tests.studies.serve.independent.programs import c_controller, other_law
from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute

pytestmark = pytest.mark.slow
CASES = {"fig4_force_position": (), "pressing": ("monitor.enabled=false",)}
TOLERANCE = 1e-9
"""Asked for, in SI; rounding in another library's and another algorithm's last bits gives 2e-13."""


def settings_of(name: str) -> list[str]:
    return [word for one in CASES[name] for word in ("--set", one)]


def signals(served: Recording, own: Recording) -> set[str]:
    """Signals of both recordings; a served robot has two topics more."""
    more = {name.partition(".")[0] for name in served.fields().keys() - own.fields().keys()}
    assert more == {"commands", "remote"} and not own.fields().keys() - served.fields().keys()
    return {*own.fields()}


@pytest.mark.parametrize("name", CASES)
def test_the_exported_controller_in_c_gives_every_signal_of_a_run_bit_for_bit(name: str, start: Start, tmp_path: Path):
    program = c_controller(name, tmp_path, CASES[name])
    node = start(program)
    facts = ended(start(*serve_command(name, tmp_path / "served", "--lockstep", *settings_of(name))))
    own = read(execute(load_experiment(name, CASES[name]), tmp_path / "own").recording)
    served = read(tmp_path / "served")
    samples = len(own["controller.omega_ref"])
    assert node.communicate(timeout=30)[0].split()[:3] == [str(samples), str(samples), "0"]
    assert facts["served"]["commands"] == facts["served"]["samples"] == samples and facts["served"]["deterministic"]
    for key in signals(served, own):
        assert served[key].tobytes() == own[key].tobytes(), key
    assert served["remote.omega_ref"].tobytes() == own["controller.omega_ref"].tobytes()


@pytest.mark.parametrize("name", CASES)
def test_another_law_with_mechanics_of_its_own_in_cpp_gives_them_to_rounding(name: str, start: Start, tmp_path: Path):
    experiment = load_experiment(name, CASES[name])
    start(*other_law(experiment, tmp_path))
    ended(start(*serve_command(name, tmp_path / "served", "--lockstep", *settings_of(name))))
    own, served = read(execute(experiment, tmp_path / "own").recording), read(tmp_path / "served")
    for key in signals(served, own):
        # of the controller that runs beside, unread, too: it has the same counts
        np.testing.assert_allclose(served[key].astype(float), own[key].astype(float), rtol=0, atol=TOLERANCE)
