"""SSP archives in the roles of a controller and of a drive: same bits as one part, same refusals as one FMU."""

import json
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples.three_copies import write_archive
from tests.kernel.systems.archives import archive, component, connection, connector, line, structure, system, values
from tests.kernel.systems.linear import Linear
from tests.laws.runs import EXPERIMENTS, FORCE, shipped
from twin.kernel.archive import sha256
from twin.kernel.cosim.delay import play, values_by_port
from twin.kernel.cosim.port import port_slices, width
from twin.kernel.cosim.selection import Selection
from twin.kernel.cosim.subsystem import Subsystem
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.process.states import stored_state
from twin.kernel.recording.reader import read
from twin.robot.assembly.drives import plan_drive
from twin.robot.assembly.load import load_experiment
from twin.robot.assembly.roles import ROLE_CONTRACTS, SampledFmu, sampled_fmu
from twin.robot.experiment.drive_files import load_drive
from twin.robot.run.run import execute

AXES = "123"
KP, KI, H = 5.0, 5.0, 2e-3
STEP = '<ssd:Annotations><ssc:Annotation type="a"><x stepSize="{}"/></ssc:Annotation></ssd:Annotations>'


@pytest.fixture(autouse=True)
def _compiled_once(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """What `Linear` compiles beside an FMU is the same in every test."""
    known = tmp_path_factory.getbasetemp() / "linear_of_ssp_parts.so"
    if not known.exists():
        Linear().fmu(known.with_name("any.fmu"))
        known.with_name("linear.so").rename(known)
    (tmp_path / "linear.so").write_bytes(known.read_bytes())


def siso(file: Path) -> Path:
    """x' = u, y = KI x + KP u; its second input stays 0."""
    return Linear(a=[[0.0]], b=[[1.0]], c=[[KI]], d=[[KP]]).fmu(file)


def three(folder: Path, targets: Sequence[float]) -> Path:
    """A controller of three PIs, each of which holds the torque of its joint."""
    file = folder / "three.ssp"
    write_archive(siso(folder / "pi.fmu"), "u", "y", file, [float(target) for target in targets])
    return file


def servo(folder: Path, units: Sequence[str] = ("rad/s", "N.m", "rad", "rad/s")) -> Path:
    """A drive of a PI and a motor: J w' = tau - b w - load."""
    J, b = 1e-4, 1e-3
    loop = Linear(a=[[0.0]], b=[[1.0, -1.0]], c=[[1.0]], d=[[0.02, -0.02]]).fmu(folder / "pi.fmu")
    motor = Linear(
        a=[[0.0, 1.0], [0.0, -b / J]], b=[[0.0, 0.0], [1 / J, -1 / J]], c=[[1.0, 0.0], [0.0, 1.0]]
    ).fmu(folder / "motor.fmu")  # fmt: skip
    wires = [("omega_ref", "pi.u"), ("motor.v", "pi.w"), ("pi.y", "motor.u"), ("load", "motor.w")]
    wires += [("motor.y", "phi"), ("motor.v", "n")]
    kinds = ("input", "input", "output", "output")
    ends = [connector(*one) for one in zip(("omega_ref", "load", "phi", "n"), kinds, units, strict=True)]
    parts = [component("pi", "pi.fmu"), component("motor", "motor.fmu")]
    ssd = structure(system(parts, [connection(*wire) for wire in wires], ends))
    return archive(folder / "servo.ssp", ssd, {"pi.fmu": loop, "motor.fmu": motor})


MAPPED = [
    f"controller.{side}s.{port}={json.dumps([f'{name}_{n}' for n in AXES])}"
    for side, port, name in (("input", "tau_l", "tau"), ("output", "omega_ref", "omega"))
]


def planned_part(file: Path, inputs: Any, outputs: Any, parameters: Any = None, role: str = "controller") -> SampledFmu:
    contract = ROLE_CONTRACTS[role]
    named = (inputs, outputs)
    return sampled_fmu(
        file, role, (contract.inputs, contract.outputs), contract.required, named, parameters or {}, None
    )


ONE = ({"F_ee_B[2]": "u"}, {"omega_ref[0]": "y"})


PI = component("pi", "pi.fmu")
WIRES = connection("u", "pi.u"), connection("pi.y", "y")
ENDS = connector("u", "input"), connector("y", "output")


def one(folder: Path, ssd: str = "") -> Path:
    """An archive around one PI, behind the connectors u and y."""
    return archive(folder / "one.ssp", ssd or structure(system([PI], WIRES, ENDS)), {"pi.fmu": siso(folder / "pi.fmu")})


def called(plan: SampledFmu, forces: Sequence[float], tick: float = 1e-3, period: int = 2) -> np.ndarray:
    """omega_ref[0] for these values of F_ee_B[2]."""
    part = plan.part("controller", tick, period, 10)
    try:
        u = np.zeros((len(forces), width(part.inputs)))
        u[:, port_slices(part.inputs)["F_ee_B"].start + 2] = forces
        h = period * tick
        rows, status = play(part, h * np.arange(float(len(forces))), np.full(len(forces), h), u)
        assert status == 0
        return values_by_port(part.outputs, rows)["omega_ref"][:, 0]
    finally:
        part.close()


class TorqueLaw:
    """The law of `three` as one part."""

    inputs = ("tau_l",)
    outputs = ("omega_ref",)
    targets: np.ndarray

    def __init__(self) -> None:
        self.x = np.zeros(3)

    def step(self, t: float, inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        u = -(inputs["tau_l"] - self.targets)
        self.x = self.x + H * u
        return {"omega_ref": KI * self.x + KP * u}


def test_three_copies_of_one_pi_by_wiring_hold_the_force_of_twins_own_law(tmp_path: Path):
    own = read(execute(shipped(FORCE, "duration_s=9"), tmp_path / "own").recording)
    targets = own["estimator.tau_l"][-1]
    file = three(tmp_path, targets)
    run = execute(shipped(FORCE, "duration_s=9", f"controller.fmu={file}", *MAPPED), tmp_path / "run")
    wired = read(run.recording)
    pressed = -wired["plant.F_ee_B"][-1000:, 2]
    # the joint torques of a press with 5 N; encoders of 4096 counts see 0.06 N, and belief and truth are 0.1 N apart
    np.testing.assert_allclose(pressed, -own["plant.F_ee_B"][-1, 2], atol=0.06)
    np.testing.assert_allclose(pressed, 5.0, atol=0.2)
    # the same law as one part: the same bits
    TorqueLaw.targets = targets
    alone = read(
        execute(shipped(FORCE, "duration_s=9"), tmp_path / "alone", substitutes={"controller": TorqueLaw}).recording
    )
    for signal in ("controller.omega_ref", "plant.F_ee_B", "plant.p_B"):
        np.testing.assert_array_equal(wired[signal], alone[signal])
    facts = json.loads(wired.metadata["fmu"]["controller"])
    assert facts["sha256"][:12] in run.parts["controller"] and facts["fmi"] == "SSP 1.0"
    digests = {part["sha256"] for part in facts["components"].values()}
    assert set(facts["components"]) == {"pi_1", "pi_2", "pi_3"} and digests == {sha256(tmp_path / "pi.fmu")}
    assert facts["not_fed"] == ["pi_1.w", "pi_2.w", "pi_3.w"]


def test_a_drive_of_two_fmus_in_an_archive_gives_the_bits_of_the_same_two_as_parts(tmp_path: Path):
    file = servo(tmp_path)
    (tmp_path / "mapping.toml").write_text("""
inputs = {omega_ref = "pi.u", tau_load = "motor.w"}
outputs = {theta_m = "motor.y", omega_m = "motor.v"}
[parts.pi]
fmu = "pi.fmu"
[parts.motor]
fmu = "motor.fmu"
[wires]
"pi.w" = "motor.v"
"motor.u" = "pi.y"
""")
    force, more = EXPERIMENTS / f"{FORCE}.toml", ["duration_s=7", "recording.states_s=[6.0]"]
    archived = execute(load_experiment(force, more, str(file)), tmp_path / "ssp")
    parts = read(execute(load_experiment(force, more, str(tmp_path / "mapping.toml")), tmp_path / "parts").recording)
    recording = read(archived.recording)
    assert np.min(parts["plant.F_ee_B"][:, 2]) < -1.0
    for signal in ("plant.F_ee_B", "drive/1.theta_m", "drive/3.omega_m"):
        np.testing.assert_array_equal(recording[signal], parts[signal])
    fmus = {name: json.loads(text) for name, text in recording.metadata["fmu"].items()}
    assert fmus["drive_2"]["sha256"] == sha256(file) and fmus["drive_2.motor"]["sha256"] == sha256(
        tmp_path / "motor.fmu"
    )
    # goes on from a state, in which each FMU has its own
    state = stored_state(archived.recording, 6.0)
    assert state is not None
    on = execute(load_experiment(force, more, str(file)), tmp_path / "on", state=state)
    np.testing.assert_array_equal(read(on.recording)["plant.F_ee_B"], recording["plant.F_ee_B"][6000:])


@pytest.mark.parametrize(
    ("unit", "inside", "expected"),
    [("N", "", 1.0), ("mN", "", 1e3), ("", line(2.0, 1.0), 2.0), ("mN", line(-1.0), -1e3)],
)
def test_units_and_lines_of_the_archive_are_on_the_way(tmp_path: Path, unit: str, inside: str, expected: float):
    units = '<ssc:Unit name="mN"><ssc:BaseUnit kg="1" m="1" s="-2" factor="0.001"/></ssc:Unit>'
    units += '<ssc:Unit name="N"><ssc:BaseUnit kg="1" m="1" s="-2"/></ssc:Unit>'
    wires = [connection("u", "pi.u", inside), connection("pi.y", "y", line(4.0, 0.5))]
    ends = [connector("u", "input", unit), connector("y", "output")]
    ssd = structure(system([PI], wires, ends), units=units)
    y = called(planned_part(one(tmp_path, ssd), *ONE), [0.0, 3.0])
    u = np.array([0.0, 3.0]) * expected + (1.0 if "1.0" in inside and expected == 2.0 else 0.0)
    x = np.cumsum(H * u)
    np.testing.assert_allclose(y, 4.0 * (KI * x + KP * u) + 0.5, rtol=1e-14)


def test_a_connector_feeds_all_that_it_leads_to_and_a_value_in_the_table_stands_for_a_wire(tmp_path: Path):
    wires = [connection("u", "a.u"), connection("u", "b.u"), connection("w", "a.w"), connection("a.y", "b.w")]
    ends = [connector("u", "input"), connector("w", "input"), connector("y", "output")]
    ssd = structure(system([component("a", "x.fmu"), component("b", "x.fmu")], [*wires, connection("b.y", "y")], ends))
    fmu = Linear(d=[[1.0, 10.0]]).fmu(tmp_path / "x.fmu")
    file = archive(tmp_path / "two.ssp", ssd, {"x.fmu": fmu})
    plan = planned_part(file, *ONE, {"w": 7.0})
    # b: u + 10 (u + 10 w)
    np.testing.assert_array_equal(called(plan, [3.0]), [3.0 + 10.0 * (3.0 + 70.0)])
    with pytest.raises(InputRefused, match="nothing feeds its input w; map it in"):
        planned_part(file, *ONE)


def test_what_is_inside_can_be_mapped_by_its_name_if_nothing_feeds_it(tmp_path: Path):
    file = one(tmp_path)
    plan = planned_part(file, {"F_ee_B[2]": "u", "F_ee_B[0]": "pi.w"}, {"omega_ref[0]": "pi.y"})
    assert called(plan, [1.0])[0] == KI * H + KP
    bare = archive(tmp_path / "bare.ssp", structure(system([PI])), {"pi.fmu": tmp_path / "pi.fmu"})
    with pytest.raises(InputRefused, match=r"nothing feeds its input pi\.w"):
        planned_part(bare, {"F_ee_B[2]": "pi.u"}, {"omega_ref[0]": "-pi.y"})
    plan = planned_part(bare, {"F_ee_B[2]": "pi.u"}, {"omega_ref[0]": "-pi.y"}, {"pi.w": 0.0})
    assert called(plan, [1.0])[0] == -(KI * H + KP)


@pytest.mark.parametrize(("annotated", "steps"), [("", 6), ("0.001", 12), ("0.004", 3)])
def test_a_component_steps_as_it_is_annotated_else_once_a_call(tmp_path: Path, annotated: str, steps: int):
    noted = STEP.format(annotated) if annotated else ""
    whole = system([PI.replace("</ssd:Component>", f"{noted}</ssd:Component>")], WIRES, ENDS)
    part = planned_part(one(tmp_path, structure(whole)), *ONE).part("controller", 1e-3, 2, 20)
    try:
        assert isinstance(part, Selection) and isinstance(part.inner, Subsystem)
        (inside,) = (c for c in part.inner.system.components if isinstance(c, FmuComponent))
        u = np.zeros((6, width(part.inputs)))
        play(part, H * np.arange(6.0), np.full(6, H), u)
        variable = inside.instance.description.variables["steps"]
        assert inside.instance.read_floats([variable])[0] == steps
    finally:
        part.close()


@pytest.mark.parametrize(
    ("ssd", "inputs", "outputs", "said"),
    [
        ("", {"F_ee_B[2]": "v"}, ONE[1], "has no variable 'v' for F_ee_B[3]; its inputs are u"),
        ("", ONE[0], {}, "which of its outputs is omega_ref"),
        ("", {}, ONE[1], "nothing feeds its input u; map it in [controller.inputs]"),
        (
            structure(system([PI], WIRES[1:], ENDS)),
            *ONE,
            "one.ssp: its connector 'u' leads to no component; connect it in the archive",
        ),
        (
            structure(system([PI], [connection("u", "pi.x9"), WIRES[1]], ENDS)),
            *ONE,
            "connector 'u' leads to pi.x9, which is no such variable; expected a number that is input",
        ),
        (
            structure(system([PI], WIRES, [connector("u", "input", "rad/s"), ENDS[1]])),
            *ONE,
            "input 'u' has unit 'rad/s'; F_ee_B[3] needs one like N",
        ),
        (
            structure(system([component("pi", "other.fmu")])),
            *ONE,
            "its resource 'other.fmu' is not a file of this archive",
        ),
        ("", {"F_ee_B[2]": "u", "F_ee_B[1]": "pi.u"}, ONE[1], "one.ssp: pi.u: pi.u is fed already, by "),
    ],
)  # fmt: skip
def test_what_cannot_be_right_is_refused_before_a_binary_is_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ssd: str, inputs: Any, outputs: Any, said: str
):
    file = one(tmp_path, ssd)

    def loaded(*_: object, **__: object) -> None:
        raise AssertionError("a binary is loaded")

    monkeypatch.setattr("twin.kernel.fmi.instance.Instance.__init__", loaded)
    with pytest.raises(InputRefused, match=re.escape(said)) as refused:
        planned_part(file, inputs, outputs)
    assert str(tmp_path) in str(refused.value) or "one.ssp" in str(refused.value)
    assert f"{tempfile.gettempdir()}/tmp" not in str(refused.value).replace(str(tmp_path), "")


def test_an_archive_that_is_none_another_one_and_settings_that_are_of_one_fmu_are_refused(tmp_path: Path):
    broken = tmp_path / "broken.ssp"
    broken.write_bytes(b"PK")
    with pytest.raises(InputRefused, match="not a complete SSP"):
        planned_part(broken, *ONE)
    file = one(tmp_path)
    with pytest.raises(InputRefused, match=r"\[controller.parameters\] pi.k: one.ssp: pi has no variable 'k'"):
        planned_part(file, *ONE, {"pi.k": 1.0})
    with pytest.raises(InputRefused, match="tolerance: each FMU of an SSP has its own"):
        execute(shipped(FORCE, f"controller.fmu={file}", "controller.tolerance=1e-6"), tmp_path / "run")
    with pytest.raises(InputRefused, match="the experiment pins 00"):
        execute(
            shipped(FORCE, f"controller.fmu={three(tmp_path, (0, 0, 0))}", f"controller.sha256={'0' * 64}", *MAPPED),
            tmp_path / "run",
        )
    drive = load_drive(str(servo(tmp_path)), tmp_path)
    with pytest.raises(InputRefused, match=r"\[drive\] solver: each FMU of an SSP has its own"):
        plan_drive(drive.model_copy(update={"solver": "rk4"}))
    (tmp_path / "other").mkdir()
    with pytest.raises(InputRefused, match="undecided which of its variables is theta_m"):
        plan_drive(load_drive(str(servo(tmp_path / "other", ("rad/s", "N.m", "V", "V"))), tmp_path))


def test_a_step_that_is_no_whole_number_of_ticks_is_refused(tmp_path: Path):
    whole = system([PI], WIRES, ENDS)
    plan = planned_part(one(tmp_path, structure(whole, notes=STEP.format(0.0003))), *ONE)
    with pytest.raises(
        InputRefused, match=r"the step of pi, 0.3 ms, is not a whole number of steps of 1 ms; the annot"
    ):
        plan.part("controller", 1e-3, 2, 10)


def test_values_of_the_archive_and_of_the_table_get_to_parameters(tmp_path: Path):
    whole = system([PI], WIRES, ENDS, values("pi.w=2"))
    file = one(tmp_path, structure(whole))
    plan = planned_part(file, *ONE)
    assert [(v.name, value) for v, value in plan.description.values["pi"]] == [("w", 2.0)]  # type: ignore[union-attr]
    plan = planned_part(file, *ONE, {"pi.w": 3.0})
    assert [(v.name, value) for v, value in plan.description.values["pi"]] == [("w", 3.0)]  # type: ignore[union-attr]
