import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.errors import InputRefused
from twin.kernel.fmi.variable import Variable, conversion
from twin.robot.drive.contract import (
    COMMAND_ROLES,
    LOAD_ROLE,
    OMEGA_M_ROLE,
    OPTIONAL_INPUT_ROLES,
    THETA_M_ROLE,
    drive_roles,
)
from twin.robot.drive.mapping import (
    WireProposal,
    Wiring,
    best_candidates,
    bindings,
    candidates,
    name_score,
    propose_wires,
    wire_error,
)


def variable(name: str, causality: str, unit: str, description: str = "", kind: int = 0) -> Variable:
    nan = math.nan
    return Variable(name, causality, description, "Real", kind, 0, 1, unit, conversion(unit, []), nan, nan, nan)


def drive(*variables: Variable) -> dict[str, Variable]:
    return {v.name: v for v in variables}


OWN = drive(
    variable("omega_ref", "input", "rad/s"),
    variable("tau_load", "input", "N.m"),
    variable("theta_m", "output", "rad"),
    variable("omega_m", "output", "rad/s"),
)
FOREIGN = drive(
    variable("n_cmd", "input", "rpm"),
    variable("M_load", "input", "mN.m"),
    variable("phi", "output", "deg"),
    variable("n", "output", "rpm"),
    variable("i_q", "output", "A"),
    variable("T_case", "output", "degC"),
)


def names(found) -> dict[str, str]:
    return {b.port.name: b.name for b in found}


def refusal(variables: dict[str, Variable], wiring: Wiring | None = None) -> str:
    with pytest.raises(InputRefused) as refused:
        bindings("acme.fmu", variables, wiring or Wiring())
    return str(refused.value)


def test_what_states_its_unit_goes_before_what_does_not_and_that_before_nothing():
    bare, stated = variable("omega_m", "output", ""), variable("shaft", "output", "rpm")
    assert candidates(drive(bare, stated), OMEGA_M_ROLE) == ["shaft"]
    assert candidates(drive(bare), OMEGA_M_ROLE) == ["omega_m"]


@pytest.mark.parametrize("command", COMMAND_ROLES)
def test_no_drive_goes_without_command_load_and_shaft_or_where_the_shaft_is_ours_without_torque(command):
    goal = "omega_ref" if command == "velocity" else "command"
    for rotor, needed in ((False, {goal, "tau_load", "theta_m", "omega_m"}), (True, {goal, "tau_motor"})):
        assert {role.port.name for role in drive_roles(command, rotor) if role.required} == needed


@pytest.mark.parametrize("command", COMMAND_ROLES)
def test_gear_and_sign_turn_angles_speeds_and_torques_and_nothing_else(command):
    for role in (*drive_roles(command), *drive_roles(command, rotor=True)):
        assert role.port.size == 1
        assert role.mechanical == {"rad": 1, "rad/s": 1, "N m": -1}.get(role.port.unit, 0), role.port.name


def test_a_switch_is_taken_for_what_may_be_left_out_only():
    switch = replace(variable("on", "input", ""), type="Boolean")
    assert candidates(drive(switch), OPTIONAL_INPUT_ROLES[0]) == ["on"]
    assert candidates(drive(switch), LOAD_ROLE) == []


def test_an_angle_in_no_unit_is_proposed_where_it_is_measured_and_not_where_it_is_commanded():
    assert best_candidates(drive(variable("goal", "input", "1")), COMMAND_ROLES["position"], set()) == []
    assert best_candidates(drive(variable("goal", "input", "rad")), COMMAND_ROLES["position"], set()) == ["goal"]
    assert best_candidates(drive(variable("theta", "output", "1")), THETA_M_ROLE, set()) == ["theta"]


def test_a_name_fits_best_that_is_a_synonym_then_one_with_it_inside_then_one_described_by_it():
    said = [("load", ""), ("load_at_shaft", ""), ("M", "load on the shaft"), ("M", "")]
    fits = [name_score(name, variable(name, "input", "N.m", text), LOAD_ROLE) for name, text in said]
    assert fits == sorted(set(fits), reverse=True) and fits[-1] == 0


def test_a_drive_that_speaks_the_contract_is_taken_as_it_is():
    assert all(b.gain == 1.0 and b.offset == 0.0 for b in bindings("own.fmu", OWN, Wiring()))


def test_a_foreign_drive_is_mapped_by_unit_and_causality():
    found = bindings("acme.fmu", FOREIGN, Wiring())
    assert names(found) == {
        "omega_ref": "n_cmd", "tau_load": "M_load", "theta_m": "phi", "omega_m": "n", "current": "i_q",
    }  # fmt: skip
    gains = {b.port.name: b.gain for b in found}
    assert gains["omega_ref"] == pytest.approx(2 * math.pi / 60)
    assert gains["tau_load"] == pytest.approx(1e-3)
    assert gains["theta_m"] == pytest.approx(math.pi / 180)


def test_what_the_user_says_goes_before_what_we_would_propose():
    both = FOREIGN | drive(variable("phi_encoder", "output", "deg"))
    found = bindings("acme.fmu", both, Wiring(outputs={"theta_m": "phi_encoder"}))
    assert names(found)["theta_m"] == "phi_encoder"


def test_two_candidates_that_nothing_tells_apart_are_an_error_with_the_toml_to_paste():
    two = FOREIGN | drive(variable("M_ext", "input", "mN.m"))
    del two["M_load"]
    two |= drive(variable("M_1", "input", "mN.m"), variable("M_2", "input", "mN.m"))
    del two["M_ext"]
    said = refusal(two)
    assert "undecided which of its variables is tau_load" in said
    assert '[drive.inputs]\nomega_ref = "n_cmd"\ntau_load = "M_1"   # or: M_2' in said
    assert '[drive.outputs]\ntheta_m = "phi"\nomega_m = "n"' in said


def test_a_drive_commanded_with_a_voltage_is_told_to_need_a_loop():
    motor = {name: v for name, v in FOREIGN.items() if name != "n_cmd"} | drive(variable("u", "input", "V"))
    said = refusal(motor)
    assert 'command = "voltage"' in said
    assert 'command = "u"' in said
    assert "[drive.velocity_loop]" in said
    found = bindings("acme.fmu", motor, Wiring(command="voltage"))
    assert names(found)["command"] == "u"


@pytest.mark.parametrize(
    ("wiring", "said"),
    [
        (Wiring(inputs={"omega_ref": "n_set"}), "has no variable 'n_set' for omega_ref"),
        (Wiring(inputs={"omega_ref": "n"}), "'n' has causality output; omega_ref needs input"),
        (Wiring(outputs={"theta_m": "angle"}), "its outputs are phi, n, i_q, T_case"),
        (Wiring(outputs={"theta_m": "n"}), "output 'n' has unit 'rpm'; theta_m needs one like rad"),
        (Wiring(outputs={"theta_m": "T_case"}), "has unit 'degC'; theta_m needs one like rad"),
        (Wiring(inputs={"speed": "n_cmd"}), "[drive.inputs] has no role 'speed'"),
        (Wiring(command="torque", inputs={"omega_ref": "n_cmd"}), "no role 'omega_ref' for command = \"torque\""),
    ],
)
def test_a_wrong_mapping_is_refused_with_what_was_expected(wiring: Wiring, said: str):
    assert said in refusal(FOREIGN, wiring)


def test_a_contract_name_of_another_dimension_is_not_taken_for_the_role():
    wrong = OWN | drive(variable("omega_ref", "input", "V"))
    assert "undecided which of its variables is omega_ref" in refusal(wrong)


def test_a_local_variable_can_be_mapped_to_an_output():
    local = {n: v for n, v in OWN.items() if n != "theta_m"} | drive(variable("phi", "local", "rad"))
    assert "theta_m" in refusal(local)
    assert names(bindings("acme.fmu", local, Wiring(outputs={"theta_m": "phi"})))["theta_m"] == "phi"


def test_a_variable_without_unit_is_taken_by_its_name_only():
    bare = drive(*(variable(v.name, v.causality, "") for v in OWN.values()))
    assert names(bindings("own.fmu", bare, Wiring())) == {name: name for name in OWN}
    assert "undecided which" in refusal(drive(*(variable("x_" + v.name, v.causality, "") for v in OWN.values())))


@given(
    sign=st.sampled_from([1, -1]),
    ratio=st.floats(0.01, 200.0),
    speed=st.floats(-10.0, 10.0),
    torque=st.floats(-1.0, 1.0),
)
def test_sign_and_gear_ratio_conserve_power(sign, ratio: float, speed: float, torque: float):
    found = {b.port.name: b for b in bindings("own.fmu", OWN, Wiring(sign=sign, gear_ratio=ratio))}
    # contract = gain * FMU, so the FMU sees contract / gain
    in_fmu = (speed / found["omega_m"].gain) * (torque / found["tau_load"].gain)
    assert in_fmu == pytest.approx(speed * torque, rel=1e-12, abs=1e-15)
    # the FMU's shaft turns `ratio` times as fast, in the direction of `sign`
    assert speed / found["omega_ref"].gain == pytest.approx(sign * ratio * speed, rel=1e-12)


def test_a_variable_that_alone_counts_the_other_way_is_named_with_a_minus():
    wiring = Wiring(inputs={"tau_load": "-tau_load"})
    gains = {b.port.name: b.gain for b in bindings("own.fmu", OWN, wiring)}
    assert gains == {"omega_ref": 1.0, "tau_load": -1.0, "theta_m": 1.0, "omega_m": 1.0}
    assert "has no variable 'M'" in refusal(FOREIGN, Wiring(inputs={"tau_load": "-M"}))


def test_of_two_that_nothing_else_tells_apart_the_one_described_as_the_load_is_it():
    two = {n: v for n, v in FOREIGN.items() if n != "M_load"} | drive(
        variable("M_1", "input", "mN.m", "of the brake"), variable("M_2", "input", "mN.m", "Load on the shaft")
    )
    assert names(bindings("acme.fmu", two, Wiring()))["tau_load"] == "M_2"


def test_a_word_of_three_letters_in_a_description_says_nothing():
    # `ref` and `cmd` stand in every other sentence
    two = {n: v for n, v in FOREIGN.items() if n != "n_cmd"} | drive(
        variable("x_1", "input", "rpm", "refers to the shaft"), variable("x_2", "input", "rpm")
    )
    assert "undecided which of its variables is omega_ref" in refusal(two)


def test_one_variable_plays_one_role():
    both = FOREIGN | drive(variable("shaft", "output", ""))
    with pytest.raises(InputRefused, match="'shaft' is given to theta_m and omega_m; one variable plays one role"):
        bindings("acme.fmu", both, Wiring(outputs={"theta_m": "shaft", "omega_m": "shaft"}))


def test_a_variable_that_counts_the_other_way_is_told_with_its_minus():
    found = bindings("acme.fmu", FOREIGN, Wiring(inputs={"tau_load": "-M_load"}))
    assert [str(b) for b in found if b.turned] == ["tau_load <- -M_load [mN.m]"]


def test_a_drive_without_inputs_is_told_to_have_none():
    bare = {name: v for name, v in FOREIGN.items() if v.causality == "output"}
    with pytest.raises(InputRefused, match="has no variable 'n_cmd' for omega_ref; it has no input"):
        bindings("acme.fmu", bare, Wiring(inputs={"omega_ref": "n_cmd"}))


def part_variable(name: str, causality: str, unit: str, type: str = "Real") -> Variable:
    known = conversion(unit, []) if unit else None
    return Variable(name, causality, "", type, 0 if type == "Real" else -1, 0, 1, unit, known, 0.0, 0.0, 0.0)


def of(**ends: tuple[str, str]) -> dict[str, Variable]:
    """Variables by "part.name" from part__name = (causality, unit)."""
    return {n.replace("__", "."): part_variable(n.partition("__")[2], *end) for n, end in ends.items()}


MACHINE = of(machine__u=("input", "V"), machine__tau_load=("input", "N.m"), machine__n=("output", "rpm"))


def test_a_speed_controller_is_wired_to_its_machine_and_keeps_its_command():
    parts = MACHINE | of(
        servo__omega_ref=("input", "rad/s"), servo__n=("input", "rpm"), servo__u_out=("output", "V"),
    )  # fmt: skip
    # by name, although rpm is measured by two of its inputs; by unit
    assert propose_wires(parts) == [WireProposal("servo.u_out", "machine.u"), WireProposal("machine.n", "servo.n")]


def test_nothing_is_sure_that_would_leave_the_robot_no_load_to_put_on():
    parts = of(
        machine__u=("input", "V"), machine__tau=("input", "N.m"), machine__w=("output", "rad/s"),
        gear__w_in=("input", "rad/s"), gear__tau_in=("output", "N.m"), gear__phi=("output", "rad"),
    )  # fmt: skip
    # the gear's own load is missing: the one torque that goes in would be wired away
    assert propose_wires(parts) == [
        WireProposal("gear.tau_in", "machine.tau", False),
        WireProposal("machine.w", "gear.w_in", False),
    ]
    whole = parts | of(gear__tau_load=("input", "N.m"))
    assert propose_wires(whole) == [WireProposal("gear.tau_in", "machine.tau"), WireProposal("machine.w", "gear.w_in")]


def test_an_input_that_two_outputs_measure_is_sure_of_neither():
    parts = of(
        machine__u=("input", "V"), machine__tau=("input", "N.m"), machine__n=("output", "rpm"),
        gear__n_in=("input", "rpm"), wheel__n_out=("output", "rpm"), gear__tau_load=("input", "N.m"),
    )  # fmt: skip
    found = [join for join in propose_wires(parts) if join.target == "gear.n_in"]
    assert found == [WireProposal("machine.n", "gear.n_in", False), WireProposal("wheel.n_out", "gear.n_in", False)]


def test_a_part_feeds_neither_itself_nor_what_measures_something_else():
    parts = of(a__x=("input", "V"), a__y=("output", "V"), b__z=("output", "A"), b__load=("input", "N.m"))
    assert propose_wires(parts) == []
    assert wire_error(parts, "b.z", "a.x") == "units A and V have different dimensions"
    assert wire_error(parts, "a.x", "b.z") == "a.x has causality input and type Real"
    assert wire_error(parts, "a.q", "a.x") == "a.q does not exist"
