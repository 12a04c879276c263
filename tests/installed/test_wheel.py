"""twin installed from its wheel, away from any clone: everything is there, and works from an empty folder."""

import json
import shutil
import subprocess
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.installed.environments import Environment, built, installed

CARRIED = ("examples", "experiments", "fmus", "tests/baselines")
BUILDING = ("build.py", "builder", "fmi2", "fmi3", "__pycache__")
"""Of fmus/: what makes the drives, which a wheel has no use for."""
REPOSITORY = (
    *(
        "CITATION.cff",
        "CONTRIBUTING.md",
        "LICENSE",
        "Makefile",
        "constraints.txt",
        "hatch_build.py",
        "set_up.py",
        "benchmarks/__main__.py",
    ),
    *("docs/index.md", "fmus/build.py", "fmus/velocity_servo/model.c", "experiments/robots/massage_robot.toml"),
    *("benchmarks/__main__.py", "tests/baselines/step_z_air/stepper.toml"),
)
NAMES = """
import json
import tarfile
from twin.robot.assembly.load import load_experiment
from twin.robot.paths import PROJECT_FOLDER
from twin.studies.check.baseline import default_baseline_folder
from twin.studies.check.job import pairs

loaded = load_experiment("fig4_force_position", ["duration_s=1"], drive="pmsm_foc", body="back")
stored = pairs([], [], default_baseline_folder())
print(json.dumps([str(PROJECT_FOLDER), [drive.fmu for drive in loaded.drives], loaded.values["contact"]["body"],
                  all(pair.file.startswith(str(PROJECT_FOLDER)) for pair in stored), len(stored)]))
"""

PROJECT = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "x"
version = "1"
[tool.hatch.build.targets.wheel]
only-include = ["experiments"]
[tool.hatch.build.targets.wheel.hooks.custom]
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif("sys.platform == 'win32'", reason="programs of an environment lie elsewhere there"),
]


@pytest.fixture(scope="module")
def wheel(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(root, "build_wheel", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def away(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Environment:
    return installed(wheel, tmp_path_factory.mktemp("away") / "environment")


def test_the_wheel_carries_every_experiment_drive_and_baseline(root: Path, wheel: Path):
    inside = set(zipfile.ZipFile(wheel).namelist())
    files = {path.relative_to(root) for name in CARRIED for path in (root / name).rglob("*") if path.is_file()}
    wanted = {f"twin/carried/{file.as_posix()}" for file in files if not set(file.parts) & {*BUILDING, ".build"}}
    assert len(wanted) > 200
    assert {name for name in inside if name.startswith("twin/carried/")} == wanted
    assert {"twin/report/page/assets/page.css", "twin-1.0.0.dist-info/licenses/LICENSE"} <= inside


def test_what_git_does_not_know_is_not_carried(root: Path, tmp_path: Path):
    shutil.copy(root / "hatch_build.py", tmp_path)
    (tmp_path / "pyproject.toml").write_text(PROJECT)
    (tmp_path / "experiments").mkdir()
    for name in ("known", "mine", "mine too [1]"):
        (tmp_path / "experiments" / f"{name}.toml").touch()

    def carried() -> set[str]:
        inside = zipfile.ZipFile(built(tmp_path, "build_wheel", tmp_path)).namelist()
        return {Path(name).stem for name in inside if name.startswith("experiments/")}

    # in a folder that is no repository everything is taken
    assert carried() == {"known", "mine", "mine too [1]"}
    for words in (["init", "--quiet"], ["add", "experiments/known.toml"]):
        subprocess.run(["git", *words], cwd=tmp_path, check=True)
    assert carried() == {"known"}


def test_the_source_distribution_carries_the_repository(root: Path, tmp_path: Path):
    with tarfile.open(built(root, "build_sdist", tmp_path)) as archive:
        inside = {name.partition("/")[2] for name in archive.getnames()}
    assert inside >= set(REPOSITORY)
    assert {name for name in inside if name.startswith((".venv", "site/", "results/"))} == {"results/README.md"}


def test_in_an_empty_folder_an_experiment_is_written_and_drives_are_listed(away: Environment, tmp_path: Path):
    assert f"next: {away.folder / 'bin' / 'twin'} run my.toml" in away.run("twin", "init", "my.toml", cwd=tmp_path)
    listed = away.run("twin", "drive", "list", cwd=tmp_path)
    rows = listed.partition("\n\n")[0].splitlines()[1:]
    assert len(rows) == 11
    # read with everything it names, and refused for its length alone
    refused = away.run("twin", "run", "my.toml", "--body", "back", "--set", "duration_s=0", cwd=tmp_path, code=2)
    # something is compiled on the way
    assert refused.splitlines()[-1].startswith("my.toml: duration_s = 0: ")


def test_the_doctor_knows_that_there_is_no_clone(away: Environment, tmp_path: Path):
    facts = json.loads(away.run("twin", "doctor", "--json", cwd=tmp_path))
    assert facts["verdict"].startswith("ready")
    told = {finding["topic"]: finding["text"] for finding in facts["findings"]}
    assert str(away.folder) in told["installed"]
    # extras for developing are nobody's there
    assert "live" in told and not {"repository", "test", "docs", "fmus", "chromium"} & told.keys()


def test_names_lead_to_what_the_package_carries(away: Environment, tmp_path: Path):
    home, drives, body, of_home, baselines = json.loads(away.run("python", "-c", NAMES, cwd=tmp_path))
    assert Path(home).is_relative_to(away.folder) and home.endswith("twin/carried")
    assert drives == [f"{home}/fmus/pmsm_foc/pmsm_foc.fmu"] * 3
    assert body == "back" and of_home and baselines > 100
    said = away.run("twin", "run", "fig4_forc_position", cwd=tmp_path, code=2)
    assert said == "fig4_forc_position: no such experiment; did you mean 'fig4_force_position'?\n"


def test_what_pages_say_of_paths_and_names_works_from_an_empty_folder(away: Environment, tmp_path: Path):
    for sweep in ("stiffness_and_gain", "experiments/sweeps/stiffness_and_gain.toml"):
        assert "not begun" in away.run("twin", "sweep", "show", sweep, cwd=tmp_path)
    said = away.run("twin", "sweep", "run", "stiffness_and_gan", cwd=tmp_path, code=2)
    assert said == "stiffness_and_gan: no such sweep file; did you mean 'stiffness_and_gain'?\n"
    controller = ("--set", "controller.python=examples/my_controller.py:Controller")
    refused = away.run("twin", "run", "fig4_position", *controller, "--set", "duration_s=0", cwd=tmp_path, code=2)
    assert refused.splitlines()[-1].startswith(f"{away.folder}") and ": duration_s = 0: " in refused
    # the installation stays as it was installed
    written = away.run("twin", "drive", "new", "velocity_servo", cwd=tmp_path)
    assert written.splitlines()[0] == "velocity_servo/mapping.toml"
    assert not list(away.folder.rglob("velocity_servo/mapping.toml"))
    assert away.run("twin", "drive", "info", "./velocity_servo", cwd=tmp_path).startswith("velocity_servo.fmu  ")


@pytest.mark.endurance
def test_in_an_empty_folder_everything_runs(away: Environment, tmp_path: Path):
    away.run("twin", "init", "my.toml", cwd=tmp_path)
    # the package is another one, so all is compiled anew
    assert "compiling" in away.run("twin", "run", "my.toml", cwd=tmp_path)
    away.run("twin", "run", "fig4_force_position", "--drive", "pmsm_foc", cwd=tmp_path)
    assert (tmp_path / "results/fig4_force_position/latest/run.mcap").is_file()
    # the numbers are those of the repository
    checked = away.run("twin", "check", "step_z_air", "--drive", "velocity_servo", cwd=tmp_path)
    assert checked.startswith("All as it was: 1 experiment, 1 drive")
    assert "ok     run" in away.run("twin", "doctor", "--run", cwd=tmp_path)
