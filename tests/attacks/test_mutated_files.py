"""Of a file that was changed anywhere the answer is a result or a refusal in words, soon, and nothing else."""

import json
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.attacks.mutations import endure, mutated, mutated_json
from tests.kernel.systems.archives import archive, component, connection, connector, line, structure, system, values
from tests.studies.sweep.statistics.rows import row
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.reader import read_log
from twin.kernel.ssp.flat import flatten
from twin.kernel.ssp.package import read_package
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.plan import fmu_sources, plan_system
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.template import commented_experiment
from twin.studies.check.baseline import read_baseline
from twin.studies.compare.tolerance import rules
from twin.studies.sweep.plan import read_definition
from twin.studies.sweep.rows import ROWS_FILE
from twin.studies.sweep.show.parts import SweepQuery, parts, sweep_text
from twin.studies.sweep.statistics.ranking import bands, usual_metric
from twin.studies.sweep.stored import SWEEP_FILE, stored_sweep

Attack = Callable[[int], object]
FEW, MANY = range(25), 400


@pytest.fixture
def experiment(root: Path, tmp_path: Path) -> Attack:
    text = commented_experiment(DECLARED_TABLES, "pressing", root / "experiments/pressing.toml").encode()
    return _read(text, tmp_path / "experiment.toml", load_experiment)


@pytest.fixture
def fig4(root: Path, tmp_path: Path) -> Attack:
    text = (root / "experiments/fig4_force_position.toml").read_bytes()
    return _read(text, tmp_path / "experiment.toml", load_experiment)


@pytest.fixture
def body(root: Path, tmp_path: Path) -> Attack:
    text = (root / "experiments/bodies/back.toml").read_bytes()
    (tmp_path / "experiment.toml").write_text('extends = "pressing.toml"\n[contact]\nbody = "body.toml"\n')
    return _read(text, tmp_path / "body.toml", lambda _: load_experiment(tmp_path / "experiment.toml"))


@pytest.fixture
def sweep(root: Path, tmp_path: Path) -> Attack:
    from twin.studies.sweep.plan import largest_count

    def counted(path: Path) -> int:
        return largest_count(read_definition(path)[0])

    text = (root / "experiments/sweeps/stiffness_and_gain.toml").read_bytes()
    return _read(text, tmp_path / "sweep.toml", counted)


MAP = b"""time = { column = "stamp", unit = "ms" }
controller.F_z = { column = "Fz", unit = "N", sign = -1 }
"plant.p_B[2]" = "z_mm"
"""
TOLERANCE = b"""\"*" = "2 % @ 4 ms"
"controller.F_z" = "0.05 N"
plant.p_B = "0.1 mm @ 10 ms"
"""
LOG = b"# from the scope\nstamp,Fz,z_mm,state\n" + b"".join(b"%d,%d.5,-%d,up\n" % (k, k % 3, k % 7) for k in range(60))


@pytest.fixture
def column_maps(tmp_path: Path) -> Attack:
    (tmp_path / "log.csv").write_bytes(LOG)
    return _read(MAP, tmp_path / "map.toml", lambda path: read_log(tmp_path / "log.csv", column_map([path])))


@pytest.fixture
def tolerances(tmp_path: Path) -> Attack:
    return _read(TOLERANCE, tmp_path / "tol.toml", lambda path: rules([path]))


@pytest.fixture
def log(tmp_path: Path) -> Attack:
    columns = column_map(["time=stamp[ms]", "controller.F_z=-Fz[N]", "plant.p_B[2]=z_mm"])

    def read(path: Path) -> None:
        for series in read_log(path, columns).series.values():
            assert np.isfinite(series.values**2).all() and (np.diff(series.t) > 0.0).all()
            assert series.sampling.period > 0.0

    return _read(LOG, tmp_path / "log.csv", read)


@pytest.fixture
def baseline(root: Path, tmp_path: Path) -> Attack:
    text = min((root / "tests/baselines").glob("*/*.toml")).read_bytes()
    return _read(text, tmp_path / "baseline.toml", read_baseline)


def _read(content: bytes, path: Path, read: Callable[[Path], object]) -> Attack:
    def attack(seed: int) -> object:
        path.write_bytes(mutated(content, seed))
        return read(path)

    path.write_bytes(content)
    read(path)
    return attack


@pytest.fixture
def sweep_folder(tmp_path: Path) -> Attack:
    """The folder of a finished sweep, of which one part of one file is exchanged."""
    rows = [
        row(n, {"a.k": n % 4, "b.c": n / 4}, "xy"[n % 2], force_error_N=1.0 + n % 4, lateral_error_mm=2.0)
        | {"curves": {}, "claims": {"trigger": {"verdict": "holds", "value": 5.6}} if n % 5 == 0 else {}}
        for n in range(1, 12)
    ]
    # a process that died has no times
    rows.append(row(12, {"a.k": 0.0, "b.c": 3.0}, "x") | {"seconds": None, "stepping_s": None})
    facts = {
        "sweep": "made_up", "runs": 12, "design": "saltelli", "drives": ["x", "y"], "labels": ["a.k", "b.c"],
        "metrics": ["force_error_N", "lateral_error_mm"], "limits": {"force_error_N": 2.0}, "configuration": {},
    }  # fmt: skip

    def attack(seed: int) -> object:
        now, lines = facts, rows
        if seed % 3 == 0:
            now = mutated_json(facts, seed)
        else:
            hit = seed % len(rows)
            lines = [mutated_json(one, seed) if number == hit else one for number, one in enumerate(rows)]
        content = "".join(json.dumps(line) + "\n" for line in lines).encode()
        (tmp_path / SWEEP_FILE).write_text(json.dumps(now))
        (tmp_path / ROWS_FILE).write_bytes(mutated(content, seed) if seed % 7 == 0 else content)
        found = stored_sweep(tmp_path)
        asked = SweepQuery(usual_metric(found.columns), "lateral_error_mm", 5)
        bands(found.rows)
        return sweep_text(found, asked), parts(found, asked)

    return attack


@pytest.fixture
def system_structure(root: Path, tmp_path: Path) -> Attack:
    """An SSP whose structure is changed, planned as far as nothing is loaded."""
    fmu = root / "fmus/ideal_velocity/ideal_velocity.fmu"
    note = '<ssc:Annotation type="x"><o:Step xmlns:o="o" stepSize="0.01"/></ssc:Annotation>'
    inner = system(
        [component("b", "a.fmu")],
        [connection("u", "b.omega_ref", line(2.0, 1.0)), connection("b.omega_m", "y")],
        [connector("u", "input", "rpm"), connector("y", "output")],
        name="arm",
    )
    wires = [connection("a.omega_m", "arm.u"), connection("arm.y", "a.tau_load", more='suppressUnitConversion="true"')]
    whole = system([component("a", "a.fmu", bindings=values("omega_ref=1 rpm")), inner], wires)
    unit = '<ssc:Unit name="rpm"><ssc:BaseUnit rad="1" s="-1" factor="0.1047"/></ssc:Unit>'
    text = structure(whole, 1.0, unit, notes=f"<ssd:Annotations>{note}</ssd:Annotations>").encode()

    def attack(seed: int | None) -> object:
        changed = text if seed is None else mutated(text, seed)
        package = read_package(archive(tmp_path / "x.ssp", changed, {"a.fmu": fmu}))
        flat = flatten(package.structure, "x.ssp")
        files = dict.fromkeys(fmu_sources(package, flat).values(), fmu)
        return plan_system(package, flat, files, MasterChoice(scheme="jacobi")).delayed_connections

    attack(None)
    return attack


KINDS = [
    "experiment", "fig4", "body", "sweep", "column_maps", "tolerances", "log", "baseline", "sweep_folder",
    "system_structure",
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_file_that_was_changed_anywhere_is_read_or_refused(kind: str, request: pytest.FixtureRequest) -> None:
    refused = endure(request.getfixturevalue(kind), FEW)
    # mutations that nobody notices attack nothing
    assert refused >= 5


@pytest.mark.endurance
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_thousands_of_changed_files_are_read_or_refused(kind: str, request: pytest.FixtureRequest) -> None:
    start = random.SystemRandom().randrange(10**6)
    print(f"seeds from {start}")
    endure(request.getfixturevalue(kind), range(start, start + MANY))
