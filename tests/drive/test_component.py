from pathlib import Path

import numpy as np
import pytest

from tests.drive.archives import altered, redescribed
from twin.cosim.component import Port
from twin.cosim.python_component import PythonComponent
from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.drive.component import DriveShop
from twin.drive.description import described
from twin.errors import InputRefused

TICK = 1e-3


class Bench:
    """Commands a speed and holds a load."""

    inputs = ()
    outputs = (Port("omega_ref", 1, "rad/s"), Port("tau_load", 1, "N m"))
    sampled = True

    def __init__(self, omega_ref: float, tau_load: float):
        self.values = omega_ref, tau_load

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        y[:] = self.values


@pytest.fixture
def shop():
    shop = DriveShop()
    yield shop
    shop.close()


def run(shop: DriveShop, fmu: Path, parameters: dict[str, float], omega_ref: float, tau_load: float, theta_m: float):
    drive = shop.drive("drive_1", described(fmu), parameters, theta_m, tau_load)
    bench = PythonComponent("bench", Bench(omega_ref, tau_load))
    wires = [("bench.omega_ref", "drive_1.omega_ref"), ("bench.tau_load", "drive_1.tau_load")]
    system = System([bench, drive], wires, TICK)
    rows = Simulation(system, 1000).run()
    return rows[:, system.columns("drive_1.theta_m")][:, 0], rows[:, system.columns("drive_1.omega_m")][:, 0]


def test_the_servo_settles_at_the_command_less_droop_times_load(shop: DriveShop, root: Path):
    _, omega_m = run(shop, root / "fmus/velocity_servo", {"droop": 0.5}, 2.0, 0.1, 0.0)
    # 50 time constants after the step
    assert omega_m[-1] == pytest.approx(2.0 - 0.5 * 0.1, rel=1e-12)


def test_the_shaft_is_coupled_at_the_angle_it_starts_with(shop: DriveShop, root: Path):
    theta_m, _ = run(shop, root / "fmus/ideal_velocity", {}, 2.0, 0.0, 0.75)
    assert theta_m[0] == 0.75
    # sums of 1,000 rounded increments
    assert theta_m[-1] == pytest.approx(0.75 + 2.0 * 1.0, abs=1e-12)


def test_drives_of_one_file_do_not_share_their_state(shop: DriveShop, root: Path):
    description = described(root / "fmus/velocity_servo")
    drives = [shop.drive(f"drive_{i}", description, {}, 0.0, 0.0) for i in (1, 2)]
    benches = [PythonComponent(f"bench_{i}", Bench(float(i), 0.0)) for i in (1, 2)]
    wires = [
        (f"bench_{i}.{port}", f"drive_{i}.{port}") for i in (1, 2) for port in ("omega_ref", "tau_load")
    ]
    system = System([*benches, *drives], wires, TICK)
    last = Simulation(system, 1000).run()[-1]
    assert last[system.columns("drive_2.omega_m")][0] == pytest.approx(2 * last[system.columns("drive_1.omega_m")][0])


def test_a_wrong_guid_is_refused_with_the_reason(shop: DriveShop, root: Path, tmp_path: Path):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    guid = described(good).model.guid
    bad = redescribed(good, tmp_path / "bad.fmu", guid, "{00000000-0000-0000-0000-000000000000}")
    with pytest.raises(InputRefused, match="fmi2Instantiate refused") as refused:
        shop.drive("drive_1", described(bad), {}, 0.0, 0.0)
    assert "bad.fmu" in str(refused.value)
    assert "GUID" in str(refused.value)


def test_a_library_that_does_not_load_is_refused(shop: DriveShop, root: Path, tmp_path: Path):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    bad = altered(good, tmp_path / "bad.fmu", lambda n, c: (n, b"no library" if n.startswith("binaries/") else c))
    here = Path.cwd()
    with pytest.raises(InputRefused, match="its binary does not load"):
        shop.drive("drive_1", described(bad), {}, 0.0, 0.0)
    assert Path.cwd() == here


def test_closing_the_shop_removes_what_was_unpacked(root: Path):
    shop = DriveShop()
    shop.drive("drive_1", described(root / "fmus/velocity_servo"), {}, 0.0, 0.0)
    folders = list(shop._folders.values())
    assert all(folder.is_dir() for folder in folders)
    shop.close()
    shop.close()
    assert not any(folder.exists() for folder in folders)
