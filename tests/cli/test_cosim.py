"""`twin cosim` as a command: one answer, one exit code, a recording that other commands read; FMUs that go wrong."""

import json
from pathlib import Path

import pytest

from tests.command_line import twin
from tests.kernel.fmi.faulty import faulty_drive
from tests.kernel.systems.archives import archive, component, connection, structure, system, values

TWO = system(
    [component("a", "a.fmu", bindings=values("omega_ref=1")), component("b", "a.fmu")],
    [connection("a.omega_m", "b.omega_ref")],
)


@pytest.fixture
def two(root: Path, tmp_path: Path) -> Path:
    """A system of two shafts."""
    fmu = root / "fmus/ideal_velocity/ideal_velocity.fmu"
    return archive(tmp_path / "two.ssp", structure(TWO, 0.1), {"a.fmu": fmu})


def test_a_system_is_run_recorded_and_exported(two: Path, tmp_path: Path):
    done = twin("cosim", two, "--scheme", "jacobi", "--tick-ms", "2", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("two  0.1 s at ")
    assert "coupling   Jacobi, steps of 2 ms by --tick-ms" in done.stdout
    assert "a.omega_m->b.omega_ref" in done.stdout and "not fed    a.omega_ref = 1" in done.stdout
    assert (tmp_path / lines[-1].split()[1]).is_file()
    exported = twin("export", "results/cosim/two", "--csv", "--signals", "b", cwd=tmp_path)
    assert exported.returncode == 0, exported.stderr
    head, *rows = (tmp_path / "results/cosim/two/latest/run.csv").read_text().splitlines()
    assert head == "t_s,b.theta_m_rad,b.omega_m_rad_per_s" and len(rows) == 51 and rows[-1].endswith(",1.0")


def test_programs_get_facts_and_the_same_run_gives_the_same_bytes(two: Path, tmp_path: Path):
    for folder in ("one", "other"):
        done = twin("cosim", two, "--out", folder, "--json", cwd=tmp_path)
        facts = json.loads(done.stdout)
        assert facts["recording"] == f"{folder}/run.mcap" and facts["simulated_s"] == 0.1
    assert (tmp_path / "one/run.mcap").read_bytes() == (tmp_path / "other/run.mcap").read_bytes()


def test_what_is_no_system_or_no_number_is_refused_and_leaves_nothing(two: Path, tmp_path: Path):
    (tmp_path / "here").mkdir()
    for arguments, told in (
        (["none.ssp"], "none.ssp: no such file"),
        ([two, "--tick-ms", "0"], "--tick-ms 0: expected a number > 0"),
        ([two, "--stop-s", "inf"], "--stop-s inf: expected a number > 0"),
        ([two, "--tick-ms", "3"], "two.ssp: 0.1 s is not a whole number of steps of 3 ms; set --stop-s or --tick-ms"),
        ([two, "--isolate", "none", "--limit-step", "5"], "--limit-step is of the process that --isolate none does"),
        (
            [two, "--to", "ssp", "--from", "run"],
            "--to runs nothing, and does not go with --from; leave one",
        ),
    ):
        done = twin("cosim", *arguments, cwd=tmp_path / "here")
        assert (done.returncode, done.stdout) == (2, "") and told in done.stderr
    assert list((tmp_path / "here").iterdir()) == []


def test_a_component_that_fails_leaves_its_recording_and_exit_code_3(root: Path, tmp_path: Path):
    whole = system([component("good", "a.fmu"), component("bad", "bad.fmu", bindings=values("droop=1"))])
    faulty = faulty_drive(root, tmp_path)
    file = archive(
        tmp_path / "x.ssp",
        structure(whole, 2.0),
        {"a.fmu": root / "fmus/ideal_velocity/ideal_velocity.fmu", "bad.fmu": faulty},
    )
    done = twin("cosim", file, "--out", "run", cwd=tmp_path)
    assert done.returncode == 3
    assert "bad.fmu (bad) fmi2DoStep returned fmi2Error" in done.stderr
    assert "run/run.mcap.partial (0.999 s)" in done.stderr and (tmp_path / "run/run.mcap.partial").is_file()
