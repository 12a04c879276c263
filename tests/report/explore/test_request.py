"""Whatever a page sends is checked field by field before anything is done with it."""

import json
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.report.explore.test_worker import BASE
from twin.kernel.errors import InputRefused
from twin.kernel.process.reporter import DirectReporter
from twin.report.explore.request import OPERATION_FIELDS, REQUIRED_FIELDS, check_request
from twin.report.explore.worker import REQUEST_HANDLERS, answer_request

ODD: tuple[Any, ...] = (
       10**30, -(2**60), 1e308, float("nan"), float("inf"), None, True, "x", "", [], {}, [[]], [{}], {"set": []},
       {"set": {"duration_s": 10**400}}, {"set": {"controller.force.kp_mm_per_N": [1]}}, {"drive": []}, {"body": {}},
       {"faults": [{"kind": []}]}, {"faults": [{"kind": "belt_slip", "target": [], "onset_s": 10**400}]}, {"set": None},
       {"faults": {"a": 1}}, [0, 10**400], -1)  # fmt: skip
SOUND: dict[str, Any] = {
    "settings": [], "state": {"set": {"duration_s": 1.0}}, "panels": [], "span": None, "width": 100, "run": "x",
    "name": "/", "accepted": [], "log": "x.csv", "shift_s": 0.0, "point": 0,
}  # fmt: skip


def test_every_operation_of_the_processes_has_its_fields():
    assert set(OPERATION_FIELDS) == set(REQUEST_HANDLERS)
    assert set(REQUIRED_FIELDS) <= {name for fields in OPERATION_FIELDS.values() for name in fields}


@examples(60)
@given(
    op=st.sampled_from(
        [op for op in OPERATION_FIELDS if op not in ("runs", "loops", "score", "begin", "show", "describe")]
    ),
    field=st.integers(0, 9),
    value=st.sampled_from(ODD),
)
def test_odd_values_in_any_field_are_a_sentence(op: str, field: int, value: Any):
    name = list(OPERATION_FIELDS[op])[field % len(OPERATION_FIELDS[op])]
    ask = {"op": op, **{key: SOUND.get(key) for key in OPERATION_FIELDS[op]}, name: value}
    found = answer_request(DirectReporter(lambda note: None), os.getcwd(), dict(BASE), ask)
    assert "Traceback" not in json.dumps(found)


@pytest.mark.parametrize("op", ["show", "describe", "loops", "score", "begin"])
@pytest.mark.parametrize("value", ODD)
def test_no_number_is_too_large_and_nothing_is_unhashable(op: str, value: Any):
    for name in OPERATION_FIELDS[op]:
        ask = {"op": op, **{key: SOUND.get(key) for key in OPERATION_FIELDS[op]}, name: value}
        try:
            found = check_request(ask)
        except InputRefused as problem:
            assert "\n" not in str(problem) and len(str(problem)) < 200
            continue
        assert found["op"] == op and set(found) <= {"op", *OPERATION_FIELDS[op]}
        # all numbers are exact for a page
        for word in json.dumps(found).replace("[", " ").replace("]", " ").replace(",", " ").replace("}", " ").split():
            assert not word.lstrip("-").isdigit() or abs(int(word)) <= 2**53


@pytest.mark.parametrize(
    "ask", [{}, {"op": 1}, {"op": []}, {"op": "x" * 1000}, {"op": "describe"}, {"op": "save", "state": {}}]
)
def test_what_is_missing_is_named(ask: dict[str, Any], tmp_path: Path):
    found = answer_request(DirectReporter(lambda note: None), str(Path.cwd()), dict(BASE), ask)
    assert ("no such operation" in found["refused"] or "expected" in found["refused"]) and len(found["refused"]) < 200
