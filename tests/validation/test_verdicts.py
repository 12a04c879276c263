"""What `make validation` says and ends with, with differences that nobody has measured."""

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from twin.kernel.files import read_json
from validation import __main__ as command
from validation.page import BEGIN, rewritten, table
from validation.yardstick import Finding, NotHere, Yardstick, found


def yardstick(differences: Callable[[], Mapping[str, float]], packages: tuple[str, ...] = ()) -> Yardstick:
    return Yardstick("a claim", "its maker", "N", 0.5, "a reason", differences, packages)


STATED = yardstick(dict)


def raises(error: Exception) -> Callable[[], Mapping[str, float]]:
    def differences() -> Mapping[str, float]:
        raise error

    return differences


@pytest.mark.parametrize(
    ("differences", "packages", "verdict", "told"),
    [
        (lambda: {"a": 0.5, "b": 0.1}, ("numpy",), "holds", "a"),
        (lambda: {"a": 0.1, "b": 0.500001}, (), "EXCEEDED", "b"),
        (lambda: {"a": 0.1, "b": float("nan"), "c": 0.2}, (), "EXCEEDED", "b"),
        (lambda: {"a": float("inf")}, (), "EXCEEDED", "a"),
        (lambda: {}, (), "FAILED", "nothing was compared"),
        (raises(RuntimeError("out of order")), (), "FAILED", "RuntimeError: out of order"),
        (raises(NotHere("its library lacks TBB")), (), "not run", "its library lacks TBB"),
        (lambda: {"a": 0.0}, ("no-such-package",), "not run", "no-such-package is not installed"),
    ],
)
def test_only_a_difference_within_its_bound_holds(
    differences: Callable[[], Mapping[str, float]], packages: tuple[str, ...], verdict: str, told: str
):
    finding = found("here", yardstick(differences, packages))
    assert finding.verdict == verdict
    assert told in finding.quantity + finding.remark


@pytest.mark.parametrize(
    ("verdicts", "code"),
    [((0.1, None), 0), ((0.1, 0.6), 1), ((), 0)],
)
def test_what_is_exceeded_ends_it_with_1_and_what_was_not_run_does_not(
    verdicts: tuple[float | None, ...], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    come = [
        Finding("one", STATED, remark="no library", ran=False) if d is None else Finding("one", STATED, d, "F_z")
        for d in verdicts
    ]
    monkeypatch.setattr(command, "names", lambda: ["one"])
    monkeypatch.setattr(command, "apart", lambda name: come)
    monkeypatch.setattr(command, "DATA", tmp_path / "data.json")
    monkeypatch.setattr(command, "PAGE", tmp_path / "page.md")
    command.PAGE.write_text(f"prose\n{BEGIN}old\n")
    assert command.main([]) == code
    facts_kept = read_json(command.DATA)
    assert command.PAGE.read_text() == f"prose\n{BEGIN}\n{table(facts_kept)}"
    # of some only nothing is written
    command.DATA.unlink()
    assert command.main(["one"]) == code
    assert not command.DATA.exists()


def test_one_that_failed_without_a_difference_ends_it_with_1():
    assert command.code([Finding("one", STATED, remark="its process crashed")]) == 1


def test_a_name_that_is_none_is_refused(capsys: pytest.CaptureFixture[str]):
    assert command.main(["libcosin"]) == 2
    assert "libcosin: no such yardstick; did you mean 'libcosim'?" in capsys.readouterr().err


def test_a_page_that_does_not_say_where_the_table_begins_is_left_alone():
    with pytest.raises(ValueError, match="lacks the line"):
        rewritten("prose\n", {"findings": [], "platform": "here"})
