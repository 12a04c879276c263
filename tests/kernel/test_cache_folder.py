"""What is kept and run later lies where nobody else can write, and does not grow for ever."""

import os
import shutil
import stat
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from twin.kernel import cache_folder as cache
from twin.kernel.cache_folder import (
    CACHE_VARIABLE,
    cache_base,
    cache_folder,
    discard_foreign,
    evict,
    lock_against_eviction,
    ownership_problem,
    private_folder,
    remove,
)
from twin.kernel.errors import InputRefused

POSIX = pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")
DIGEST = "0123456789abcdef"


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home folder without any wishes of its user."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    return tmp_path


def refused(folder: Path) -> str:
    with pytest.raises(InputRefused) as refusal:
        private_folder(folder)
    return str(refusal.value)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the places of Linux")
@pytest.mark.parametrize(
    ("variable", "value", "place"),
    [
        (CACHE_VARIABLE, "", "{home}/.cache/twin"),
        (CACHE_VARIABLE, "/elsewhere", "/elsewhere"),
        (CACHE_VARIABLE, "~/x", "{home}/x"),
        ("XDG_CACHE_HOME", "/elsewhere", "/elsewhere/twin"),
        # the standard: such a path is to be ignored
        ("XDG_CACHE_HOME", "relative", "{home}/.cache/twin"),
        ("XDG_CACHE_HOME", "", "{home}/.cache/twin"),
    ],
)
def test_the_cache_is_where_the_user_or_the_platform_says(
    home: Path, monkeypatch: pytest.MonkeyPatch, variable: str, value: str, place: str
):
    monkeypatch.setenv(variable, value)
    assert str(cache_base()) == place.format(home=home)


@pytest.mark.parametrize(("value", "said"), [("here", "relative"), ("./x", "relative"), ("~nobody-here/x", "no such")])
def test_a_place_that_depends_on_the_process_is_refused_and_nothing_made(
    home: Path, monkeypatch: pytest.MonkeyPatch, value: str, said: str
):
    monkeypatch.setenv(CACHE_VARIABLE, value)
    monkeypatch.chdir(home)
    with pytest.raises(InputRefused, match=f"^TWIN_CACHE={value}: .*{said}"):
        cache_folder("x")
    assert list(home.iterdir()) == []


@POSIX
def test_what_is_made_is_the_users_alone(home: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(home / "a" / "b"))
    before = os.umask(0)
    try:
        folder = cache_folder("x")
    finally:
        os.umask(before)
    assert folder == home / "a" / "b" / "x"
    assert {stat.S_IMODE(made.stat().st_mode) for made in (folder, folder.parent)} == {0o700}


@POSIX
@pytest.mark.parametrize("mode", [0o770, 0o707, 0o720, 0o1777])
def test_a_folder_that_others_can_write_to_is_refused(tmp_path: Path, mode: int):
    tmp_path.chmod(mode)
    assert f"others can write to it (mode {mode:o})" in refused(tmp_path)


@POSIX
def test_a_folder_that_others_can_only_read_is_taken(tmp_path: Path):
    tmp_path.chmod(0o755)
    assert private_folder(tmp_path) == tmp_path


@POSIX
def test_somebody_elses_folder_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    here = os.geteuid()
    monkeypatch.setattr(cache.os, "geteuid", lambda: here + 1)
    assert f"belongs to user {here}, not to you (user {here + 1})" in refused(tmp_path)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
def test_somebody_elses_link_to_a_folder_of_the_users_is_refused(tmp_path: Path):
    link, mine = tmp_path / "link", tmp_path / "mine"
    mine.mkdir(0o700)
    link.symlink_to(mine)
    assert private_folder(link) == link
    os.lchown(link, 1234, 1234)
    assert "belongs to user 1234" in refused(link)


def kept_folder(home: Path) -> Path:
    """One with folders and files as numba leaves them where files are the group's, too."""
    folder = home / DIGEST
    folder.mkdir(0o700)
    (folder / "module").mkdir()
    (folder / "module").chmod(0o775)
    (folder / "module" / "code.nbc").write_bytes(b"code")
    (folder / "module" / "code.nbc").chmod(0o664)
    (folder / "link").symlink_to("nowhere")
    return folder


@POSIX
@pytest.mark.parametrize("inner", ["", "module", "module/code.nbc", "link"])
def test_what_another_user_has_put_where_it_once_could_is_taken_away_and_said(
    tmp_path: Path, give_away: Callable[[Path], None], capsys: pytest.CaptureFixture[str], inner: str
):
    folder = kept_folder(tmp_path)
    discard_foreign(folder)
    assert folder.is_dir() and capsys.readouterr().err == ""
    give_away(folder / inner)
    discard_foreign(folder)
    assert not folder.exists() and not list(tmp_path.iterdir())
    assert capsys.readouterr().err == (
        f"twin: {folder / inner}: belongs to user 1234, not to you (user {os.geteuid()}): removed, because its "
        "content is executed\n"
    )


@POSIX
def test_a_link_to_what_is_another_users_is_taken_away_and_that_stays(
    tmp_path: Path, give_away: Callable[[Path], None]
):
    theirs, link = tmp_path / "theirs", tmp_path / DIGEST
    theirs.mkdir(0o700)
    link.symlink_to(theirs)
    assert ownership_problem(link) == ""
    give_away(theirs)
    discard_foreign(link)
    assert list(tmp_path.iterdir()) == [theirs]


@POSIX
@pytest.mark.parametrize(("mode", "inner", "fit"), [
    (0o700, 0o775, True), (0o700, 0o777, True), (0o755, 0o755, True),
    (0o755, 0o775, False), (0o711, 0o757, False), (0o770, 0o700, False), (0o702, 0o700, False),
])  # fmt: skip
def test_a_folder_others_may_write_to_is_not_the_users_alone_nor_what_they_may_write_to_within_it(
    tmp_path: Path, mode: int, inner: int, fit: bool
):
    folder = kept_folder(tmp_path)
    (folder / "module").chmod(inner)
    (folder / "module" / "code.nbc").chmod(0o644)
    folder.chmod(mode)
    assert (ownership_problem(folder) == "") is fit
    assert fit or "others can write to it" in ownership_problem(folder)


@POSIX
def test_what_cannot_be_deleted_of_another_users_is_out_of_the_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = kept_folder(tmp_path)

    def refused(*arguments: object, **options: object) -> None:
        raise PermissionError

    monkeypatch.setattr(Path, "chmod", refused)
    monkeypatch.setattr(shutil, "rmtree", lambda path, ignore_errors: None)
    remove(folder)
    assert not folder.exists() and len(list(tmp_path.glob(f".{DIGEST[:12]}-*"))) == 1


def test_what_is_no_folder_is_refused(tmp_path: Path):
    file = tmp_path / "file"
    file.touch()
    assert "not a folder" in refused(file)
    assert "cannot be made a cache folder" in refused(file / "x")


def folders(home: Path, count: int) -> list[Path]:
    """`count` folders, the first used last."""
    made = []
    for number in range(count):
        made.append(home / f"{number:016x}")
        made[-1].mkdir()
        os.utime(made[-1], (time.time() - 10.0 - number,) * 2)
    return made


def test_those_used_last_are_kept(tmp_path: Path):
    made = folders(tmp_path, 6)
    (tmp_path / "of the user").mkdir()
    evict(tmp_path, 3)
    assert sorted(path for path in tmp_path.iterdir() if path in made) == made[:3]
    assert (tmp_path / "of the user").is_dir()


def test_using_a_folder_makes_it_the_last_used(tmp_path: Path):
    made = folders(tmp_path, 3)
    assert lock_against_eviction(made[-1])
    evict(tmp_path, 1)
    assert list(tmp_path.iterdir()) == made[-1:]


@POSIX
def test_one_that_a_process_uses_is_never_evicted(tmp_path: Path):
    made = folders(tmp_path, 4)
    assert lock_against_eviction(made[3])
    os.utime(made[3], (0.0, 0.0))
    evict(tmp_path, 1)
    assert sorted(tmp_path.iterdir()) == [made[0], made[3]]


def test_what_was_left_unfinished_is_cleared_the_day_after(tmp_path: Path):
    for name in (".old", ".new"):
        (tmp_path / name).mkdir()
    os.utime(tmp_path / ".old", (time.time() - 2 * 24 * 3600,) * 2)
    evict(tmp_path, 5)
    assert [path.name for path in tmp_path.iterdir()] == [".new"]


def test_what_is_not_there_cannot_be_held_and_what_was_made_anew_can(tmp_path: Path):
    folder = tmp_path / DIGEST
    assert not lock_against_eviction(folder)
    folder.write_text("a file")
    assert os.name != "posix" or not lock_against_eviction(folder)
    remove(folder)
    folder.mkdir()
    assert lock_against_eviction(folder) and lock_against_eviction(folder)
    remove(folder)
    assert not lock_against_eviction(folder)
    folder.mkdir()
    assert lock_against_eviction(folder)
    # the new one is held, not the one that is gone
    evict(tmp_path, 0 if os.name == "posix" else 1)
    assert list(tmp_path.iterdir()) == [folder]
