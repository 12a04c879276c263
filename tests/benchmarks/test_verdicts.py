"""What `make bench` says and ends with, with figures that nobody has measured."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from benchmarks import __main__ as bench
from benchmarks.measurement import Measurement

KEPT = Measurement("kept", 1.0, "s", at_most=1.0)
SLOW = Measurement("slow", 1.001, "s", at_most=1.0)
FEW = Measurement("few", 149.0, "x", at_least=150.0)
BROKEN = Measurement("broken", float("nan"), "s", at_most=1.0)
TOLD = Measurement("told", 7.0, "MB")
ABSENT = Measurement("absent", None, "s", at_most=1.0, remark="no compiler here")


@pytest.mark.parametrize(
    ("measured", "code", "said"),
    [
        ([KEPT, TOLD], 0, ["no target missed"]),
        ([KEPT, SLOW, TOLD], 1, ["missed: slow"]),
        ([SLOW, FEW, BROKEN], 1, ["missed: slow, few, broken"]),
        ([KEPT, ABSENT], 0, ["no target missed", "not measured: absent (no compiler here)"]),
        ([ABSENT, FEW], 1, ["missed: few", "not measured: absent (no compiler here)"]),
    ],
)
def test_a_missed_target_ends_it_with_1_and_what_was_not_measured_is_named(
    measured: list[Measurement],
    code: int,
    said: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.setattr(bench, "PARTS", {"first": lambda: measured[:1], "second": lambda: measured[1:]})
    monkeypatch.setattr(bench, "RESULT", tmp_path / "results" / "bench.json")
    assert bench.main() == code
    lines = capsys.readouterr().out.splitlines()
    assert lines[2 + len(measured) :] == said
    written = json.loads(bench.RESULT.read_text())["measurements"]
    assert [m["verdict"] for m in written] == [m.verdict for m in measured]


def broken() -> Iterator[Measurement]:
    yield KEPT
    raise RuntimeError("ends differently\nin two lines")


def test_a_part_that_fails_is_named_and_the_others_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(bench, "PARTS", {"first": broken, "second": lambda: [TOLD], "third": lambda: [ABSENT]})
    monkeypatch.setattr(bench, "RESULT", tmp_path / "results" / "bench.json")
    assert bench.main(only=["first", "second"]) == 1
    said = capsys.readouterr()
    assert said.out.splitlines()[2:] == [
        bench.line(KEPT), bench.line(TOLD), "no target missed", "failed: first (RuntimeError: ends differently)",
    ]  # fmt: skip
    assert "in broken" in said.err
    assert [m["name"] for m in json.loads(bench.RESULT.read_text())["measurements"]] == ["kept", "told"]


def test_the_table_has_a_line_of_80_columns_for_each():
    lines = [bench.line(m) for m in (KEPT, SLOW, FEW, TOLD, ABSENT)]
    assert [line.split()[-1] for line in lines] == ["ok", "MISSED", "MISSED", "MB", "measured"]
    assert max(map(len, lines)) <= 80


def test_the_history_gets_a_line_for_a_release_and_for_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(bench, "PARTS", {"one": lambda: [KEPT, ABSENT]})
    monkeypatch.setattr(bench, "RESULT", tmp_path / "results" / "bench.json")
    monkeypatch.setattr(bench, "HISTORY", tmp_path / "history.jsonl")
    for release in ("0.1.0", None, "0.2.0"):
        bench.main(release)
    lines = [json.loads(line) for line in bench.HISTORY.read_text().splitlines()]
    assert [line["release"] for line in lines] == ["0.1.0", "0.2.0"]
    # what could not be measured is no figure of the past
    assert [line["values"] for line in lines] == [{"kept": [1.0, "s"]}] * 2
