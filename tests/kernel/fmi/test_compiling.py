"""FMUs that bring sources and no binary: built when asked, once, and stepped as if they had come with one."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from click.testing import CliRunner

from tests.kernel.fmi.archives import DESCRIPTION, altered
from twin.cli.app import twin_command
from twin.kernel.cache_folder import cache_folder
from twin.kernel.errors import InputRefused
from twin.kernel.fmi import COMPILED_FOLDER
from twin.kernel.fmi import unpacked as compiling
from twin.kernel.fmi.description import build_binary, described
from twin.kernel.fmi.unpacked import COMPILER_FILE, compiled_library, install_compiled, unpacked
from twin.kernel.recording.reader import read
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute

BUILD = """<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="torque_motor_fmi3">
    <SourceFileSet language="C99">{files}</SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""


@pytest.fixture(autouse=True)
def _cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path_factory.mktemp("cache")))


MACRO = '<PreprocessorDefinition name="{}" value="{}"/>'


def sources_only(root: Path, folder: Path, name: str, extra: str = "", more: str = "") -> Path:
    """A drive of ours without binaries, that says which of its sources to compile; `more` of them in FMI 3.0."""
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
            return "sources/buildDescription.xml", BUILD.format(files=listed + more).encode()
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
    done = CliRunner().invoke(twin_command(), ["drive", "info", str(fmu), "--compile"])
    assert done.exit_code == 0, done.output
    built = theta(root, tmp_path / "built", fmu)
    # another compiler may contract multiplications and additions
    np.testing.assert_allclose(built, theta(root, tmp_path / "came", root / "fmus/velocity_servo"), atol=1e-13)
    assert described(fmu).compiler


def test_a_build_description_of_fmi_3_is_followed(root: Path, tmp_path: Path):
    macros = MACRO.format("UNUSED", "1") + MACRO.format("sum_of(a, b)", "((a) + (b))")
    fmu = sources_only(root, tmp_path, "torque_motor_fmi3", more=macros)
    assert build_binary(fmu) is not None
    description = described(fmu)
    folder = unpacked(fmu, description.sha256)
    assert len(list(folder.glob("binaries/*/*"))) == 1


def test_a_library_is_built_once(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    fmu = sources_only(root, tmp_path, "velocity_servo")
    first = build_binary(fmu)
    monkeypatch.setenv("PATH", "")
    assert build_binary(fmu) == first


@pytest.mark.skipif(os.name != "posix", reason="owners of POSIX")
def test_a_library_that_another_user_has_built_is_not_loaded(
    tmp_path: Path, give_away: Callable[[Path], None], capsys: pytest.CaptureFixture[str]
):
    digest, binary = "0" * 64, "binaries/linux64/servo.so"
    folder = cache_folder(COMPILED_FOLDER) / digest
    (folder / binary).parent.mkdir(parents=True)
    (folder / binary).write_bytes(b"no good")
    (folder / COMPILER_FILE).write_text('{"compiler": "cc"}')
    assert compiled_library(digest, binary)
    give_away(folder / binary)
    install_compiled(digest, tmp_path)
    assert compiled_library(digest, binary) is None and list(tmp_path.glob("binaries/*/*")) == []
    assert "belongs to user 1234, not to you" in capsys.readouterr().err


def test_an_fmu_with_a_binary_is_not_built(root: Path):
    assert build_binary(root / "fmus/velocity_servo/velocity_servo.fmu") is None


def test_sources_that_do_not_compile_are_refused_with_what_the_compiler_says(root: Path, tmp_path: Path):
    fmu = sources_only(root, tmp_path, "velocity_servo", extra="#error not today\n")
    with pytest.raises(InputRefused, match=r"^[^\n]*do not compile with \w+: [^\n]*not today[^\n]*$"):
        build_binary(fmu)


def test_a_source_outside_its_folder_is_refused(root: Path, tmp_path: Path):
    good = sources_only(root, tmp_path, "velocity_servo")
    fmu = altered(good, tmp_path / "away.fmu", lambda n, c: (n, c.replace(b'"model.c"', b'"../../model.c"')))
    with pytest.raises(InputRefused, match=r"hold no '../../model.c'"):
        build_binary(fmu)


def test_sources_that_are_named_and_not_there_are_not_said_to_be_brought(root: Path, tmp_path: Path):
    good = sources_only(root, tmp_path, "velocity_servo")
    for gone in ("sources/", "sources/access.c"):
        bare = altered(good, tmp_path / "bare.fmu", lambda n, c, gone=gone: None if n.startswith(gone) else (n, c))  # type: ignore[misc]
        with pytest.raises(InputRefused, match=r"it has none\. Export it for linux64$"):
            described(bare)
        with pytest.raises(InputRefused, match="which it lists as a source"):
            build_binary(bare)


def test_an_fmu_without_binary_and_sources_says_where_to_get_one(root: Path, tmp_path: Path):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    bare = altered(
        good, tmp_path / "bare.fmu", lambda n, c: None if n.startswith(("binaries/", "sources/")) else (n, c)
    )
    with pytest.raises(InputRefused, match="Export it for linux64"):
        described(bare)
    with pytest.raises(InputRefused, match="holds no sources"):
        build_binary(bare)


def with_gcc() -> str:
    """Skips without it, but not on CI."""
    if shutil.which("gcc") is None or not sys.platform.startswith("linux"):
        assert "CI" not in os.environ, "this test attacks gcc and CI has to have one"
        pytest.skip("attacks gcc on Linux")
    return "gcc"


@pytest.mark.parametrize("name", ["@options", "-include", "1st", "A B", "A(b", "A=1 -include", "", "A\n#define B"])
def test_a_macro_is_called_by_an_identifier(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str):
    folder = tmp_path / "here"
    folder.mkdir()
    (folder / "victim").write_text("precious")
    # gcc takes the file as options
    (folder / "options").write_text("-aux-info victim -imacros /dev/null\n")
    monkeypatch.chdir(folder)
    fmu = sources_only(root, tmp_path, "torque_motor_fmi3", more=MACRO.format(name.replace("\n", "&#10;"), ""))
    with pytest.raises(InputRefused, match=r"(?s)ask for the macro '.*'; expected an identifier"):
        build_binary(fmu)
    assert (folder / "victim").read_text() == "precious"


def test_a_macro_is_one_line(root: Path, tmp_path: Path):
    fmu = sources_only(root, tmp_path, "torque_motor_fmi3", more=MACRO.format("A", "1&#10;#include x"))
    with pytest.raises(InputRefused, match="a value on one line"):
        build_binary(fmu)


@pytest.mark.parametrize("name", ["other.h", "other.s", "other.o", "@options", "-fplugin=p.so"])
def test_a_source_is_c_or_is_not_compiled(root: Path, tmp_path: Path, name: str):
    fmu = sources_only(root, tmp_path, "torque_motor_fmi3", more=f'<SourceFile name="{name}"/>')
    with ZipFile(fmu, "a") as archive:
        archive.writestr(f"sources/{name}", "")
    with pytest.raises(InputRefused, match=re.escape(f"source '{name}' is neither C nor C++")):
        build_binary(fmu)


def test_a_library_stays_where_libraries_are_kept(root: Path, tmp_path: Path):
    good = sources_only(root, tmp_path, "velocity_servo")
    fmu = altered(
        good,
        tmp_path / "away.fmu",
        lambda n, c: (n, c.replace(b'modelIdentifier="velocity_servo"', b'modelIdentifier="../../../../../away"')),
    )
    with pytest.raises(InputRefused, match=r"modelIdentifier leads to '(\.\./){5}away"):
        build_binary(fmu)
    assert not list(tmp_path.rglob("away.*o"))


def test_a_header_compiled_by_others_is_not_loaded(root: Path, tmp_path: Path):
    """It is a picture of the compiler's memory."""
    gcc = with_gcc()
    header = tmp_path / "early.h"
    header.write_text("#define COMPILED_BEFORE\n")
    options = ["-O2", "-fPIC", "-w", "-DFMI3_OVERRIDE_FUNCTION_PREFIX"]
    subprocess.run([gcc, *options, "-x", "c-header", header, "-o", tmp_path / "early.h.gch"], check=True)
    text = '#include "early.h"\n#ifdef COMPILED_BEFORE\n#error it was loaded\n#endif\n'
    good = sources_only(root, tmp_path, "torque_motor_fmi3", extra=text)

    with ZipFile(good, "a") as archive:
        archive.writestr("sources/early.h", "")
        archive.write(tmp_path / "early.h.gch", "sources/early.h.gch")
    assert build_binary(good) is not None


@pytest.mark.slow
def test_nothing_of_a_compiler_is_left_when_its_time_is_up(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with_gcc()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    monkeypatch.setattr(compiling, "COMPILE_TIMEOUT", 2.0)
    # cc1 waits for the other end of the pipe
    fmu = sources_only(root, tmp_path, "velocity_servo", extra=f'#include "{pipe}"\n')
    with pytest.raises(InputRefused, match="still compile after 2 s"):
        build_binary(fmu)
    with pytest.raises(OSError, match="No such device"):
        os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)


def test_a_compiler_takes_so_much_memory_and_no_more(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with_gcc()
    monkeypatch.setattr(compiling, "MAX_COMPILER_MEMORY", 256 << 20)
    fmu = sources_only(root, tmp_path, "velocity_servo", extra='#include "/dev/zero"\n')
    with pytest.raises(InputRefused, match="do not compile with"):
        build_binary(fmu)


def test_a_compiler_reads_no_input_and_writes_beside_itself(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    with_gcc()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DEPENDENCIES_OUTPUT", str(tmp_path / "dependencies"))
    fmu = sources_only(root, tmp_path, "velocity_servo", extra='#include "/dev/stdin"\n')
    before = set(tmp_path.iterdir())
    readable, writable = os.pipe()
    kept = os.dup(0)
    os.dup2(readable, 0)
    os.write(writable, b"#error it was read\n")
    os.close(writable)
    try:
        build_binary(fmu)
    finally:
        os.dup2(kept, 0)
        os.close(kept)
        os.close(readable)
    assert set(tmp_path.iterdir()) == before
