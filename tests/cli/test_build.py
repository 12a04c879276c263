"""`twin build` as a command: one answer, one exit code, and a file only if all went well."""

import json
from pathlib import Path

from tests.command_line import twin


def test_it_writes_an_fmu_and_says_what_it_holds(root: Path, tmp_path: Path):
    done = twin("build", root / "experiments/fig4_force_position.toml", "--fmu", "encoder", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert (tmp_path / facts["file"]).stat().st_size == facts["bytes"]
    assert facts["file"] == "results/build/fig4_force_position/encoder.fmu"
    assert facts["inputs"] == ["theta_m", "theta_l"]
    assert "plant.motor_zero_deg" in facts["parameters"] and "controller.period_ms" in facts["fixed"]


def test_a_part_that_is_none_is_refused_with_exit_code_2_and_leaves_nothing(root: Path, tmp_path: Path):
    done = twin("build", root / "experiments/fig4_force_position.toml", "--fmu", "plent", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.strip().endswith("did you mean 'plant'?")
    assert list(tmp_path.iterdir()) == []


def test_it_wants_one_thing_to_build(root: Path, tmp_path: Path):
    experiment = root / "experiments/fig4_force_position.toml"
    for asked, sentence in (
        ((), "expected one of --fmu PART, --c and --ssp"),
        (("--c", "--fmu", "plant"), "expected one of --fmu PART, --c and --ssp"),
        (("--fmu", "plant", "--drive", "stepper"), "--drive belongs to a whole robot"),
        (("--ssp", "--set", "cosim.iterations=2"), "build it with --set cosim.iterations=1"),
        (("--c", "--fmi", "3"), "--fmi belongs to an FMU"),
        (("--c", "--platform", "x86_64-window"), "did you mean 'x86_64-windows'?"),
    ):
        done = twin("build", experiment, *asked, cwd=tmp_path)
        assert (done.returncode, done.stdout) == (2, "")
        assert sentence in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_it_writes_the_c_of_the_robots_computer(root: Path, tmp_path: Path):
    done = twin("build", root / "experiments/fig4_force_position.toml", "--c", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["folder"] == "results/build/fig4_force_position/c"
    assert set(facts["files"]) == {"README.md", "computer.h", "main.c", "x86_64-linux/libcomputer.a"}
    for name, size in facts["files"].items():
        assert (tmp_path / facts["folder"] / name).stat().st_size == size
    assert (facts["step_s"], facts["components"]) == (0.002, ["estimator", "controller"])
