import json
import os
from importlib.metadata import version
from pathlib import Path
from random import Random

import pytest

from tests.command_line import twin_process
from tests.damage import damage
from twin.cli import installation
from twin.cli.installation import (
    Finding,
    compiled_finding,
    disk_finding,
    drives_finding,
    examination_text,
    examine,
    home_finding,
    installed_table,
    package_findings,
    smoke_finding,
    unpacked_finding,
    verdict,
)
from twin.kernel.archive import sha256
from twin.kernel.compiled import store
from twin.kernel.fmi.unpacked import unpacked

PROJECT = {"requires-python": ">=3.11", "dependencies": ["numpy>=2.0"]}


def states(findings: list[Finding]) -> dict[str, str]:
    return {finding.topic: finding.state for finding in findings}


def test_this_repository_is_ready(root: Path):
    findings = examine(root, with_run=False)
    assert verdict(findings).startswith("ready")
    assert {"python", "packages", "drives", "compiled", "unpacked", "disk"} <= states(findings).keys()
    lines = examination_text(findings).splitlines()
    assert lines[0] == verdict(findings)
    assert [line for line in lines if len(line) > 80 and "/" not in line] == []


def test_the_verdict_names_what_is_missing_and_what_prevents_it():
    fine, optional, broken = Finding("a", "ok", ""), Finding("live", "lacks", ""), Finding("packages", "bad", "")
    assert verdict([fine, Finding("docs", "note", "")]) == "ready"
    assert verdict([fine, optional]) == "ready, without: live"
    assert verdict([fine, optional, broken]) == "not ready: packages"


def test_every_package_is_checked_against_what_is_asked_for():
    found = package_findings(PROJECT | {"dependencies": ["numpy>=99", "there-is-no-such-package", "pydantic"]})
    assert states(found) == {"python": "ok", "packages": "bad"}
    assert found[1].text.startswith(
        f"numpy is {version('numpy')}, not >=99; there-is-no-such-package is not installed: pip install"
    )
    assert package_findings(PROJECT | {"requires-python": ">=4"})[0].state == "bad"


def test_an_extra_that_users_need_is_missed_and_one_for_developers_is_noted():
    extras = {
        "live": ["there-is-no-such-package"],
        "docs": ["there-is-no-such-package"],
        "test": ["twin[live]", "numpy"],
    }
    found = package_findings(PROJECT | {"optional-dependencies": extras})
    assert states(found) == {"python": "ok", "packages": "ok", "live": "lacks", "docs": "note", "test": "ok"}
    assert found[2].text.startswith("twin run --live needs: pip install -e '.[live]'")


METADATA = """Metadata-Version: 2.4
Name: acme
Version: 1.0
Requires-Python: >=3.11
Requires-Dist: numpy>=2.0
Requires-Dist: old; python_version < "3"
Provides-Extra: live
Requires-Dist: there-is-no-such-package>=3; extra == "live"
Provides-Extra: test
Requires-Dist: nor-this-one; extra == "test"
"""


def test_without_a_clone_the_installed_package_says_what_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "acme-1.0.dist-info").mkdir()
    (tmp_path / "acme-1.0.dist-info" / "METADATA").write_text(METADATA)
    monkeypatch.syspath_prepend(tmp_path)
    table = installed_table("acme")
    assert table == PROJECT | {
        "optional-dependencies": {"live": ["there-is-no-such-package>=3"], "test": ["nor-this-one"]}
    }
    # extras for developing are of no use there, and pip is told of what is missing by its name
    found = package_findings(table, clone=False)
    assert states(found) == {"python": "ok", "packages": "ok", "live": "lacks"}
    assert found[2].text.startswith("twin run --live needs: pip install 'there-is-no-such-package>=3' (")
    wrong = package_findings(PROJECT | {"dependencies": ["numpy>=99"]}, clone=False)[1]
    assert wrong.text.endswith(": pip install 'numpy>=99'")


def test_an_installation_that_lost_its_experiments_is_not_ready(tmp_path: Path, root: Path):
    assert home_finding() == Finding("repository", "ok", str(root))
    (tmp_path / "fmus").mkdir()
    found = home_finding(tmp_path)
    assert found.state == "bad" and "experiments, tests/baselines missing; install it again" in found.text


def test_drives_that_do_not_fit_are_named_and_only_the_default_one_is_needed(tmp_path: Path, root: Path):
    for name in ("broken", "velocity_servo"):
        folder = tmp_path / "fmus" / name
        folder.mkdir(parents=True)
        (folder / f"{name}.fmu").write_bytes(b"no archive")
    assert drives_finding(tmp_path).state == "bad"
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    (tmp_path / "fmus" / "velocity_servo" / "velocity_servo.fmu").write_bytes(good.read_bytes())
    found = drives_finding(tmp_path)
    assert found.state == "lacks" and found.text.startswith("1 of 2 do not fit: broken: ")


def test_compiled_code_is_cold_where_nothing_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(store, "object_folder", lambda: tmp_path)
    monkeypatch.setattr(installation, "object_folder", lambda: tmp_path)
    assert compiled_finding().text.startswith("nothing yet: the first run compiles")
    store.store_file("plant.o", bytes(3_000_000))
    assert compiled_finding().text == f"3 MB kept in {tmp_path}, which only you can write to"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert compiled_finding().text == f"3 MB kept in {tmp_path}, as NUMBA_CACHE_DIR says"


def test_compiled_code_that_came_with_a_wheel_is_counted_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    came, empty = tmp_path / "came", tmp_path / "empty"
    came.mkdir()
    empty.mkdir()
    (came / "plant_avx.o").write_bytes(store.seal("plant_avx.o", bytes(1_500_000)))
    monkeypatch.setattr(store, "object_folder", lambda: empty)
    monkeypatch.setattr(installation, "object_folder", lambda: empty)
    monkeypatch.setattr(installation, "PACKAGED_OBJECTS", came)
    good = f"1.5 MB came with twin; 0 MB kept in {empty}, which only you can write to"
    assert compiled_finding().text == good
    damage(came / "plant_avx.o", "flipped", Random(1))
    assert compiled_finding().text == f"{good}; 1 changed since (plant_avx.o), compiled again when needed"


def test_compiled_code_that_was_damaged_or_is_not_kept_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(store, "object_folder", lambda: tmp_path)
    (tmp_path / "dynamics.o").write_bytes(b"no seal")
    told = compiled_finding()
    assert told.state == "ok"
    assert told.text.endswith("which only you can write to; 1 changed since (dynamics.o), compiled again when needed")
    monkeypatch.setattr(installation, "refusal", lambda: "it is somebody else's")
    assert compiled_finding() == Finding("compiled", "lacks", "every command compiles again: it is somebody else's")


def test_unpacked_drives_are_told_with_place_and_damage(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path / "cache"))
    servo = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    folder = unpacked(servo, sha256(servo))
    good = f"1 FMUs, 0 MB, in {folder.parents[1]}, which only you can write to"
    assert unpacked_finding() == Finding("unpacked", "ok", good)
    damage(folder / "modelDescription.xml", "flipped", Random(1))
    changed = "; 1 changed since (modelDescription.xml), taken from the FMU again when needed"
    assert unpacked_finding().text == good + changed
    (tmp_path / "cache").chmod(0o777)
    told = unpacked_finding()
    assert told.state == "bad" and "others can write to it" in told.text


@pytest.mark.parametrize(("free", "state"), [(5e10, "ok"), (5e8, "lacks"), (5e7, "bad")])
def test_a_disk_without_room_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: float, state: str):
    monkeypatch.setattr(installation.shutil, "disk_usage", lambda folder: type("Usage", (), {"free": free}))
    assert disk_finding(tmp_path).state == state


@pytest.mark.slow
def test_a_run_that_fails_is_told_with_what_it_said(root: Path, tmp_path: Path):
    assert smoke_finding(root).state == "ok"
    failed = smoke_finding(tmp_path)
    assert failed.state == "bad" and "no such experiment file" in failed.text


def test_the_answer_is_the_first_word(root: Path):
    done = twin_process("doctor", cwd=root)
    assert done.returncode == 0, done.stdout
    assert done.stdout.startswith("ready")


def test_what_prevents_a_run_is_exit_code_2_and_named_for_programs_too(root: Path, tmp_path: Path):
    broken = tmp_path / "fmus" / "velocity_servo"
    broken.mkdir(parents=True)
    (broken / "velocity_servo.fmu").write_bytes(b"no archive")
    done = twin_process("doctor", "--json", cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(root)})
    facts = json.loads(done.stdout)
    assert done.returncode == 2
    assert facts["verdict"] == "not ready: drives"
    assert {"topic", "state", "text"} == facts["findings"][0].keys()
