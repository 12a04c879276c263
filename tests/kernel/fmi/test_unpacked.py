"""What is loaded is what the archive holds, whatever happened to the unpacked files."""

import json
import os
import random
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.damage import KINDS, damage, damaged_folder
from tests.kernel.fmi.archives import DESCRIPTION, altered
from twin.cli.app import app
from twin.kernel.archive import sha256
from twin.kernel.cache_folder import cache_folder
from twin.kernel.errors import InputRefused
from twin.kernel.fmi import COMPILED
from twin.kernel.fmi import unpacked as compiling
from twin.kernel.fmi import unpacked as module
from twin.kernel.fmi.description import build, described
from twin.kernel.fmi.lifecycle import CosimInstance
from twin.kernel.fmi.unpacked import FACTS, KEPT, SEAL, compiled, shelf, supply, unpacked
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
    done = CliRunner().invoke(app, ["drive", "info", str(fmu), "--compile"])
    assert done.exit_code == 0, done.output
    built = theta(root, tmp_path / "built", fmu)
    # another compiler may contract multiplications and additions
    np.testing.assert_allclose(built, theta(root, tmp_path / "came", root / "fmus/velocity_servo"), atol=1e-13)
    assert described(fmu).compiler


def test_a_build_description_of_fmi_3_is_followed(root: Path, tmp_path: Path):
    macros = MACRO.format("UNUSED", "1") + MACRO.format("sum_of(a, b)", "((a) + (b))")
    fmu = sources_only(root, tmp_path, "torque_motor_fmi3", more=macros)
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


def test_sources_that_are_named_and_not_there_are_not_said_to_be_brought(root: Path, tmp_path: Path):
    good = sources_only(root, tmp_path, "velocity_servo")
    for gone in ("sources/", "sources/access.c"):
        bare = altered(good, tmp_path / "bare.fmu", lambda n, c, gone=gone: None if n.startswith(gone) else (n, c))  # type: ignore[misc]
        with pytest.raises(InputRefused, match=r"it has none\. Export it for linux64$"):
            described(bare)
        with pytest.raises(InputRefused, match="which it says to compile"):
            build(bare)


def test_an_fmu_without_binary_and_sources_says_where_to_get_one(root: Path, tmp_path: Path):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    bare = altered(
        good, tmp_path / "bare.fmu", lambda n, c: None if n.startswith(("binaries/", "sources/")) else (n, c)
    )
    with pytest.raises(InputRefused, match="Export it for linux64"):
        described(bare)
    with pytest.raises(InputRefused, match="holds no sources"):
        build(bare)


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
        build(fmu)
    assert (folder / "victim").read_text() == "precious"


def test_a_macro_is_one_line(root: Path, tmp_path: Path):
    fmu = sources_only(root, tmp_path, "torque_motor_fmi3", more=MACRO.format("A", "1&#10;#include x"))
    with pytest.raises(InputRefused, match="a value on one line"):
        build(fmu)


@pytest.mark.parametrize("name", ["other.h", "other.s", "other.o", "@options", "-fplugin=p.so"])
def test_a_source_is_c_or_is_not_compiled(root: Path, tmp_path: Path, name: str):
    fmu = sources_only(root, tmp_path, "torque_motor_fmi3", more=f'<SourceFile name="{name}"/>')
    with ZipFile(fmu, "a") as archive:
        archive.writestr(f"sources/{name}", "")
    with pytest.raises(InputRefused, match=re.escape(f"source '{name}' is neither C nor C++")):
        build(fmu)


def test_a_library_stays_where_libraries_are_kept(root: Path, tmp_path: Path):
    good = sources_only(root, tmp_path, "velocity_servo")
    fmu = altered(
        good,
        tmp_path / "away.fmu",
        lambda n, c: (n, c.replace(b'modelIdentifier="velocity_servo"', b'modelIdentifier="../../../../../away"')),
    )
    with pytest.raises(InputRefused, match=r"modelIdentifier leads to '(\.\./){5}away"):
        build(fmu)
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
    assert build(good) is not None


def test_nothing_of_a_compiler_is_left_when_its_time_is_up(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with_gcc()
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    monkeypatch.setattr(compiling, "PATIENCE", 2.0)
    # cc1 waits for the other end of the pipe
    fmu = sources_only(root, tmp_path, "velocity_servo", extra=f'#include "{pipe}"\n')
    with pytest.raises(InputRefused, match="still compile after 2 s"):
        build(fmu)
    with pytest.raises(OSError, match="No such device"):
        os.open(pipe, os.O_WRONLY | os.O_NONBLOCK)


def test_a_compiler_takes_so_much_memory_and_no_more(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with_gcc()
    monkeypatch.setattr(compiling, "MOST_MEMORY", 256 << 20)
    fmu = sources_only(root, tmp_path, "velocity_servo", extra='#include "/dev/zero"\n')
    with pytest.raises(InputRefused, match="do not compile with"):
        build(fmu)


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
        build(fmu)
    finally:
        os.dup2(kept, 0)
        os.close(kept)
        os.close(readable)
    assert set(tmp_path.iterdir()) == before


CONTENTS = {
    "modelDescription.xml": b"<fmiModelDescription/>" * 20,
    "binaries/linux64/servo.so": bytes(range(256)) * 40,
    "resources/deep/down/table.csv": b"1,2,3\n" * 30,
}


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def servo(root: Path) -> Path:
    return root / "fmus" / "velocity_servo" / "velocity_servo.fmu"


def archived(file: Path, **more: bytes) -> Path:
    """An archive of a few files and an empty folder; what is in them does not matter here."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as target:
        for name, content in {**CONTENTS, **more}.items():
            target.writestr(name, content)
        target.mkdir("documentation")
    return file


def held_by(folder: Path) -> dict[str, bytes]:
    """Name -> content of all files in `folder`."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_same_content_is_unpacked_once_whatever_its_name(tmp_path: Path, servo: Path, cache: Path):
    first = unpacked(servo, sha256(servo))
    copy = tmp_path / "other_name.fmu"
    copy.write_bytes(servo.read_bytes())
    assert unpacked(copy, sha256(copy)) == first
    with zipfile.ZipFile(servo) as archive:
        assert held_by(first) == {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
    assert [f.name for f in (cache / "unpacked").iterdir()] == [sha256(servo)]


def test_other_content_of_the_same_name_is_unpacked_apart(tmp_path: Path, servo: Path):
    other = altered(servo, tmp_path / "velocity_servo.fmu", lambda n, c: (n, c + b" "))
    assert unpacked(other, sha256(other)) != unpacked(servo, sha256(servo))


def test_a_cache_that_cannot_be_written_is_a_sentence(tmp_path: Path, servo: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("TWIN_CACHE", str(tmp_path / "file"))
    with pytest.raises(InputRefused, match=r"not a folder.*set TWIN_CACHE"):
        unpacked(servo, sha256(servo))


def test_entries_with_the_separators_of_windows_are_unpacked_to_the_same_places(tmp_path: Path, servo: Path):
    odd = tmp_path / "odd.fmu"
    with zipfile.ZipFile(servo) as source, zipfile.ZipFile(odd, "w") as target:
        for name in source.namelist():
            info = zipfile.ZipInfo("x")
            info.filename = name.replace("/", "\\")
            target.writestr(info, source.read(name))
    fmu = described(odd)
    folder, plain = unpacked(odd, fmu.sha256), unpacked(servo, described(servo).sha256)
    places, expected = ({str(f.relative_to(one)) for f in one.rglob("*.*")} for one in (folder, plain))
    assert places == expected
    CosimInstance("drive_1", fmu, folder).close()


def test_folders_of_the_archive_without_files_are_there(tmp_path: Path):
    fmu = archived(tmp_path / "servo.fmu")
    assert (unpacked(fmu, sha256(fmu)) / "documentation").is_dir()


def attacked(fmu: Path, draw: random.Random, say: Callable[[], str]) -> None:
    """Damage what is unpacked of `fmu` at random: the next use mends it and says so, the one after has nothing to."""
    digest = sha256(fmu)
    content = unpacked(fmu, digest)
    say()
    for _ in range(draw.randrange(1, 4)):
        name = draw.choice(sorted(CONTENTS))
        if draw.random() < 0.1:
            damaged_folder(
                draw.choice([content, content / "binaries", content / "resources/deep", content.parent]), draw
            )
            break
        if (content / name).is_file() and os.path.getsize(content / name):
            damage(content / name, draw.choice(KINDS), draw)
    if draw.random() < 0.2 and content.parent.is_dir():
        damage(content.parent / SEAL, draw.choice(KINDS), draw)
    assert held_by(unpacked(fmu, digest)) == CONTENTS
    said = say()
    assert said.count("\n") <= 1 and "Traceback" not in said
    assert unpacked(fmu, digest) == content
    assert say() == ""


@pytest.mark.parametrize("rounds", [60, pytest.param(3000, marks=pytest.mark.endurance)])
def test_whatever_is_damaged_is_mended(tmp_path: Path, capsys: pytest.CaptureFixture[str], rounds: int):
    fmu = archived(tmp_path / "servo.fmu")
    for seed in range(rounds):
        attacked(fmu, random.Random(seed), lambda: capsys.readouterr().err)
    assert sorted(path.name for path in (tmp_path / "cache" / "unpacked").iterdir()) == [sha256(fmu)]


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_damage_is_seen_and_said_once(tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str):
    fmu = archived(tmp_path / "servo.fmu")
    content = unpacked(fmu, sha256(fmu))
    damage(content / "binaries/linux64/servo.so", kind, random.Random(1))
    assert [path.name for path in shelf().changed] == ["servo.so"]
    for said in (
        "twin: servo.fmu: unpacked files had been changed (binaries/linux64/servo.so): taken from the FMU again\n",
        "",
    ):
        assert held_by(unpacked(fmu, sha256(fmu))) == CONTENTS
        assert capsys.readouterr().err == said
    assert shelf().changed == ()


def test_what_is_kept_is_counted_in_drives_and_in_bytes(tmp_path: Path):
    fmu = archived(tmp_path / "servo.fmu")
    content = unpacked(fmu, sha256(fmu))
    assert shelf()[1:] == (1, sum(map(len, CONTENTS.values())), ())
    # what is gone takes no place
    lost = content / "binaries/linux64/servo.so"
    lost.unlink()
    assert shelf()[2:] == (sum(map(len, CONTENTS.values())) - len(CONTENTS["binaries/linux64/servo.so"]), (lost,))


def test_what_was_only_touched_is_no_damage_and_read_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    fmu = archived(tmp_path / "servo.fmu")
    content = unpacked(fmu, sha256(fmu))
    os.utime(content / "modelDescription.xml", (0.0, 0.0))
    read, same = [], module._is_same

    def noted(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> bool:
        read.append(entry.filename)
        return same(archive, entry, path)

    monkeypatch.setattr(module, "_is_same", noted)
    for _ in range(3):
        unpacked(fmu, sha256(fmu))
    assert read == ["modelDescription.xml"]
    assert capsys.readouterr().err == ""


def test_a_seal_that_was_damaged_costs_one_comparison(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    fmu = archived(tmp_path / "servo.fmu")
    folder = unpacked(fmu, sha256(fmu)).parent
    good = json.loads((folder / SEAL).read_text())
    for bad in (b"", b"[1]", b"{}", b"[" * 5000, b"\xff", json.dumps({**good, "\0": 1}).encode()):
        (folder / SEAL).write_bytes(bad)
        shelf()
        unpacked(fmu, sha256(fmu))
    assert capsys.readouterr().err == ""


def test_what_an_fmu_adds_to_its_folder_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    fmu = archived(tmp_path / "servo.fmu")
    content = unpacked(fmu, sha256(fmu))
    (content / "resources" / "notes.txt").write_text("of the FMU's own")
    assert (unpacked(fmu, sha256(fmu)) / "resources" / "notes.txt").is_file()
    assert capsys.readouterr().err == ""


def test_what_is_loaded_stays_as_it_was_loaded(tmp_path: Path):
    fmu = archived(tmp_path / "servo.fmu")
    library = unpacked(fmu, sha256(fmu)) / "binaries/linux64/servo.so"
    with library.open("rb") as loaded:
        content = loaded.read()
        os.utime(library, (0.0, 0.0))
        library.unlink()
        unpacked(fmu, sha256(fmu))
        loaded.seek(0)
        assert loaded.read() == content
        assert library.read_bytes() == content


@pytest.mark.skipif(os.name != "posix", reason="owners of POSIX")
@pytest.mark.parametrize("inner", [".", "fmu/binaries", "fmu/binaries/linux64/libm.so.6"])
def test_what_another_user_has_unpacked_is_not_loaded(
    tmp_path: Path, give_away: Callable[[Path], None], capsys: pytest.CaptureFixture[str], inner: str
):
    fmu = archived(tmp_path / "servo.fmu")
    folder = unpacked(fmu, sha256(fmu)).parent
    # as it was found when it was sealed, so that nothing is compared; and one that the archive does not have
    library = folder / "fmu/binaries/linux64/servo.so"
    library.write_bytes(b"no good")
    (library.parent / "libm.so.6").write_bytes(b"no good")
    (folder / SEAL).write_text(json.dumps({name: module.stamp_of(f"{folder}/fmu/{name}") for name in CONTENTS}))
    give_away(folder / inner)
    assert held_by(unpacked(fmu, sha256(fmu))) == CONTENTS
    assert capsys.readouterr().err.startswith(f"twin: {folder / inner}: belongs to user 1234, not to you")
    assert held_by(unpacked(fmu, sha256(fmu))) == CONTENTS and capsys.readouterr().err == ""


def test_a_truncated_library_is_not_blamed_on_its_maker(servo: Path, capsys: pytest.CaptureFixture[str]):
    fmu = described(servo)
    library = next(unpacked(servo, fmu.sha256).glob("binaries/linux64/*.so"))
    library.write_bytes(library.read_bytes()[:5000])
    CosimInstance("drive_1", fmu, unpacked(servo, fmu.sha256)).close()
    assert "unpacked files had been changed" in capsys.readouterr().err


def test_old_folders_are_evicted_and_those_in_use_never(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(module, "KEPT", 3)
    assert KEPT >= 20
    first = archived(tmp_path / "first.fmu")
    content = unpacked(first, sha256(first))
    home = content.parents[1]
    for number in range(6):
        # as if another process had unpacked it and ended
        other = home / f"{number:064x}"
        shutil.copytree(content.parent, other)
        os.utime(other, (1000.0 + number,) * 2)
    os.utime(content.parent, (0.0, 0.0))
    second = archived(tmp_path / "second.fmu", more=b"content")
    new = unpacked(second, sha256(second))
    # three used last, and the one that this process has
    assert {path.name for path in home.iterdir()} == {
        new.parent.name, f"{5:064x}", f"{4:064x}", *([content.parent.name] if os.name == "posix" else []),
    }  # fmt: skip
    assert held_by(content) == CONTENTS


ATTACK = """
import random, sys, zipfile
from pathlib import Path
from twin.kernel.fmi import unpacked as module
from twin.kernel.archive import sha256
module.KEPT = 1
name = "binaries/linux64/servo.so"
draw = random.Random(int(sys.argv[1]))
for _ in range(int(sys.argv[2])):
    fmu = Path(draw.choice(sys.argv[3:]))
    wanted = zipfile.ZipFile(fmu).read(name)
    library = module.unpacked(fmu, sha256(fmu)) / name
    assert library.read_bytes() == wanted
    # a whole file in the place of a whole one, as nobody is to read a half of either
    if draw.random() < 0.3:
        beside = library.with_name(f"{sys.argv[1]}.so")
        beside.write_bytes(wanted)
        beside.rename(library)
"""


@pytest.mark.parametrize("rounds", [40, pytest.param(2000, marks=pytest.mark.endurance)])
def test_processes_side_by_side_find_it_whole(root: Path, tmp_path: Path, rounds: int):
    fmus = [archived(tmp_path / f"{number}.fmu", number=bytes([number])) for number in range(4)]
    started = [
        subprocess.Popen(
            [sys.executable, "-c", ATTACK, str(seed), str(rounds), *map(str, fmus)],
            cwd=root, stderr=subprocess.PIPE, text=True,
        )
        for seed in range(2)
    ]  # fmt: skip
    said = [process.communicate()[1] for process in started]
    assert [process.returncode for process in started] == [0, 0], "".join(said)


def test_a_relative_cache_is_one_sentence_and_leaves_no_folder(
    servo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TWIN_CACHE", "cache")
    with pytest.raises(InputRefused, match=r"^TWIN_CACHE=cache: relative"):
        unpacked(servo, sha256(servo))
    assert list(tmp_path.iterdir()) == []
