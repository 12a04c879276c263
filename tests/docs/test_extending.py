"""The patches of docs/building.md apply, are as small as CONTRIBUTING.md says, and do what the page says."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import twin_process
from tests.conftest import ROOT
from twin.kernel.recording.reader import Recording, read

PATCH = re.compile(r"^```diff\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"`(twin [^`]*)`")
NEEDED = ("twin", "fmus", "experiments", "pyproject.toml", "docs/how_it_works.md")
"""What a twin that runs elsewhere is made of, and what the patches change besides."""
J_M = 1.5e-4
"""Inertia of torque_motor_fmi3 (kg m2)."""

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git applies the patches")


def sections(root: Path) -> dict[str, str]:
    """Those of the page that have a patch, by heading."""
    _, *parts = re.split(r"^### (.+)\n", (root / "docs/building.md").read_text(), flags=re.MULTILINE)
    return {heading: text for heading, text in zip(parts[::2], parts[1::2], strict=True) if PATCH.search(text)}


EXAMPLES = sections(ROOT)


def patch(heading: str) -> str:
    (found,) = PATCH.findall(EXAMPLES[heading])
    return found


def touched(heading: str) -> list[str]:
    """Files that the patch of a section changes or makes."""
    return re.findall(r"^\+\+\+ b/(\S+)$", patch(heading), re.MULTILINE)


def apply(folder: Path, heading: str, *options: str) -> None:
    # in a folder of some other repository git would pass over what the patch names
    alone = {**os.environ, "GIT_CEILING_DIRECTORIES": str(folder.resolve().parent)}
    done = subprocess.run(
        ["git", "apply", *options], cwd=folder, env=alone, input=patch(heading), text=True, capture_output=True
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("heading", EXAMPLES)
def test_a_patch_of_the_page_applies(root: Path, tmp_path: Path, heading: str):
    for name in touched(heading):
        if (root / name).exists():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(root / name, tmp_path / name)
    apply(tmp_path, heading, "--check")


def test_every_row_of_contributing_that_counts_files_has_its_example_and_they_are_as_many(root: Path):
    row = re.compile(r"^\| \[[^]]+\]\(docs/building\.md#([\w-]+)\) \| (\d+) \|", re.MULTILINE)
    counted = {anchor: int(files) for anchor, files in row.findall((root / "CONTRIBUTING.md").read_text())}
    assert counted == {heading.lower().replace(" ", "-"): len(touched(heading)) for heading in EXAMPLES}
    assert len(counted) == 7


class Extended:
    """A copy of the twin with all patches of the page applied."""

    def __init__(self, root: Path, folder: Path):
        self.folder = folder
        for name in NEEDED:
            (folder / name).parent.mkdir(exist_ok=True)
            if (root / name).is_dir():
                shutil.copytree(root / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(root / name, folder / name)
        for heading in EXAMPLES:
            apply(folder, heading)
        self._environment = {**os.environ, "PYTHONPATH": str(folder)}

    def twin(self, *arguments: str, expected: int = 0) -> str:
        """What a command prints; it has to end with the exit code `expected`."""
        done = twin_process(*arguments, cwd=self.folder, env=self._environment)
        assert done.returncode == expected, done.stderr
        return done.stdout

    def told(self, heading: str, name: str, *more: str) -> str:
        """What the section's command `twin NAME` prints, with `more` options."""
        (line,) = [line for line in COMMAND.findall(EXAMPLES[heading]) if line.startswith(f"twin {name} ")]
        return self.twin(*shlex.split(line)[1:], *more)

    def ran(self, heading: str) -> Recording:
        """The recording of the section's `twin run`."""
        self.told(heading, "run", "--out", heading)
        return read(self.folder / heading)

    def accepted(self, tool: str) -> None:
        """Hold the files that the patches touch against a tool of `make lint`."""
        files = sorted({name for heading in EXAMPLES for name in touched(heading) if name.endswith(".py")})
        command = [sys.executable, "-m", *tool.split(), *files]
        if tool == "lint-imports":
            command = [sys.executable, "-c", "from importlinter.cli import lint_imports as l; raise SystemExit(l())"]
        done = subprocess.run(command, cwd=self.folder, env=self._environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def extended(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Extended:
    return Extended(root, tmp_path_factory.mktemp("extended"))


@pytest.fixture(scope="module")
def plain(extended: Extended) -> Recording:
    """Fig. 4 as it is, in the twin with the patches."""
    extended.twin("run", "experiments/fig4_force_position.toml")
    return read(extended.folder / "results" / "fig4_force_position")


@pytest.mark.endurance
@pytest.mark.parametrize("tool", ["ruff check", "ruff format --check", "mypy", "lint-imports"])
def test_what_checks_the_house_accepts_the_patches(extended: Extended, tool: str):
    extended.accepted(tool)


@pytest.mark.endurance
def test_the_force_follows_the_new_law(extended: Extended):
    run = extended.ran("A contact law")
    depth, rate = -0.101 - run["plant.p_B"][:, 2], -run["plant.v_B"][:, 2]
    touching = depth > 0.0
    law = 1250.0 * (depth + depth**3 / 2e-3**2) * (1.0 + 3.0 * rate)
    assert touching.sum() > 10_000 and depth.max() > 1.5e-3
    # 6 N of a double, in another order of operations
    assert np.abs(run["plant.F_n"] - law)[touching].max() < 1e-13
    assert run["plant.F_n"][~touching].max() == 0.0
    settings = ("contact.law=cubic", "contact.reference_depth_mm=2", "contact.stiffening_per_mm=1")
    options = [word for setting in settings for word in ("--set", setting)]
    extended.twin("run", "experiments/fig4_force_position.toml", *options, expected=2)


@pytest.mark.endurance
def test_a_gain_that_is_declared_in_one_place_has_its_key_acts_and_can_change(extended: Extended):
    (setting,) = re.findall(r"`--set (controller\.damping\.\S+)`", EXAMPLES["A gain"])
    pressing = "experiments/pressing.toml"
    extended.twin("run", pressing, "--set", setting, "--out", "least")
    extended.twin("run", pressing, "--set", "controller.damping.gain_rad_per_s_per_Nm=0", "--out", "none")
    extended.twin("run", pressing, "--out", "usual")
    least, none, usual = (read(extended.folder / name)["plant.p_B"] for name in ("least", "none", "usual"))
    assert np.array_equal(least, none) and not np.array_equal(least, usual)
    change = 'change=[{t_s=1.0, key="controller.damping.least_Nm", value=0.0}]'
    extended.twin("run", pressing, "--set", setting, "--set", change, "--out", "changed")
    changed = read(extended.folder / "changed")["plant.p_B"]
    assert np.array_equal(changed[:1000], least[:1000]) and not np.array_equal(changed, least)
    told = extended.twin("run", pressing, "--set", "controller.damping.least_Nm=-1", expected=2)
    assert told == "" and "controller.damping.least_Nm" in extended.twin("schema")
    extended.twin("build", "pressing", "--fmu", "controls", "--out", "controls.fmu")
    with zipfile.ZipFile(extended.folder / "controls.fmu") as fmu:
        assert 'name="controller.damping.least_Nm"' in fmu.read("modelDescription.xml").decode()


@pytest.mark.endurance
def test_a_constant_of_the_plant_that_is_declared_in_one_place_acts_and_is_without_effect_where_it_is_not_said(
    extended: Extended, plain: Recording, force_position: Recording
):
    run = extended.ran("A constant of the plant")
    extended.twin("run", "experiments/pressing.toml", "--out", "without")
    without = read(extended.folder / "without")
    assert not np.array_equal(run["plant.p_B"], without["plant.p_B"])
    assert np.array_equal(plain["plant.p_B"], force_position["plant.p_B"])
    extended.twin("build", "pressing", "--fmu", "plant", "--out", "plant.fmu")
    with zipfile.ZipFile(extended.folder / "plant.fmu") as fmu:
        assert 'name="plant.b_j_square_Nm_s2_per_rad2"' in fmu.read("modelDescription.xml").decode()


@pytest.mark.endurance
def test_the_loose_encoder_follows_behind_its_play_and_is_seen_where_it_is_said_to_be(extended: Extended):
    run = extended.ran("A kind of fault")
    true, read_out = run["encoder.count_l"][:, 0], run["fault/1.count_l"][:, 0]
    loose = run.time("fault/1") >= 1.0
    assert np.array_equal(true[~loose], read_out[~loose])
    # 0.5 deg of 16384 counts per turn
    play, held = 23, read_out[~loose][-1]
    for count, found in zip(true[loose], read_out[loose], strict=True):
        held = min(max(held, count - play), count + play)
        assert found == held
    behind = (true - read_out)[loose]
    assert (behind.min(), behind.max()) == (-play, play)
    rows = json.loads(extended.told("A kind of fault", "faults", "--json"))["rows"]
    seen = [(row["magnitude_deg"], row["in_contact"]) for row in rows if row["with_monitor"]["reason"]]
    assert len(rows) == 6 and seen == [(2.0, False)]
    assert all(row["as_stated"] for row in rows)


@pytest.mark.endurance
def test_a_motor_commanded_with_its_acceleration_moves_as_with_its_torque(extended: Extended):
    """The torque motor in other units: what it takes is counted in J_M rad/s2."""
    drive, supplier = extended.folder / "fmus" / "torque_motor_fmi3", extended.folder / "supplier"
    supplier.mkdir()
    unit = f'<UnitDefinitions><Unit name="J_m.rad/s2"><BaseUnit rad="1" s="-2" factor="{1 / J_M!r}" /></Unit>'

    def in_other_units(text: str) -> str:
        command = re.search(r'<Float64 name="tau_cmd" [^>]*>', text)
        assert command and 'unit="N.m"' in command[0]
        text = text.replace(command[0], command[0].replace('unit="N.m"', 'unit="J_m.rad/s2"'))
        return text.replace("<UnitDefinitions>", unit)

    repacked(drive / "torque_motor_fmi3.fmu", supplier / "torque_motor_fmi3.fmu", in_other_units)
    mapping = (drive / "mapping.toml").read_text().replace('command = "torque"', 'command = "acceleration"')
    (supplier / "mapping.toml").write_text(
        re.sub(r"^(kp|ki|limit) = ([\d.]+)", lambda m: f"{m[1]} = {float(m[2]) / J_M!r}", mapping, flags=re.MULTILINE)
    )
    run = extended.ran("A command that drives take")
    extended.twin("run", "experiments/fig4_force_position.toml", "--drive", "torque_motor_fmi3", "--out", "torque")
    other = read(extended.folder / "torque")
    assert run.fields()["drive/1.command"].unit == "rad/s2"
    assert np.ptp(run["plant.F_n"]) > 4.0
    # rounding, grown over 20 s of a closed loop
    assert np.abs(run["plant.F_n"] - other["plant.F_n"]).max() < 1e-6
    assert np.abs(J_M * run["drive/1.command"] - other["drive/1.command"]).max() < 1e-6


def repacked(fmu: Path, target: Path, edit: Callable[[str], str]) -> None:
    """A copy of an FMU with another model description."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            new.writestr(name, edit(content.decode()) if name == "modelDescription.xml" else content)


@pytest.mark.endurance
def test_the_command_prints_the_energies_of_the_drives(extended: Extended, plain: Recording):
    facts = json.loads(extended.told("A study", "energy", "--json"))
    speeds = np.column_stack([plain[f"drive/{axis}.omega_m"] for axis in (1, 2, 3)])
    power = plain["plant.tau_load"] * speeds
    given = np.trapezoid(np.maximum(power, 0.0), plain.time("plant"), axis=0).sum()
    returned = np.trapezoid(np.maximum(-power, 0.0), plain.time("plant"), axis=0).sum()
    assert given > 0.0 and returned > 0.0
    # sums in the same order
    assert (facts["given_J"], facts["returned_J"]) == pytest.approx((given, returned), rel=1e-12)
    text = extended.told("A study", "energy")
    assert f"gave {given:.3f} J" in text and f"got {returned:.3f} J back" in text
    extended.twin("energy", "experiments/pressing.toml", expected=2)


@pytest.mark.endurance
def test_the_new_signal_is_recorded_and_no_other_changes(plain: Recording, force_position: Recording):
    field = plain.fields()["plant.depth"]
    assert (field.size, field.unit) == (1, "m") and field.meaning.startswith("how deep the platform is")
    assert np.abs(plain["plant.depth"] - (-0.101 - plain["plant.p_B"][:, 2])).max() < 1e-15
    before = force_position.fields()
    assert set(plain.fields()) - set(before) == {"plant.depth"}
    assert [name for name in before if not np.array_equal(plain[name], force_position[name])] == []
