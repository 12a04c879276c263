"""The robot's computer as C: compiled, fed with recorded counts, and held to the recording."""

import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.studies.build.conftest import FIG4, ROOT, silent
from tests.studies.build.test_open_parameters import another
from twin.kernel.compiled.machine import MATH_SYMBOLS
from twin.kernel.fmi.unpacked import compiler_command
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import Trace, run_in_memory
from twin.studies.build.library import COMMAND_PORTS, COUNT_PORTS, LIBRARY_PART, build_c
from twin.studies.build.part import open_parameters, part_of

MASSAGE = ROOT / "experiments" / "massage.toml"
LIFE = Path(__file__).with_name("life.c")
TICKS = 1500
Signals = dict[str, NDArray[np.float64]]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Writes the C of an experiment, once for each."""
    done = dict[tuple[object, ...], Path]()

    def write(experiment: Path, settings: tuple[str, ...] = (), platforms: tuple[str, ...] = ()) -> Path:
        key = experiment, settings, platforms
        if key not in done:
            done[key] = tmp_path_factory.mktemp("c")
            build_c(experiment, platforms, done[key], settings, silent)
        return done[key]

    return write


def program(folder: Path, source: Path, name: str) -> str:
    """A C program with the library, made by the platform's compiler."""
    target = folder / name
    library = folder / "x86_64-linux" / "libcomputer.a"
    # warnings are mistakes: it is the header that they would be about
    strict = ["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    subprocess.run(
        [*compiler_command(target), *strict, "-O2", f"-I{folder}", str(source), str(library), "-lm", "-o", str(target)],
        check=True,
    )
    return str(target)


def sizes(experiment: Path, settings: Sequence[str] = ()) -> dict[str, int]:
    """The outputs of the C by their names, and how many values each has."""
    part = part_of(load_experiment(experiment, settings), LIBRARY_PART)
    found = {port.name: port.size for port in COMMAND_PORTS.values()}
    return found | {f"{c.name}.{port.name}": port.size for c in part.components for port in c.outputs}


def recorder(outputs: Mapping[str, int], assigned: Mapping[str, Sequence[float]]) -> str:
    """A program that feeds it the counts of standard input and gives all its outputs, both as doubles."""
    told = [f"told.{name}" + (f"[{n}]" if size > 1 else "") for name, size in outputs.items() for n in range(size)]
    counts = [f"counts.{p.name}" + (f"[{n}]" if p.size > 1 else "") for p in COUNT_PORTS for n in range(p.size)]
    lines = [
        f"all.{key}{f'[{n}]' if len(values) > 1 else ''} = {float(value).hex()};"
        for key, values in assigned.items()
        for n, value in enumerate(values)
    ]
    return f"""#include "computer.h"
#include <stdio.h>
#ifdef _WIN32
#include <fcntl.h>
#include <io.h>
#endif
int main(void)
{{
#ifdef _WIN32
    _setmode(0, _O_BINARY), _setmode(1, _O_BINARY);
#endif
    static computer it;
    computer_parameters all;
    computer_counts counts;
    computer_output told;
    double row[{len(counts)}];
    computer_defaults(&all);
    {" ".join(lines)}
    const char *wrong = computer_init(&it, &all);
    while (!wrong && fread(row, sizeof row, 1, stdin) == 1) {{
        {" ".join(f"{name} = (int64_t)row[{n}];" for n, name in enumerate(counts))}
        wrong = computer_step(&it, &counts, &told);
        const double values[] = {{{", ".join(told)}}};
        fwrite(values, sizeof values, 1, stdout);
    }}
    return wrong != NULL;
}}
"""


def counted(run: Trace) -> NDArray[np.float64]:
    """The encoder messages of a run, (messages, 7)."""
    return np.column_stack([run[f"encoder.{port.name}"] for port in COUNT_PORTS]).astype(float)


def fed(
    command: str | Sequence[str],
    outputs: Mapping[str, int],
    rows: NDArray[np.float64],
    surroundings: Mapping[str, str] | None = None,
) -> Signals:
    """What it gives for rows of counts, by the names of its outputs."""
    done = subprocess.run(command, input=rows.tobytes(), env=surroundings, capture_output=True, timeout=600, check=True)
    values = np.frombuffer(done.stdout).reshape(len(rows), sum(outputs.values()))
    parts = np.split(values, np.cumsum(list(outputs.values()))[:-1], axis=1)
    return {name: part[:, 0] if part.shape[1] == 1 else part for name, part in zip(outputs, parts, strict=True)}


def recorded(run: Trace, name: str) -> NDArray[np.float64]:
    """What a run has for an output of the C, at the times of its encoder messages."""
    watched = "monitor.omega_ref" in run.fields()
    if name == "power" and not watched:
        return np.ones(len(run["encoder.sample"]))
    owner = "monitor" if watched else "controller"
    return np.asarray(run[name if "." in name else f"{owner}.{name}"], dtype=float)


LINES = "drive.unpowered.holding_Nm=0.02", "monitor.enabled=true", "monitor.force_limit_N=4", "monitor.obey_lag_ms=2"


@pytest.mark.parametrize(
    ("experiment", "settings"),
    [
        (FIG4, ()),
        pytest.param(MASSAGE, (), marks=pytest.mark.endurance),
        # the monitor cuts each drive's own power
        pytest.param(FIG4, LINES, marks=pytest.mark.slow),
    ],
)
def test_every_output_is_that_of_the_recording_bit_for_bit(
    written: Callable[..., Path], experiment: Path, settings: tuple[str, ...]
) -> None:
    run = run_in_memory(load_experiment(experiment, settings))
    folder, outputs = written(experiment, settings), sizes(experiment, settings)
    source = folder / "recorder.c"
    source.write_text(recorder(outputs, {}))
    told = fed(program(folder, source, "recorder"), outputs, counted(run))
    assert set(told) > {"omega_ref", "power", "estimator.F_ee_B", "controller.F_z"}
    assert not settings or {0.0, 1.0} == set(told["monitor.drive_power"].ravel())
    assert np.ptp(told["omega_ref"]) > 0.1
    for name, values in told.items():
        assert np.array_equal(values, recorded(run, name)), name


@pytest.mark.slow
def test_all_parameters_at_once_do_what_the_experiment_with_them_does(written: Callable[..., Path]) -> None:
    settings = ("controller.delay_ticks=1", "controller.energy_tank={size_J=0.15,release_s=0.5}")
    open_ones = open_parameters(part_of(load_experiment(MASSAGE, settings), LIBRARY_PART))
    assigned = {p.key: another(p, n) for n, p in enumerate(open_ones)}
    said = [f"{key}={value if len(value) > 1 else value[0]}" for key, value in assigned.items()]
    run = run_in_memory(replace(load_experiment(MASSAGE, [*settings, *said]), duration_ticks=TICKS))
    folder, outputs = written(MASSAGE, settings), sizes(MASSAGE, settings)
    source = folder / "recorder.c"
    source.write_text(recorder(outputs, assigned))
    # a step of 1 ms, as the delay has: every message is there twice
    rows = np.column_stack([run.held(f"encoder.{port.name}") for port in COUNT_PORTS]).astype(float)
    told = fed(program(folder, source, "recorder"), outputs, rows)
    watched = {"omega_ref": "monitor.omega_ref", "power": "monitor.power"}
    for name, values in told.items():
        assert np.array_equal(values, np.asarray(run.held(watched.get(name, name)), dtype=float)), name


@pytest.mark.slow
def test_a_robot_that_does_not_retract_after_a_trip_loses_its_power(written: Callable[..., Path]) -> None:
    folder, outputs = written(MASSAGE), sizes(MASSAGE)
    source = folder / "recorder.c"
    source.write_text(recorder(outputs, {}))
    run = run_in_memory(replace(load_experiment(MASSAGE), duration_ticks=TICKS))
    moving = counted(run)
    # all shafts stand still, whatever they are told
    stuck = np.tile(moving[-1], (1000, 1))
    stuck[:, -1] += np.arange(1, 1001)
    told = fed(program(folder, source, "recorder"), outputs, np.vstack([moving, stuck]))
    assert np.ptp(told["monitor.tripped"]) == 1.0 and np.ptp(told["power"]) == 1.0
    assert np.array_equal(told["power"], told["monitor.power"])
    assert np.array_equal(told["omega_ref"], told["monitor.omega_ref"])
    assert not np.array_equal(told["omega_ref"], told["controller.omega_ref"])


def test_the_example_reads_an_exported_file_and_writes_the_speeds(written: Callable[..., Path]) -> None:
    run, folder = run_in_memory(load_experiment(FIG4)), written(FIG4)
    names = [f"encoder.count_{side}[{n}]" for side in "ml" for n in range(3)]
    rows = [",".join(["t_s", *names, "encoder.sample"])]
    rows += [",".join(["0.0", *(f"{x:.0f}" for x in row)]) for row in counted(run)]
    (folder / "counts.csv").write_text("\n".join(rows) + "\n")
    example = program(folder, folder / "main.c", "main")
    done = subprocess.run([example, "counts.csv"], cwd=folder, capture_output=True, text=True, check=True)
    head, *lines = done.stdout.splitlines()
    assert head == ",".join(["t_s", *(f"omega_ref[{n}]_rad_per_s" for n in range(3)), "power"])
    values = np.array([[float(cell) for cell in line.split(",")] for line in lines])
    assert np.array_equal(values[:, 1:4], run["controller.omega_ref"])
    assert np.array_equal(values[:, 4], np.ones(len(values)))
    assert np.allclose(values[:, 0], run.time("encoder"), rtol=0.0, atol=1e-9)
    for cell in ("nan", "", "1.5", "9" * 30):
        lost = rows[20].split(",")
        lost[1] = cell
        (folder / "lost.csv").write_text("\n".join([*rows[:20], ",".join(lost), *rows[20:]]) + "\n")
        done = subprocess.run([example, "lost.csv"], cwd=folder, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (1, "a count in the file is no whole number\n")
        assert done.stdout.splitlines() == [head, *lines[:19]]
    (folder / "other.csv").write_text(rows[0].replace("count_l[1]", "count_x") + "\n")
    done = subprocess.run([example, "other.csv"], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "there is no column encoder.count_l[1]\n")


def test_mistakes_are_told_in_words_and_nothing_moves_then(written: Callable[..., Path]) -> None:
    folder = written(FIG4)
    done = subprocess.run([program(folder, LIFE, "life")], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [
        "before init: computer_init comes first, and was not refused",
        "no stiffness: controller.model.k_s_Nm_per_rad: expected more than 0",
        "then a step: computer_init comes first, and was not refused",
        "not a number: controller.force.kp_mm_per_N: expected at least 0, at most 1000",
        "no pose: estimator: found no pose that fits the first encoder counts",
        "then a step: a step failed before; computer_reset comes first",
        "stiffness while it runs: controller.model.k_s_Nm_per_rad: only computer_init takes another value",
        "gain of -1 while it runs: controller.position.kp_per_s: expected at least 0, at most 1000",
    ]


@pytest.mark.skipif(shutil.which("nm") is None, reason="binutils are not installed")
def test_the_library_needs_mathematics_alone_and_no_name_of_it_is_in_the_way(written: Callable[..., Path]) -> None:
    library = str(written(FIG4) / "x86_64-linux" / "libcomputer.a")

    def names(option: str) -> set[str]:
        done = subprocess.run(["nm", "-P", "-g", option, library], capture_output=True, text=True, check=True)
        return {line.split()[0] for line in done.stdout.splitlines() if line and not line.endswith(":")}

    given = names("--defined-only")
    assert {"computer_init", "computer_step", "computer_tune", "computer_reset", "computer_defaults"} <= given
    assert all(name.startswith("computer_") for name in given)
    needed = names("-u") - given
    assert {"sincos", "exp"} <= needed
    assert all(MATH_SYMBOLS.fullmatch(name) for name in needed)


def test_it_brings_what_it_takes_to_call_it(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    old = folder / "aarch64-linux" / "libcomputer.a"
    old.parent.mkdir(parents=True)
    old.write_text("of another header")
    build_c(FIG4, [], folder, [], silent)
    (library,) = folder.glob("*/libcomputer.a")
    assert library.stat().st_size < 100_000
    told = (folder / "README.md").read_text()
    assert "cc -O2 main.c x86_64-linux/libcomputer.a -lm -o main" in told
    assert "controller.period_ms" in told
