import pytest
from pydantic import ValidationError

from twin.robot.experiment.mistakes import toml_keys
from twin.robot.monitor.limits import Monitor


def test_an_empty_table_is_complete():
    assert Monitor.model_validate({}).enabled


def test_every_limit_has_a_key_with_its_unit():
    assert all(key in ("enabled", "disobeyed") or "_" in key for key in toml_keys(Monitor))


@pytest.mark.parametrize("key", ["force_limit_N", "filter_Hz", "retract_deg", "follow_time_ms"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_what_is_no_limit_is_refused(key, value):
    with pytest.raises(ValidationError):
        Monitor.model_validate({key: value})
