"""An answer is made once, and again as soon as anything is another that it was made of."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.installations import forget_installation
from twin.kernel import cache_folder as module
from twin.kernel.cache_folder import HOME, MOST_ANSWERS, VARIABLE, cache_folder, cached_answer, contents

ANSWER = "what it is: 3 µm\n"


class Asked:
    """Asks, and counts how often the answer had to be made."""

    def __init__(self) -> None:
        self.made = 0

    def __call__(self, name: str = "question", made_of: str | None = "this", lasts: bool = True) -> str:
        forget_installation()
        return cached_answer(name, self.make, lambda: made_of, lambda: lasts)

    def make(self) -> str:
        self.made += 1
        return ANSWER


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Asked]:
    """With an installation of its own: a package, and one that is installed beside it."""
    package, packages = tmp_path / "package", tmp_path / "packages"
    (package / "room").mkdir(parents=True)
    (package / "room" / "part.py").write_text("x = 1\n")
    (packages / "other-1.0.dist-info").mkdir(parents=True)
    (packages / "other-1.0.dist-info" / "METADATA").write_text("Name: other\n")
    monkeypatch.setattr(module, "PACKAGE", package)
    monkeypatch.setattr("sys.path", [str(packages), str(tmp_path / "nowhere")])
    forget_installation()
    yield Asked()
    forget_installation()


def answers() -> list[Path]:
    return sorted(cache_folder(HOME).iterdir())


def test_it_is_made_once(asked: Asked):
    assert [asked() for _ in range(3)] == [ANSWER] * 3
    assert asked.made == 1 and len(answers()) == 1


def test_another_question_or_another_matter_has_another_answer(asked: Asked):
    for number, (name, made_of) in enumerate([("a", "bc"), ("ab", "c"), ("a", "b")], start=1):
        asked(name, made_of)
        assert asked.made == number


@pytest.mark.parametrize(
    "change",
    [
        lambda here: (here / "package" / "room" / "part.py").write_text("x = 2\n"),
        lambda here: (here / "package" / "room" / "part.py").rename(here / "package" / "room" / "piece.py"),
        lambda here: (here / "package" / "new.py").write_text(""),
        lambda here: (here / "packages" / "other-1.0.dist-info").rename(here / "packages" / "other-1.1.dist-info"),
        lambda here: os.utime(here / "packages" / "other-1.0.dist-info" / "METADATA", ns=(0, 7)),
        lambda here: (here / "packages" / "third-1.0.dist-info").mkdir(),
        lambda here: (here / "packages" / "other-1.0.dist-info" / "METADATA").unlink(),
    ],
)
def test_what_is_installed_counts(change: Callable[[Path], object], asked: Asked, tmp_path: Path):
    asked()
    change(tmp_path)
    asked()
    assert asked.made == 2


def test_of_the_source_only_the_rooms_count_that_are_named_and_what_is_above_them(asked: Asked, tmp_path: Path):
    def ask() -> int:
        forget_installation()
        cached_answer("question", asked.make, rooms=("room",))
        return asked.made

    (tmp_path / "package" / "other" / "room").mkdir(parents=True)
    assert ask() == 1
    (tmp_path / "package" / "other" / "room" / "part.py").write_text("y = 1\n")
    assert ask() == 1
    (tmp_path / "package" / "above.py").write_text("z = 1\n")
    assert ask() == 2
    (tmp_path / "package" / "room" / "part.py").write_text("x = 2\n")
    assert ask() == 3


def test_another_place_counts(asked: Asked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    asked()
    (tmp_path / "package").rename(tmp_path / "moved")
    monkeypatch.setattr(module, "PACKAGE", tmp_path / "moved")
    asked()
    assert asked.made == 2


def test_names_of_files_may_be_of_any_bytes(asked: Asked):
    odd = os.fsdecode(b"\xff\xe9.fmu")
    for _ in range(2):
        assert cached_answer("question", lambda: odd, lambda: odd) == odd
    assert len(answers()) == 1


@pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")
def test_an_answer_that_another_user_has_given_or_could_change_is_made_again(
    asked: Asked, give_away: Callable[[Path], None]
):
    asked()
    give_away(answers()[0])
    assert [asked(), asked()] == [ANSWER] * 2 and asked.made == 2
    answers()[0].chmod(0o664)
    assert [asked(), asked()] == [ANSWER] * 2 and asked.made == 3


@pytest.mark.skipif(os.name != "posix", reason="owners and modes of POSIX")
def test_an_answer_is_the_users_alone_whatever_the_umask(asked: Asked):
    before = os.umask(0)
    try:
        asked()
    finally:
        os.umask(before)
    assert answers()[0].stat().st_mode & 0o777 == 0o600


def forged(file: Path) -> None:
    seal, _, _ = file.read_bytes().partition(b"\n")
    file.write_bytes(seal + b"\nsomething else\n")


def pipe(file: Path) -> None:
    file.unlink()
    os.mkfifo(file)


def folder(file: Path) -> None:
    file.unlink()
    file.mkdir()


@pytest.mark.parametrize(
    "damage",
    [
        lambda file: file.write_bytes(b""),
        lambda file: file.write_bytes(b"\xff" * 100),
        lambda file: file.write_bytes(file.read_bytes()[:-1]),
        forged,
        pytest.param(pipe, marks=pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")),
        folder,
    ],
)
def test_what_was_damaged_or_forged_is_made_again(damage: Callable[[Path], object], asked: Asked):
    asked()
    (file,) = answers()
    damage(file)
    assert asked() == ANSWER and asked.made == 2


def test_the_answer_to_one_question_does_not_pass_for_that_to_another(asked: Asked):
    cached_answer("other", lambda: "wrong")
    (wrong,) = answers()
    asked()
    (right,) = set(answers()) - {wrong}
    right.write_bytes(wrong.read_bytes())
    assert asked() == ANSWER and asked.made == 2


def test_where_nothing_can_be_kept_it_is_made_every_time(asked: Asked, cache: Path):
    cache.write_text("no folder")
    assert [asked(), asked()] == [ANSWER] * 2 and asked.made == 2


def test_a_full_disk_costs_time_only(asked: Asked, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(Path, "write_bytes", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    assert asked() == ANSWER and answers() == []


def test_what_cannot_be_told_or_does_not_last_is_not_kept(asked: Asked):
    asked(made_of=None)
    asked(lasts=False)
    assert asked.made == 2 and answers() == []


def test_what_changes_while_it_is_made_is_not_kept(asked: Asked, tmp_path: Path):
    def made() -> str:
        (tmp_path / "package" / "room" / "part.py").write_text("x = 3\n")
        return asked.make()

    cached_answer("question", made, lambda: "this")
    (tmp_path / "package" / "room" / "part.py").write_text("x = 1\n")
    asked()
    assert asked.made == 2


def test_those_asked_for_least_recently_go_first(asked: Asked):
    for number in range(MOST_ANSWERS + 5):
        asked(str(number))
        asked("0")
    assert len(answers()) == MOST_ANSWERS
    asked("0")
    assert asked.made == MOST_ANSWERS + 5


@pytest.fixture
def matter(tmp_path: Path) -> Path:
    (tmp_path / "matter" / "deep").mkdir(parents=True)
    (tmp_path / "matter" / "deep" / "a.bin").write_bytes(bytes(100))
    (tmp_path / "matter" / "b.toml").write_text("b = 1\n")
    return tmp_path / "matter"


@pytest.mark.parametrize(
    "change",
    [
        lambda here: (here / "deep" / "a.bin").write_bytes(bytes(99) + b"\1"),
        lambda here: (here / "b.toml").rename(here / "c.toml"),
        lambda here: (here / "b.toml").rename(here / "deep" / "b.toml"),
        lambda here: (here / "c.toml").write_text(""),
        lambda here: (here / "empty.fmu").mkdir(),
        lambda here: (here / "b.toml").unlink(),
    ],
)
def test_contents_are_every_name_and_every_byte(change: Callable[[Path], object], matter: Path):
    before = contents(matter)
    assert before == contents(matter)
    change(matter)
    assert contents(matter) not in (before, None)


def test_contents_are_those_of_one_place_and_of_nothing_that_python_compiles(matter: Path):
    before = contents(matter)
    (matter / "__pycache__").mkdir()
    (matter / "__pycache__" / "a.pyc").write_bytes(b"")
    assert contents(matter) == before
    assert contents(matter.rename(matter.with_name("moved"))) != before


def test_contents_that_lie_elsewhere_or_are_no_files_or_too_many_cannot_be_told(
    matter: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    assert contents(tmp_path / "nowhere") is None
    (matter / "link").symlink_to(tmp_path)
    assert contents(matter) is None
    (matter / "link").unlink()
    assert contents(matter)
    monkeypatch.setattr(module, "MOST_BYTES", 50)
    assert contents(matter) is None
