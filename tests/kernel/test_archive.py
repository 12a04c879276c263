import stat
import zipfile
import zlib
from pathlib import Path

import pytest

from twin.kernel import archive
from twin.kernel.archive import entries
from twin.kernel.errors import InputRefused


@pytest.fixture
def servo(root: Path) -> Path:
    return root / "fmus" / "velocity_servo" / "velocity_servo.fmu"


def refusal(file: Path) -> str:
    with pytest.raises(InputRefused) as refused:
        entries(file)
    return str(refused.value)


def zipped(file: Path, **contents: bytes) -> Path:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as target:
        for name, content in contents.items():
            target.writestr(name, content)
    return file


def test_what_is_no_zip_and_what_is_truncated_are_refused(tmp_path: Path, servo: Path):
    text = tmp_path / "text.fmu"
    text.write_text("not a zip")
    assert "not a complete FMU" in refusal(text)
    cut = tmp_path / "cut.fmu"
    cut.write_bytes(servo.read_bytes()[:-1000])
    assert "not a complete FMU" in refusal(cut)


def test_a_damaged_entry_is_refused(tmp_path: Path, servo: Path):
    with zipfile.ZipFile(servo) as source:
        start = source.getinfo("binaries/linux64/velocity_servo.so").header_offset
    content = bytearray(servo.read_bytes())
    content[start + 200] ^= 0xFF
    bad = tmp_path / "damaged.fmu"
    bad.write_bytes(content)
    said = refusal(bad)
    assert "is damaged; get the FMU again" in said or "not a complete FMU" in said


@pytest.mark.parametrize("name", ["../evil.so", "/etc/evil", "C:/evil", "..\\evil.dll", "a/../../evil"])
def test_an_entry_that_points_outside_is_refused(tmp_path: Path, name: str):
    file = tmp_path / "bad.fmu"
    info = zipfile.ZipInfo("x")
    info.filename = name
    with zipfile.ZipFile(file, "w") as target:
        target.writestr(info, b"x")
    assert "points outside the archive" in refusal(file)


def test_a_link_is_refused(tmp_path: Path):
    file = tmp_path / "bad.fmu"
    info = zipfile.ZipInfo("resources/link")
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(file, "w") as target:
        target.writestr(info, b"/etc/passwd")
    assert "is a link" in refusal(file)


def test_a_zip_bomb_is_refused_without_unpacking_it(tmp_path: Path):
    bomb = zipped(tmp_path / "bomb.fmu", zeros=bytes(archive.MIN_SUSPICIOUS_BYTES + 1))
    assert bomb.stat().st_size < 1 << 20
    assert "would expand from" in refusal(bomb)


def test_too_many_entries_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(archive, "MAX_ENTRIES", 2)
    assert "3 entries" in refusal(zipped(tmp_path / "many.fmu", a=b"", b=b"", c=b""))


def test_ten_thousand_entries_are_let_pass_and_one_more_is_not(tmp_path: Path):
    names = [str(i) for i in range(10_000)]
    assert len(entries(zipped(tmp_path / "full.fmu", **dict.fromkeys(names, b"")))) == 10_000
    assert "10001 entries" in refusal(zipped(tmp_path / "fuller.fmu", **dict.fromkeys([*names, "more"], b"")))


def test_what_shrinks_to_a_200th_is_let_pass_and_what_is_a_byte_longer_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    # as if a few kB were many: the ratio is the same
    monkeypatch.setattr(archive, "MIN_SUSPICIOUS_BYTES", 0)

    def deflated(zeros: int) -> int:
        packer = zlib.compressobj(wbits=-zlib.MAX_WBITS)
        return len(packer.compress(bytes(zeros)) + packer.flush())

    # zeros + stored = 200 (deflated + stored), in whole bytes
    zeros = next(n for n in range(100_000, 200_000) if (n - 200 * deflated(n)) % 199 == 0)
    stored = (zeros - 200 * deflated(zeros)) // 199
    assert deflated(zeros + 1) == deflated(zeros)
    for more in (0, 1):
        with zipfile.ZipFile(tmp_path / f"{more}.fmu", "w") as target:
            target.writestr("stored", bytes(stored), zipfile.ZIP_STORED)
            target.writestr("zeros", bytes(zeros + more), zipfile.ZIP_DEFLATED)
    assert entries(tmp_path / "0.fmu") == {"stored": stored, "zeros": zeros}
    assert "would expand from" in refusal(tmp_path / "1.fmu")
