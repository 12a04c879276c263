"""Swapping drives for hours: `make endurance`."""

import os
from itertools import cycle, islice
from pathlib import Path

import pytest

from twin.kernel.cosim.simulation import Simulation
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment

pytestmark = [
    pytest.mark.endurance,
    pytest.mark.skipif(not Path("/proc/self").exists(), reason="reads memory and handles from /proc"),
]

SWAPS = 300
WARM_UP = 2 * 9
"""Every drive twice: libraries, caches and allocators have then taken what they keep."""


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def handles() -> int:
    return len(os.listdir("/proc/self/fd"))


def mapped_libraries() -> int:
    return sum(".so" in line or "-drive" in line for line in Path("/proc/self/maps").read_text().splitlines())


def test_three_hundred_swaps_leak_neither_memory_nor_handles(root: Path):
    drives = sorted(path.parent.name for path in root.glob("fmus/*/*.fmu"))
    before: tuple[int, int, int] | None = None
    for number, drive in enumerate(islice(cycle(drives), SWAPS + WARM_UP)):
        if number == WARM_UP:
            before = resident_bytes(), handles(), mapped_libraries()
        experiment = load_experiment(root / "experiments/fig4_force_position.toml", drive=drive)
        with assemble(experiment) as assembly:
            simulation = Simulation(assembly.system, 50)
            simulation.run()
    assert before is not None
    memory, open_handles, libraries = before
    assert handles() == open_handles
    assert mapped_libraries() == libraries
    # 20 kB a swap would be 6 MB; allocators keep some pages whatever one does
    assert resident_bytes() - memory < 6 << 20
