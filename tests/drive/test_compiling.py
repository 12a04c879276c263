"""FMUs that bring sources and no binary: built when asked, once, and stepped as if they had come with one."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.drive.archives import DESCRIPTION, altered
from twin.cache_folder import cache_folder
from twin.cli.app import app
from twin.drive import COMPILED
from twin.drive.compiling import FACTS, compiled, supply
from twin.drive.description import build, described
from twin.drive.unpacked import unpacked
from twin.errors import InputRefused
from twin.recording.reader import read
from twin.runs.assembly.load import load_experiment
from twin.runs.run import execute

BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="torque_motor_fmi3">
    <SourceFileSet language="C99">{files}<PreprocessorDefinition name="UNUSED" value="1"/></SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""


@pytest.fixture(autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path_factory.mktemp("cache")))


def sources_only(root: Path, folder: Path, name: str, extra: str = "") -> Path:
    """A drive of ours without binaries, that says which of its sources to compile."""
    good = root / "fmus" / name / f"{name}.fmu"
    files = ["model.c", "access.c", "fmu_state.c", "lifecycle.c", "not_offered.c", "variables.c"]
    fmi3 = name.endswith("fmi3")

    def change(entry: str, content: bytes) -> tuple[str, bytes] | None:
        text = content.decode(errors="replace")
        if entry.startswith("binaries/"):
            return None
        if entry == DESCRIPTION and not fmi3:
            listed = "".join(f'<File name="{file}"/>' for file in files)
            changed = re.sub(
                r"<CoSimulation ([^>]*) />",
                rf"<CoSimulation \1><SourceFiles>{listed}</SourceFiles></CoSimulation>",
                text,
            )
            assert changed != text
            return entry, changed.encode()
        if entry == "documentation/README.md" and fmi3:
            listed = "".join(f'<SourceFile name="{file}"/>' for file in files)
            return "sources/buildDescription.xml", BUILD.format(files=listed).encode()
        return entry, (extra + text).encode() if entry == "sources/model.c" else content

    return altered(good, folder / f"{name}.fmu", change)


def theta(root: Path, folder: Path, drive: Path) -> np.ndarray:
    folder.mkdir()
    experiment = load_experiment(root / "experiments/fig4_position.toml", ["duration_s=0.2"], str(drive))
    return read(execute(experiment, folder).recording)["drive/1.theta_m"]


def test_sources_are_built_when_asked_and_step_as_the_binary_does(root: Path, tmp_path: Path):
    fmu = sources_only(root, tmp_path, "velocity_servo", extra="#define FMI2_FUNCTION_PREFIX velocity_servo_\n")
    with pytest.raises(InputRefused, match=r"no binary for this platform .* twin drive info .* --compile builds them"):
        described(fmu)
    done = CliRunner().invoke(app, ["drive", "info", str(fmu), "--compile"])
    assert done.exit_code == 0, done.output
    built = theta(root, tmp_path / "built", fmu)
    # another compiler may contract multiplications and additions
    np.testing.assert_allclose(built, theta(root, tmp_path / "came", root / "fmus/velocity_servo"), atol=1e-13)
    assert described(fmu).compiler


def test_a_build_description_of_fmi_3_is_followed(root: Path, tmp_path: Path):
    fmu = sources_only(root, tmp_path, "torque_motor_fmi3")
    assert build(fmu) is not None
    description = described(fmu)
    folder = unpacked(fmu, description.sha256)
    assert len(list(folder.glob("binaries/*/*"))) == 1


def test_a_library_is_built_once(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    fmu = sources_only(root, tmp_path, "velocity_servo")
    first = build(fmu)
    monkeypatch.setenv("PATH", "")
    assert build(fmu) == first


@pytest.mark.skipif(os.name != "posix", reason="owners of POSIX")
def test_a_library_that_another_user_has_built_is_not_loaded(
    tmp_path: Path, give_away: Callable[[Path], None], capsys: pytest.CaptureFixture[str]
):
    digest, binary = "0" * 64, "binaries/linux64/servo.so"
    folder = cache_folder(COMPILED) / digest
    (folder / binary).parent.mkdir(parents=True)
    (folder / binary).write_bytes(b"no good")
    (folder / FACTS).write_text('{"compiler": "cc"}')
    assert compiled(digest, binary)
    give_away(folder / binary)
    supply(digest, tmp_path)
    assert compiled(digest, binary) is None and list(tmp_path.glob("binaries/*/*")) == []
    assert "belongs to user 1234, not to you" in capsys.readouterr().err


def test_an_fmu_with_a_binary_is_not_built(root: Path):
    assert build(root / "fmus/velocity_servo/velocity_servo.fmu") is None


def test_sources_that_do_not_compile_are_refused_with_what_the_compiler_says(root: Path, tmp_path: Path):
    fmu = sources_only(root, tmp_path, "velocity_servo", extra="#error not today\n")
    with pytest.raises(InputRefused, match=r"^[^\n]*do not compile with \w+: [^\n]*not today[^\n]*$"):
        build(fmu)


def test_a_source_outside_its_folder_is_refused(root: Path, tmp_path: Path):
    good = sources_only(root, tmp_path, "velocity_servo")
    fmu = altered(good, tmp_path / "away.fmu", lambda n, c: (n, c.replace(b'"model.c"', b'"../../model.c"')))
    with pytest.raises(InputRefused, match=r"hold no '../../model.c'"):
        build(fmu)


def test_an_fmu_without_binary_and_sources_says_where_to_get_one(root: Path, tmp_path: Path):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    bare = altered(
        good, tmp_path / "bare.fmu", lambda n, c: None if n.startswith(("binaries/", "sources/")) else (n, c)
    )
    with pytest.raises(InputRefused, match="Export it for linux64"):
        described(bare)
    with pytest.raises(InputRefused, match="holds no sources"):
        build(bare)
