"""Wires that names and units propose, of made-up parts."""

from twin.drive.mapping import Join, joins, objection
from twin.drive.variable import Variable, conversion


def variable(name: str, causality: str, unit: str, type: str = "Real") -> Variable:
    known = conversion(unit, []) if unit else None
    return Variable(name, causality, "", type, 0 if type == "Real" else -1, 0, 1, unit, known, 0.0, 0.0, 0.0)


def of(**ends: tuple[str, str]) -> dict[str, Variable]:
    """Variables by "part.name" from part__name = (causality, unit)."""
    return {n.replace("__", "."): variable(n.partition("__")[2], *end) for n, end in ends.items()}


MACHINE = of(machine__u=("input", "V"), machine__tau_load=("input", "N.m"), machine__n=("output", "rpm"))


def test_a_speed_controller_is_wired_to_its_machine_and_keeps_its_command():
    parts = MACHINE | of(
        servo__omega_ref=("input", "rad/s"), servo__n=("input", "rpm"), servo__u_out=("output", "V"),
    )  # fmt: skip
    # by name, although rpm is measured by two of its inputs; by unit
    assert joins(parts) == [Join("servo.u_out", "machine.u"), Join("machine.n", "servo.n")]


def test_nothing_is_sure_that_would_leave_the_robot_no_load_to_put_on():
    parts = of(
        machine__u=("input", "V"), machine__tau=("input", "N.m"), machine__w=("output", "rad/s"),
        gear__w_in=("input", "rad/s"), gear__tau_in=("output", "N.m"), gear__phi=("output", "rad"),
    )  # fmt: skip
    # the gear's own load is missing: the one torque that goes in would be wired away
    assert joins(parts) == [Join("gear.tau_in", "machine.tau", False), Join("machine.w", "gear.w_in", False)]
    whole = parts | of(gear__tau_load=("input", "N.m"))
    assert joins(whole) == [Join("gear.tau_in", "machine.tau"), Join("machine.w", "gear.w_in")]


def test_a_part_feeds_neither_itself_nor_what_measures_something_else():
    parts = of(a__x=("input", "V"), a__y=("output", "V"), b__z=("output", "A"), b__load=("input", "N.m"))
    assert joins(parts) == []
    assert objection(parts, "b.z", "a.x") == "units A and V do not measure the same"
    assert objection(parts, "a.x", "b.z") == "a.x has causality input and type Real"
    assert objection(parts, "a.q", "a.x") == "there is no a.q"
