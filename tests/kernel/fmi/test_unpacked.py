"""What is loaded is what the archive holds, whatever happened to the unpacked files."""

import json
import os
import random
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.damage import KINDS, damage, damaged_folder
from tests.kernel.fmi.archives import altered
from twin.kernel.archive import sha256
from twin.kernel.errors import InputRefused
from twin.kernel.fmi import unpacked as module
from twin.kernel.fmi.description import described
from twin.kernel.fmi.lifecycle import CosimInstance
from twin.kernel.fmi.unpacked import MAX_UNPACKED_FMUS, SEAL_FILE, cache_info, unpacked

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
        damage(content.parent / SEAL_FILE, draw.choice(KINDS), draw)
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
    assert [path.name for path in cache_info().changed] == ["servo.so"]
    for said in (
        "twin: servo.fmu: unpacked files had been changed (binaries/linux64/servo.so): taken from the FMU again\n",
        "",
    ):
        assert held_by(unpacked(fmu, sha256(fmu))) == CONTENTS
        assert capsys.readouterr().err == said
    assert cache_info().changed == ()


def test_what_is_kept_is_counted_in_drives_and_in_bytes(tmp_path: Path):
    fmu = archived(tmp_path / "servo.fmu")
    content = unpacked(fmu, sha256(fmu))
    assert cache_info()[1:] == (1, sum(map(len, CONTENTS.values())), ())
    # what is gone takes no place
    lost = content / "binaries/linux64/servo.so"
    lost.unlink()
    assert cache_info()[2:] == (sum(map(len, CONTENTS.values())) - len(CONTENTS["binaries/linux64/servo.so"]), (lost,))


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
    good = json.loads((folder / SEAL_FILE).read_text())
    for bad in (b"", b"[1]", b"{}", b"[" * 5000, b"\xff", json.dumps({**good, "\0": 1}).encode()):
        (folder / SEAL_FILE).write_bytes(bad)
        cache_info()
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
    (folder / SEAL_FILE).write_text(json.dumps({name: module.stamp_of(f"{folder}/fmu/{name}") for name in CONTENTS}))
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
    monkeypatch.setattr(module, "MAX_UNPACKED_FMUS", 3)
    assert MAX_UNPACKED_FMUS >= 20
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
module.MAX_UNPACKED_FMUS = 1
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
    with pytest.raises(InputRefused, match=r"^TWIN_CACHE=cache: a relative"):
        unpacked(servo, sha256(servo))
    assert list(tmp_path.iterdir()) == []
