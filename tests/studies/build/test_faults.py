"""What breaks, as a part of its own: which faults can be built, and that they do in an FMU what they do in the twin."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.studies.build.conftest import FIG4, MASSAGE
from tests.studies.build.slaves import Kept, Slave
from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.run.trace import run_in_memory
from twin.studies.build.layout import layout_of, tables_source
from twin.studies.build.part import fixed_keys, open_parameters, part_of

TICKS = 600
WIRES = {
    "fault_1": {"count_l": "encoder.count_l"},
    "fault_2": {"count_m": "encoder.count_m", "count_l": "fault/1.count_l", "sample": "encoder.sample"},
    "fault_3": {"omega_ref": "controller.omega_ref"},
}
RUNAWAY = 'fault=[{kind="drive_runaway", target="drive_2", onset_s=0.4, magnitude_rad_per_s=8.0}]'


def broken(degrees: float = 2.0, share: float = 0.2, supply: float = 0.004) -> tuple[str, ...]:
    """An encoder that hiccups, messages that come late, a supply that sags: one behind the other."""
    return (
        f'fault=[{{kind="encoder_glitch", onset_s=0.1, duration_s=0.3, magnitude_deg={degrees}, share={share}}},'
        '{kind="sample_jitter", onset_s=0.2, magnitude_ms=6},'
        f'{{kind="brown_out", onset_s=0.1, magnitude_share={supply}}}]',
    )


@pytest.mark.parametrize("fault", list(WIRES))
def test_a_fault_in_an_fmu_is_the_twins_own_bit_for_bit(built: Callable[..., Path], fault: str) -> None:
    said = {
        "fault_1": {"fault_1.magnitude_deg": 3.0, "fault_1.share": 0.1},
        "fault_3": {"fault_3.magnitude_share": 0.003},
    }
    run = run_in_memory(replace(load_experiment(FIG4, broken(3.0, 0.1, 0.003)), duration_ticks=TICKS))
    signals = {port: run.held(name) for port, name in WIRES[fault].items()}
    slave = Slave(built(fault, "2.0", broken()), said.get(fault, {})).ready()
    kept = Kept(slave, slave.outputs(), TICKS + 1)
    for k in range(TICKS):
        slave.set({port: values[k] for port, values in signals.items()})
        slave.step(k)
        kept.keep(k + 1)
    for name in slave.outputs():
        own = run.held(name.replace("fault_", "fault/")).astype(float)
        assert np.ptp(own) > 0.0
        assert np.array_equal(kept[name][1:], own[:-1]), name
    slave.close()


def test_every_kind_of_fault_is_a_part_or_is_refused_in_words() -> None:
    faults = []
    for kind, known in FAULT_KINDS.items():
        magnitude = {f"magnitude_{known.unit}": known.magnitudes[0]} if known.magnitudes else {}
        faults.append({"kind": kind, "onset_s": 1.0} | magnitude | ({"share": 0.1} if known.has_share else {}))
    texts = (", ".join(f"{k} = {v!r}" for k, v in table.items()) for table in faults)
    experiment = load_experiment(MASSAGE, [f"fault=[{', '.join(f'{{{text}}}' for text in texts)}]"])
    for number, (kind, known) in enumerate(FAULT_KINDS.items(), start=1):
        name = f"fault_{number}"
        if known.mechanism in ("parameter", "body"):
            with pytest.raises(InputRefused, match=f"{name}: {kind} "):
                part_of(experiment, name)
            continue
        part = part_of(experiment, name)
        offered = open_parameters(part)
        # at the start all that is open is put where it was already
        for parameter in offered:
            (to,) = parameter.destinations
            assert parameter.unit.in_si(parameter.start[0]) / to.divisor * to.times == to.memory[0], parameter.key
        assert {f"{name}.kind", f"{name}.onset_s"} <= set(fixed_keys(part, offered))


def test_a_drive_that_fails_says_in_the_fmu_what_it_says_in_the_twin() -> None:
    part = part_of(
        load_experiment(MASSAGE, ['fault=[{kind="drive_failure", target="drive_3", onset_s=1.0}]']), "fault_1"
    )
    layout = layout_of(part, open_parameters(part))
    assert '"made drive_3 fail (drive_failure)"' in tables_source(layout, layout.variables)


def test_what_breaks_outside_a_part_leaves_it_as_it_is() -> None:
    sound, hit = (load_experiment(MASSAGE, settings) for settings in ([], [RUNAWAY]))
    for name in ("plant", "computer", "encoder"):
        one, other = part_of(sound, name), part_of(hit, name)
        assert [c.name for c in one.components] == [c.name for c in other.components]
        assert layout_of(one, open_parameters(one)).image == layout_of(other, open_parameters(other)).image
        assert {port: values.tolist() for port, (_, values) in one.starts.items()} == {
            port: values.tolist() for port, (_, values) in other.starts.items()
        }


def test_a_fault_of_the_surface_moves_the_body_of_the_plant() -> None:
    jump = load_experiment(MASSAGE, ['fault=[{kind="surface_jump", onset_s=1.0, magnitude_mm=1.0}]'])
    assert [c.name for c in part_of(jump, "plant").components] == ["body", "plant"]


def test_a_change_of_the_controller_leaves_the_plant_alone() -> None:
    changed = load_experiment(FIG4, ['change=[{t_s=1.0, key="controller.force.reference_N", value=4.0}]'])
    assert [c.name for c in part_of(changed, "plant").components] == ["scale", "plant"]


def test_the_bus_is_a_part_of_its_own_and_none_of_the_computer() -> None:
    late = load_experiment(MASSAGE, ["controller.bus_delay_ticks=2"])
    assert "bus" not in [c.name for c in part_of(late, "computer").components]
    starts = {name: values.tolist() for name, (_, values) in part_of(late, "bus").starts.items()}
    assert starts == {"omega_ref": [0.0, 0.0, 0.0], "power": [1.0]}
