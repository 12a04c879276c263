"""A built plant in the hands of a master that makes mistakes, goes back, and has several."""

import ctypes
import subprocess
import sys
from ast import literal_eval
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.studies.build.conftest import DELAYED, FIG4, MASSAGE, silent
from tests.studies.build.slaves import Slave
from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.plant.component import Plant, rest_state
from twin.studies.build import linking
from twin.studies.build.fmu import build_fmu
from twin.studies.build.linking import HOST_PLATFORM, c_files

FORCE = "plant.F_ee_B"


@pytest.fixture
def plant(built: Callable[..., Path]) -> Iterator[Slave]:
    slave = Slave(built("plant", "3.0"))
    yield slave
    slave.close()


def refused(slave: Slave, act: Callable[[], object], sentence: str) -> None:
    """`act` fails, and the FMU says why."""
    with pytest.raises(Exception, match=r"(?i)status 3|fmi\dError|failed"):
        act()
    assert sentence in slave.said[-1]


def moved(slave: Slave, first: int, last: int) -> list[float]:
    """What pressing with the motors for some ticks comes to."""
    theta_m = slave.get("plant.theta_m_rest")
    for k in range(first, last):
        slave.set({"theta_m": theta_m + 0.01 * np.sin(0.01 * k)})
        slave.step(k)
    return [*slave.get("plant.p_B"), *slave.get(FORCE), *slave.get("plant.z_b")]


def test_a_step_that_is_no_multiple_of_the_tick_is_refused_with_a_message(plant: Slave) -> None:
    plant.ready()
    step = plant.fmu.doStep
    refused(plant, lambda: step(0.0, 0.0015), "DoStep over 0.0015")
    refused(plant, lambda: step(0.0, 0.0005), "expected a multiple of the tick, 0.001 s")
    refused(plant, lambda: step(0.0, float("nan")), "expected a multiple")
    refused(plant, lambda: step(0.0, -0.001), "expected a multiple")
    refused(plant, lambda: step(0.005, 0.001), "the time reached is 0 s")
    plant.step(0)


def test_a_step_of_several_ticks_is_so_many_steps_of_one(built: Callable[..., Path]) -> None:
    one, many = Slave(built("plant")).ready(), Slave(built("plant")).ready()
    for slave in (one, many):
        slave.set({"theta_m": slave.get("plant.theta_m_rest") + 0.05})
    for k in range(10):
        one.step(k)
    many.step(0, ticks=10)
    assert np.array_equal(one.get("plant.p_B"), many.get("plant.p_B"))
    assert one.get("plant.v_B")[2] != 0.0
    one.close()
    many.close()


def test_values_that_no_experiment_may_have_are_refused(plant: Slave) -> None:
    refused(plant, lambda: plant.set({"plant.k_s_Nm_per_rad": 0.0}), "expected more than 0")
    refused(plant, lambda: plant.set({"plant.eta": 1.5}), "expected at most 1")
    refused(plant, lambda: plant.set({"plant.m_p_g": -1.0}), "expected at least 0")
    refused(plant, lambda: plant.set({"plant.m_p_g": float("nan")}), "is not finite")
    refused(plant, lambda: plant.set({FORCE: [0.0, 0.0, 0.0]}), "is an output")
    plant.ready()
    refused(plant, lambda: plant.set({"plant.k_s_Nm_per_rad": 1.1}), "before the end of initialization")


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_no_step_leads_beyond_the_stop_time(built: Callable[..., Path], fmi: str) -> None:
    # as a master may have added it up
    slave = Slave(built("plant", fmi), stop=0.1 + 0.2).ready()
    slave.step(0, 299)
    for ticks in (2, 10**8):
        with pytest.raises(Exception, match=r"(?i)status 3|fmi\dError|failed"):
            slave.step(299, ticks)
    assert fmi == "2.0" or "leads beyond the stop time, 0.3" in slave.said[-1]
    # what was refused has done nothing
    slave.step(299)
    with pytest.raises(Exception, match=r"(?i)status 3|fmi\dError|failed"):
        slave.step(300)
    slave.close()


def test_a_stop_time_before_the_start_is_refused(built: Callable[..., Path]) -> None:
    for stop in (-1.0, float("nan")):
        with pytest.raises(Exception, match=r"(?i)status 3|fmi\dError|failed"):
            Slave(built("plant", "3.0"), stop=stop)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
@pytest.mark.parametrize("angle", [float("nan"), float("inf"), -float("inf"), 1e300, -1e14])
def test_an_angle_that_has_no_count_is_an_error(built: Callable[..., Path], fmi: str, angle: float) -> None:
    slave = Slave(built("computer", fmi)).ready()
    slave.step(0)
    sound = slave.get("theta_l")
    slave.set({"theta_l": [sound[0], sound[1], angle]})
    with pytest.raises(Exception, match=r"(?i)status 3|fmi\dError|failed"):
        slave.step(1, 2)
    assert fmi == "2.0" or "encoder: got an angle that it cannot count" in slave.said[-1]
    # the robot is not told anything that would follow from it
    with pytest.raises(Exception, match=r"(?i)status 3|fmi\dError|failed"):
        slave.step(2)
    slave.close()


def test_an_unreachable_start_is_refused_in_words(plant: Slave) -> None:
    plant.set({"start.p_B": [0.0, 0.0, -0.5]})
    refused(plant, plant.ready, "left the workspace")


def test_a_robot_that_leaves_its_workspace_fails_until_it_is_put_back(plant: Slave) -> None:
    state = plant.ready().fmu.getFMUState()
    plant.set({"theta_m": [1e4, -1e4, 1e4]})
    with pytest.raises(Exception, match=r"(?i)failed"):
        for k in range(1000):
            plant.step(k)
    assert plant.said[-1].startswith("plant: ")
    refused(plant, lambda: plant.step(0), "not allowed in mode failed")
    plant.fmu.setFMUState(state)
    plant.set({"theta_m": plant.get("plant.theta_m_rest")})
    plant.step(0)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_state_comes_back_also_as_bytes_and_in_another_instance(built: Callable[..., Path], fmi: str) -> None:
    slave, other = Slave(built("plant", fmi)).ready(), Slave(built("plant", fmi)).ready()
    moved(slave, 0, 300)
    fmu, second = slave.fmu, other.fmu
    state = fmu.getFMUState() if slave.new else fmu.getFMUstate()
    content = fmu.serializeFMUState(state) if slave.new else fmu.serializeFMUstate(state)
    there = moved(slave, 300, 600)
    (fmu.setFMUState if slave.new else fmu.setFMUstate)(state)
    assert moved(slave, 300, 600) == there
    if slave.new:
        second.setFMUState(second.deserializeFMUState(content))
    else:
        second.setFMUstate(second.deSerializeFMUstate(content))
    assert moved(other, 300, 600) == there
    slave.close()
    other.close()


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_a_state_is_gone_on_from_in_another_process(built: Callable[..., Path], tmp_path: Path, root: Path, fmi: str):
    file = built("plant", fmi)
    slave = Slave(file).ready()
    moved(slave, 0, 300)
    state = slave.fmu.getFMUState() if slave.new else slave.fmu.getFMUstate()
    content = slave.fmu.serializeFMUState(state) if slave.new else slave.fmu.serializeFMUstate(state)
    (tmp_path / "state").write_bytes(content)
    there = moved(slave, 300, 600)
    slave.close()
    script = "import sys; from tests.studies.build.test_slave import gone_on; print(gone_on(*sys.argv[1:]))"
    line = [sys.executable, "-c", script, str(file), str(tmp_path / "state")]
    assert literal_eval(subprocess.check_output(line, cwd=root, text=True, timeout=120)) == there


def gone_on(file: str, state: str) -> list[float]:
    """The same from a state that another process has written down, by FMPy alone."""
    slave = Slave(Path(file)).ready()
    state_there = slave.fmu.deserializeFMUState(Path(state).read_bytes())
    slave.fmu.setFMUState(state_there)
    return [float(value) for value in moved(slave, 300, 600)]


def test_a_state_of_another_build_is_refused(built: Callable[..., Path]) -> None:
    # of the same size
    one, two = (Slave(built("encoder", "3.0", (f"plant.motor_zero_deg=[{zero},0,0]",))).ready() for zero in (0.0, 1.0))
    content = one.fmu.serializeFMUState(one.fmu.getFMUState())
    refused(two, lambda: two.fmu.deserializeFMUState(content), "not a state of this FMU")
    refused(two, lambda: two.fmu.setFMUState(one.fmu.getFMUState()), "no state of this FMU")
    one.close()
    two.close()


def test_a_computer_with_a_ring_of_memory_goes_back_too(built: Callable[..., Path]) -> None:
    # way points and delay are behind pointers, which belong to an instance
    slave, other = (Slave(built("computer", "2.0", DELAYED, str(MASSAGE))).ready() for _ in range(2))
    angles = slave.get("theta_m"), slave.get("theta_l")

    def run(which: Slave, first: int) -> list[float]:
        for k in range(first, first + 50):
            which.set({"theta_m": angles[0] + 1e-3 * k, "theta_l": angles[1] + 5e-4 * k})
            which.step(k)
        return [*which.get("delay.omega_ref"), *which.get("controller.p_ref_B")]

    run(slave, 0)
    content = slave.fmu.serializeFMUstate(slave.fmu.getFMUstate())
    after = run(slave, 50)
    slave.close()
    other.fmu.setFMUstate(other.fmu.deSerializeFMUstate(content))
    assert run(other, 50) == after
    assert any(after[:3])
    other.close()


def test_a_reset_makes_an_instance_new(plant: Slave) -> None:
    plant.set({"plant.k_s_Nm_per_rad": 1.3})
    first = moved(plant.ready(), 0, 100)
    plant.fmu.reset()
    assert plant.get("plant.k_s_Nm_per_rad") == 1.0
    plant.fmu.enterInitializationMode(startTime=0.0)
    assert moved(plant.ready(), 0, 100) != first


def test_a_tunable_gain_may_change_between_two_steps(built: Callable[..., Path]) -> None:
    slave = Slave(built("computer")).ready()
    seen = {"theta_m": slave.get("theta_m"), "theta_l": slave.get("theta_l") + 0.01}
    slave.set(seen)
    slave.step(0, ticks=2)
    before = slave.get("controller.omega_ref")
    slave.set({"controller.position.kp_per_s": 3.0})
    slave.step(2, ticks=2)
    assert np.allclose(slave.get("controller.omega_ref"), 2.0 * before, rtol=1e-12)
    slave.close()


def test_it_rests_where_the_twin_does_wherever_it_starts(built: Callable[..., Path]) -> None:
    experiment = load_experiment("fig4_force_position")
    parameters = plant_parameters(experiment.plant, experiment.contact)
    rng = np.random.default_rng(7)
    for _ in range(20):
        p_B = [*rng.uniform(-0.02, 0.02, 2), rng.uniform(-0.11, -0.08)]
        x, theta_m = rest_state(parameters, p_B)
        slave = Slave(built("plant"), {"start.p_B": p_B})
        # Cramer's rule instead of LAPACK, angles near 1 rad
        assert np.allclose(slave.get("plant.theta_m_rest"), theta_m, rtol=0.0, atol=1e-14)
        slave.set({"theta_m": theta_m})
        slave.ready()
        plant = Plant(parameters, x, theta_m)
        assert np.array_equal(slave.get("plant.tau_load"), plant.initial("tau_load"))
        assert np.array_equal(slave.get(FORCE), plant.initial("F_ee_B"))
        slave.close()


def test_another_builds_description_is_refused(built: Callable[..., Path]) -> None:
    slave = Slave(built("plant")).ready()
    instantiate = slave.fmu.dll.fmi2Instantiate
    instantiate.restype = ctypes.c_void_p
    assert instantiate(b"it", 1, b"{other}", b"", None, 0, 0) is None
    slave.close()


def test_every_form_of_a_step_gives_the_same_bits(
    built: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    richest = Slave(built("plant")).ready()
    expected = moved(richest, 0, 300)
    richest.close()
    flags = Path("/proc/cpuinfo").read_text().split()
    for n, form in enumerate(HOST_PLATFORM.forms):
        if not all(feature in flags for feature in form.features.replace("+", "").split(",") if feature):
            continue

        def held(*names: str, n: int = n) -> dict[str, bytes]:
            files = c_files(*names)
            assert files["part.c"].count(b"form = processor_form();") == 1
            return files | {"part.c": files["part.c"].replace(b"form = processor_form();", b"form = %d;" % n)}

        monkeypatch.setattr(linking, "c_files", held)
        file = tmp_path / f"plant{form.suffix}.fmu"
        build_fmu(FIG4, "plant", "2.0", [], file, [], silent)
        slave = Slave(file).ready()
        assert moved(slave, 0, 300) == expected, form
        slave.close()
