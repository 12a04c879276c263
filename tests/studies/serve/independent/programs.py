"""Controller nodes that share nothing with twin but the robot's numbers: C with Cyclone DDS, C++ with Fast DDS.

They need cyclonedds-dev and libfastrtps-dev, which `.ci/run` installs.
"""

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest
from builder.c_table import variables_header
from builder.drive import load_drive

from tests.conftest import ROOT
from tests.fmu.paper_law import parameters
from twin.robot.experiment.experiment import Experiment
from twin.studies.build.study import build
from twin.studies.command import ignore_progress

HERE = Path(__file__).parent
TYPES = ROOT / "tests" / "studies" / "shadow" / "other_ends"
LAW = ROOT / "fmus" / "parts" / "paper_law"
HEADERS = ("dds/dds.h", "fastdds/dds/subscriber/DataReader.hpp")


def require_packages() -> None:
    """Skip a test without compilers or headers of both DDS libraries; CI must have them."""
    there = all(shutil.which(one) for one in ("cc", "c++"))
    if there and all(Path("/usr/include", one).is_file() for one in HEADERS):
        return
    assert "CI" not in os.environ, "CI must have cyclonedds-dev and libfastrtps-dev"
    pytest.skip("needs cc, c++, cyclonedds-dev and libfastrtps-dev")


def compile_with(*words: str | Path) -> None:
    """Run a compiler, and fail with its messages."""
    done = subprocess.run([*map(str, words)], capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr


def c_controller(experiment: str, folder: Path, settings: Sequence[str] = ()) -> Path:
    """Build `twin build EXPERIMENT --c` into a node with Cyclone DDS; return the program."""
    require_packages()
    part = folder / "computer"
    build(Path(experiment), ignore_progress, c=True, out=part, settings=settings)
    (library,) = part.glob("*/libcomputer.a")
    types = TYPES / "cyclone"
    compile_with(
        "cc", "-std=gnu11", "-O2", "-Wall", "-Werror", "-o", folder / "controller", HERE / "controller.c",
        types / "JointState.c", "-I", types, "-I", part, library, "-lddsc", "-lm",
    )  # fmt: skip
    return folder / "controller"


def other_law(experiment: Experiment, folder: Path) -> list[str]:
    """Build the law with its own mechanics into a node with Fast DDS; return its command line."""
    require_packages()
    (folder / "variables.h").write_text(variables_header(load_drive("paper_law")))
    include: list[str | Path] = ["-I", folder, "-I", LAW, "-I", ROOT / "fmus" / "fmi2"]
    objects: list[str | Path] = []
    for source in ("model.c", "motion.c", "pid.c", "machine.c", "tasks.c"):
        objects.append(folder / f"{source}.o")
        compile_with("cc", "-std=gnu11", "-O2", "-ffp-contract=off", "-c", "-o", objects[-1], LAW / source, *include)
    types = TYPES / "fast"
    compile_with(
        "c++", "-std=c++17", "-O1", "-o", folder / "law", HERE / "law.cpp", types / "JointState.cxx",
        types / "JointStatePubSubTypes.cxx", *objects, *include, "-I", types, "-lfastrtps", "-lfastcdr",
    )  # fmt: skip
    (folder / "robot.txt").write_text(robot_text(experiment))
    period = experiment.controller_ticks * experiment.cosim.tick
    return [str(folder / "law"), str(folder / "robot.txt"), repr(period)]


def robot_text(experiment: Experiment) -> str:
    """Write the robot's and the law's numbers as `law.cpp` reads them."""
    model, told = experiment.controller.model, parameters(experiment)
    names = ("a", "b", "l_a", "l_b", "m_a", "m_b", "m_p", "k_s", "N", "eta")
    lines = [f"{name} {getattr(model, name)!r}" for name in names]
    lines.append(f"dead_zone {experiment.controller.dead_zone!r}")
    if not experiment.tasks:
        way = experiment.reference
        assert way is not None
        lines += [f"way {t!r} {' '.join(map(repr, p))}" for t, p in zip(way.t, way.p, strict=True)]
    law = [float(told.get(one.name, one.start)) for one in load_drive("paper_law").variables]
    return "\n".join([*lines, "law " + " ".join(map(repr, law))]) + "\n"
