"""Third-party parts in the robot: ports, wires, recordings, and who refuses them."""

import hashlib
import re
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from examples.my_controller import Controller
from tests.kernel.fmi.archives import altered
from tests.laws.runs import FORCE, shipped
from tests.robot.assembly.own_parts import PARTS
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.delay import play
from twin.kernel.cosim.observers import simulate
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.python_class import PythonComponent
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.recording.reader import read
from twin.robot.assembly.assemble import COMPONENT_ROWS, assemble
from twin.robot.assembly.load import load_experiment, recorded_experiment
from twin.robot.assembly.roles import ROLE_CONTRACTS, SampledFmu, sampled_fmu, third_party_part
from twin.robot.experiment.experiment import Experiment
from twin.robot.monitor.component import trip_reason
from twin.robot.run.run import execute
from twin.robot.run.trace import run_in_memory
from twin.studies.accuracy.budget import accuracy_budget
from twin.studies.analyse.stability import stability
from twin.studies.converge.convergence import convergence
from twin.studies.faults.onsets import checked_healthy_run
from twin.studies.replay.model import model_for
from twin.studies.tune.prediction import Goals
from twin.studies.tune.tuned import tune_gains

WAY = {"p_ref_B": ("way_1", "way_2", "way_3")}
ARRAYS = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="3.0" modelName="arrays" instantiationToken="x">
<CoSimulation modelIdentifier="torque_motor_fmi3"/>
<UnitDefinitions>
<Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>
<Unit name="rad/s"><BaseUnit rad="1" s="-1"/></Unit>
</UnitDefinitions>
<ModelVariables>
<Float64 name="p_B" valueReference="1" causality="input" start="0 0 0" unit="mm"><Dimension start="3"/></Float64>
<Float64 name="jacobi" valueReference="2" causality="input" start="0 0 0 0 0 0 0 0 0"><Dimension start="3"/>
<Dimension start="3"/></Float64>
<Float64 name="n" valueReference="3" causality="output" unit="rad/s"><Dimension start="3"/></Float64>
<Boolean name="triggered" valueReference="4" causality="output"/>
</ModelVariables>
<ModelStructure><Output valueReference="3"/><Output valueReference="4"/></ModelStructure>
</fmiModelDescription>"""


@pytest.fixture
def law(root: Path) -> Path:
    return root / "fmus" / "parts" / "paper_law" / "paper_law.fmu"


def planned(file: Path, inputs: Any = WAY, outputs: Any = None, **parameters: float) -> SampledFmu:
    contract = ROLE_CONTRACTS["controller"]
    ports, said = (contract.inputs, contract.outputs), (inputs, outputs or {})
    return sampled_fmu(file, "controller", ports, contract.required, said, parameters, None)


def with_description(law: Path, target: Path, old: str, new: str) -> Path:
    def edit(name: str, content: bytes) -> tuple[str, bytes]:
        if name == "modelDescription.xml":
            assert old.encode() in content
            content = content.replace(old.encode(), new.encode())
        return name, content

    return altered(law, target, edit)


def test_ports_of_several_values_are_found_by_the_names_that_tools_give_them(law: Path):
    plan = planned(law)
    assert [port.name for port in plan.inputs] == [port.name for port in ROLE_CONTRACTS["controller"].inputs]
    assert {b.role.port.name: b.name for b in plan.bindings if b.name.startswith("J")} == {
        f"J[{n}]": f"J_{n}" for n in range(1, 10)
    }


@pytest.mark.parametrize("spelled", ["p_B[{}]", "p_B({})", "p_B{}"])
def test_other_ways_to_flatten_an_array_are_known(law: Path, tmp_path: Path, spelled: str):
    file = law
    for n in (1, 2, 3):
        file = with_description(file, tmp_path / f"{n}.fmu", f'"p_B_{n}"', f'"{spelled.format(n)}"')
    assert planned(file).inputs == planned(law).inputs


@pytest.mark.parametrize("spelled", ["J[{},{}]", "J({},{})", "J_{}{}"])
def test_a_matrix_may_be_flattened_with_row_and_column(law: Path, tmp_path: Path, spelled: str):
    file = law
    for n in range(9):
        file = with_description(
            file, tmp_path / f"{n}.fmu", f'"J_{n + 1}"', f'"{spelled.format(n // 3 + 1, n % 3 + 1)}"'
        )
    assert planned(file).inputs == planned(law).inputs


def test_arrays_of_fmi_3_are_ports_as_a_whole_and_units_become_si(root: Path, tmp_path: Path):
    good = root / "fmus" / "torque_motor_fmi3" / "torque_motor_fmi3.fmu"
    file = altered(
        good, tmp_path / "arrays.fmu", lambda n, c: (n, ARRAYS.encode() if n == "modelDescription.xml" else c)
    )
    plan = planned(file, {"J": "jacobi"}, {"omega_ref": "n"})
    assert [(p.name, p.size) for p in plan.inputs] == [("p_B", 3), ("J", 9)]
    assert [(p.name, p.size) for p in plan.outputs] == [("omega_ref", 3), ("triggered", 1)]
    assert plan.bindings[0].gain == pytest.approx(1e-3)
    with pytest.raises(InputRefused, match=r"p_B has 3 values, and \"jacobi\" 9; give one for each"):
        planned(file, {"p_B": "jacobi"}, {"omega_ref": "n"})


def test_a_list_of_one_variable_says_what_the_variable_says(law: Path):
    assert planned(law, outputs={"dp_z": ("dp_z",)}).bindings == planned(law, outputs={"dp_z": "dp_z"}).bindings


def test_an_input_that_has_been_given_a_value_keeps_it_and_is_fed_by_nobody(law: Path):
    plan = planned(law, way_1=0.0, way_2=0.01, way_3=-0.1)
    assert "p_ref_B" not in [port.name for port in plan.inputs]
    component = plan.part("controller", 1e-3, 2, 10)
    try:
        rows, status = play(component, np.zeros(1), np.full(1, 2e-3), np.zeros((1, 18)))
        assert status == 0
        assert rows[0, 3:6].tolist() == [0.0, 0.01, -0.1]
    finally:
        component.close()


def test_inputs_of_a_sampled_part_are_held_where_they_could_rise_over_a_step(law: Path, tmp_path: Path):
    able = with_description(law, tmp_path / "law.fmu", "<CoSimulation ", '<CoSimulation canInterpolateInputs="true" ')
    smooth = with_description(able, tmp_path / "smooth.fmu", ' variability="discrete"', "")
    component = planned(smooth).part("controller", 1e-3, 2, 10)
    assert isinstance(component, FmuComponent)
    try:
        inputs = component.instance.description.variables_of("input")
        assert inputs and not any(map(component.instance.takes_ramp, inputs))
    finally:
        component.close()


def test_a_single_value_may_count_the_other_way(law: Path):
    plain, turned = planned(law), planned(law, outputs={"omega_ref": ("-omega_ref_1", "omega_ref_2", "omega_ref_3")})
    gains = [next(b.gain for b in plan.bindings if b.name == "omega_ref_1") for plan in (plain, turned)]
    assert gains == [1.0, -1.0]


@pytest.mark.parametrize(
    ("inputs", "outputs", "said"),
    [
        ({}, {}, "nothing feeds its inputs way_1, way_2, way_3; map it in [controller.inputs]"),
        ({"p": "way_1"}, {}, "[controller.inputs] no input 'p'; did you mean 'p_B'"),
        (WAY, {"omega": "omega_ref_1"}, "[controller.outputs] no output 'omega'; did you mean 'omega_ref'"),
        (WAY, {"omega_ref": ("omega_ref_1",)}, "omega_ref has 3 values; 1 variables are given for it"),
        (WAY, {"omega_ref": "omega_ref_1"}, 'omega_ref has 3 values, and "omega_ref_1" 1; give one for each'),
        (WAY, {"omega_ref": ("dp_z", "omega_ref_2", "omega_ref_3")}, "output 'dp_z' has unit 'm'; omega_ref[1] needs"),
        (WAY, {"F_z": "F_zz"}, "has no variable 'F_zz' for F_z; its outputs are omega_ref_1"),
        (WAY, {"F_z": "way_1"}, "'way_1' has causality input; F_z needs output"),
        (WAY | {"tau_l": ("tau_l_1", "tau_l_1", "tau_l_3")}, {}, "'tau_l_1' is given to tau_l[1] and tau_l[2]"),
    ],
)
def test_a_mapping_that_cannot_be_right_is_refused_in_a_sentence(law: Path, inputs: Any, outputs: Any, said: str):
    with pytest.raises(InputRefused, match=re.escape(said)):
        planned(law, inputs, outputs)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('name="p_B_1"', 'name="p_X_1"', 'p_B has 3 values, and "p_B_2", "p_B_3" 2; give one for each'),
        ('name="omega_ref_1"', 'name="fast"', "which of its outputs is omega_ref (commanded motor speeds, 3 x rad/s)"),
        ('unit="rad/m"', 'unit="rad/s"', "input 'J_1' has unit 'rad/s'; J[1] needs one like rad/m"),
        ("CoSimulation", "ModelExchange", "model exchange only; a sampled part"),
    ],
)
def test_an_fmu_that_does_not_fit_the_part_is_refused(law: Path, tmp_path: Path, old: str, new: str, said: str):
    file = with_description(law, tmp_path / "odd.fmu", old, new)
    with pytest.raises(InputRefused, match=re.escape(said)):
        planned(file)


def test_counts_have_no_unit(law: Path, tmp_path: Path):
    with zipfile.ZipFile(law) as archive:
        text = archive.read("modelDescription.xml").decode()
    line = next(part for part in text.split("<ScalarVariable") if 'name="triggered"' in part)
    file = with_description(law, tmp_path / "odd.fmu", line, line.replace('unit="1"', 'unit="deg"'))
    with pytest.raises(InputRefused, match="'triggered' has unit 'deg'; triggered has none"):
        planned(file)


def test_a_sampled_part_is_called_at_its_samples_and_told_when_the_last_step_ends(law: Path, monkeypatch: Any):
    told = []
    from twin.kernel.fmi import component

    class Told(component.CosimInstance):
        def __init__(self, *args: Any) -> None:
            told.append(args[-1].stop)
            super().__init__(*args)

    monkeypatch.setattr(component, "CosimInstance", Told)
    made = planned(law).part("controller", 1e-3, 2, 101)
    made.close()
    assert (made.sampled, made.period, told) == (True, 2, [100 * 1e-3 + 2 * 1e-3])


SHORT = "duration_s=0.2"
OWN_PORTS = {
    "controller": "pressing",
    "estimator": "pressing",
    "monitor": "pressing",
    "scale": FORCE,
    "body": FORCE,
}


@pytest.fixture
def mine(tmp_path: Path) -> Path:
    file = tmp_path / "mine.py"
    file.write_text(PARTS)
    return file


def named(role: str, kind: str, file: Path) -> str:
    return f"{role}.python={file}:{kind}"


@pytest.mark.parametrize("role", ROLE_CONTRACTS)
def test_a_part_of_another_make_may_have_the_ports_of_twins_own_and_no_others(role: str):
    moving = ["contact.shift={by_mm=[0,0,1],start_s=1,rise_s=1}"] if role == "body" else []
    with assemble(load_experiment(OWN_PORTS[role], moving)) as assembly:
        own = assembly.system.component(role)
    contract, told = ROLE_CONTRACTS[role], {"p_ref_B"} if role == "controller" else set()
    assert {p for p in contract.inputs if p.name not in told} == set(own.inputs)
    assert set(contract.outputs) == set(own.outputs)


def test_a_row_of_the_table_feeds_every_input_of_a_contract():
    rows = {row.name: row for row in COMPONENT_ROWS}
    for role, contract in ROLE_CONTRACTS.items():
        # twin's own controller alone reads what a tank passes on, its own monitor the age of a remote command
        assert {port.name for port in contract.inputs} == rows[role].inputs.keys() - {"share", "age"}, role


def test_what_is_needed_of_a_part_is_what_others_take_of_it():
    taken = {source for row in COMPONENT_ROWS for sources in row.inputs.values() for source in sources}
    for role, contract in ROLE_CONTRACTS.items():
        of_it = {port for owner, port in taken if owner == role}
        # tasks alone need tau_l, and a tank alone valid; lines of single drives are of twin's own monitor
        spare = {"tau_l", "valid", "drive_power", "brake"}
        # a scale and a trip are what such parts are for
        needed = of_it - spare | {"scale": {"F_z"}, "monitor": {"tripped"}}.get(role, set())
        assert needed == set(contract.required)


def test_no_port_of_the_robots_computer_is_true():
    true = {("plant", port) for port in ("p_B", "F_ee_B", "theta_l", "tau_load")} | {("drive", "theta_m")}
    for row in COMPONENT_ROWS:
        if row.name in ("estimator", "controller", "remote", "monitor"):
            assert not {source for sources in row.inputs.values() for source in sources} & true


def test_a_controller_that_wants_the_way_is_told_of_it_and_any_other_is_not(mine: Path):
    way = run_in_memory(shipped(FORCE, SHORT, named("controller", "Controller", mine)))
    own = run_in_memory(shipped(FORCE, SHORT))
    np.testing.assert_array_equal(way["reference.p_ref_B"], own["controller.p_ref_B"])
    still = run_in_memory(shipped(FORCE, SHORT, named("controller", "Still", mine)))
    assert "reference.p_ref_B" not in still.fields()
    assert still["controller.omega_ref"].any() == np.False_


def test_a_class_with_the_law_of_the_position_loop_does_what_that_does(mine: Path):
    own = run_in_memory(shipped(FORCE, "duration_s=2"))
    other = run_in_memory(shipped(FORCE, "duration_s=2", named("controller", "Controller", mine)))
    # before the force loop is on; numpy may sum in another order than the compiled law
    np.testing.assert_allclose(other["controller.omega_ref"], own["controller.omega_ref"], rtol=0, atol=1e-12)


def test_tasks_have_no_way_to_tell_of(mine: Path):
    with pytest.raises(InputRefused, match=r"mine.py:Controller: takes p_ref_B, and tasks have no waypoints"):
        assemble(load_experiment("pressing", [named("controller", "Controller", mine)]))
    run = run_in_memory(load_experiment("pressing", [named("controller", "Still", mine)]))
    assert not run["controller.omega_ref"].any()


def test_every_part_at_once_goes_through_a_run_and_a_recording_names_them(mine: Path, tmp_path: Path):
    names = {"controller": "Still", "estimator": "Estimator", "monitor": "Monitor", "body": "Body", "scale": "Scale"}
    experiment = shipped(FORCE, SHORT, *(named(role, kind, mine) for role, kind in names.items()))
    run = execute(experiment, tmp_path / "run")
    recording = read(run.recording)
    digest = hashlib.sha256(mine.read_bytes()).hexdigest()
    assert recording.metadata["part"].keys() == names.keys() == run.parts.keys()
    assert all(digest in text for text in recording.metadata["python"].values())
    assert all(digest[:12] in text and "did not run" in text for text in recording.other_parts)
    assert str(tmp_path) not in str(recording.metadata)
    assert (run.outcome.lateral_error, run.outcome.force_error) == (None, None)
    np.testing.assert_allclose(recording["body.s_B"][:, 2], 0.01 * recording.time("body"), atol=1e-15)
    assert recording["estimator.p_B"][0].tolist() == [0.0, 0.02, -0.085]


def test_a_surface_that_another_body_moves_reaches_the_platform(mine: Path):
    # the platform stands still at 16 mm over the scale, which comes up by 10 mm a second
    settings = ["duration_s=2", named("body", "Body", mine), named("controller", "Still", mine)]
    F_z = -run_in_memory(shipped(FORCE, *settings))["plant.F_ee_B"][:, 2]
    assert F_z[1500] == pytest.approx(0.0, abs=1e-9)
    assert F_z[1700] > 0.5


def test_a_trip_of_another_monitor_is_one(mine: Path):
    experiment = load_experiment(
        "pressing", ["duration_s=13", named("monitor", "Monitor", mine), "monitor.parameters.trip_s=1.0"]
    )
    with assemble(experiment) as assembly:
        done = simulate(assembly, 1100)
    assert "mine.py:Monitor has tripped" in trip_reason(done.simulation)
    with assemble(experiment) as assembly:
        assert trip_reason(simulate(assembly, 900).simulation) == ""


def test_the_run_and_its_text_say_that_twins_own_did_not_run(mine: Path, tmp_path: Path):
    run = execute(shipped(FORCE, SHORT, named("controller", "Controller", mine)), tmp_path / "run")
    assert "twin's own, which has the law of the paper, did not run" in run.parts["controller"]
    values = read(run.recording).metadata["experiment"]["values"]
    assert "kp_mm_per_N" not in values
    assert '"python": "mine.py:Controller"' in values


def test_a_failure_names_the_line_and_what_to_try(mine: Path, tmp_path: Path):
    line = 1 + PARTS[: PARTS.index("1 / (0.1 - t)")].count("\n")
    with pytest.raises(ComponentFailed) as failure:
        execute(shipped(FORCE, SHORT, named("controller", "Breaks", mine)), tmp_path / "run")
    assert re.search(rf"raised ZeroDivisionError.*\(mine.py, line {line}\) at t = 0.1 s", str(failure.value))
    assert f"Try: twin component check controller {mine}:Breaks" in str(failure.value)
    assert failure.value.exit_code == 3


def test_a_class_or_an_instance_takes_the_place_of_a_part_in_a_program(tmp_path: Path):
    for given in (Controller, Controller(kp=3.0)):
        with assemble(shipped(FORCE, SHORT), {"controller": given}) as assembly:
            assert assembly.substituted == {"controller": "Controller"}
            assert assembly.system.has_output("reference.p_ref_B")
    run = execute(shipped(FORCE, SHORT), tmp_path / "run", substitutes={"controller": Controller})
    assert "kp_mm_per_N" not in read(run.recording).metadata["experiment"]["values"]
    with pytest.raises(InputRefused, match="substitutes: 'drive_1' takes a component; classes take body, estimator"):
        assemble(shipped(), {"drive_1": Controller})


def test_a_component_is_a_substitute_as_ever():
    class Law:
        inputs = ROLE_CONTRACTS["controller"].inputs[:1]
        outputs = ROLE_CONTRACTS["controller"].outputs[:7]
        sampled = True

        def step(self, t: float, h: float, u: Any, y: Any) -> None: ...

    with assemble(shipped(FORCE, SHORT), {"controller": PythonComponent("controller", Law(), 2)}) as assembly:
        assert isinstance(assembly.system.component("controller"), Component)


def test_the_example_gives_way_to_what_it_feels():
    def end(give: float) -> float:
        experiment = shipped(FORCE, "duration_s=9", "controller.python=examples/my_controller.py:Controller",
                             f"controller.parameters.give={give!r}")  # fmt: skip
        return float(-run_in_memory(experiment)["plant.F_ee_B"][-1, 2])

    stiff, soft = end(0.0), end(0.001)
    assert 3.5 < stiff < 5.0
    assert soft < 0.8 * stiff


def test_a_recording_runs_again_with_the_file_beside_it_and_no_other(mine: Path, tmp_path: Path):
    run = execute(shipped(FORCE, SHORT, named("controller", "Controller", mine)), tmp_path / "run")
    recording = read(run.recording)
    again = recorded_experiment(recording.metadata, mine.with_name("run.mcap"))
    np.testing.assert_array_equal(run_in_memory(again)["plant.p_B"], recording["plant.p_B"])
    mine.write_text(PARTS + "\n# another\n")
    with pytest.raises(InputRefused, match="It is another file"):
        assemble(recorded_experiment(recording.metadata, mine.with_name("run.mcap")))
    mine.unlink()
    with pytest.raises(InputRefused, match=r"its controller mine\.py is not in the recording's folder"):
        recorded_experiment(recording.metadata, mine.with_name("run.mcap"))


def test_a_recording_runs_again_with_the_fmu_that_it_names(root: Path, tmp_path: Path):
    run = execute(shipped(FORCE, SHORT, "controller.fmu=fmus/parts/paper_law"), tmp_path / "run")
    recording = read(run.recording)
    again = recorded_experiment(recording.metadata, root / "run.mcap")
    np.testing.assert_array_equal(run_in_memory(again)["plant.p_B"], recording["plant.p_B"])


def test_a_pinned_hash_refuses_another_file(mine: Path):
    with pytest.raises(InputRefused, match=f"{mine}: has sha256 .* pins {'0' * 64}"):
        assemble(shipped(FORCE, named("controller", "Controller", mine), f"controller.sha256='{'0' * 64}'"))


def _tuned(experiment: Experiment) -> None:
    tune_gains([experiment], Goals())


@pytest.mark.parametrize(
    ("study", "role"),
    [
        (_tuned, "controller"), (_tuned, "estimator"), (stability, "controller"), (stability, "estimator"),
        (convergence, "controller"), (convergence, "estimator"), (accuracy_budget, "estimator"),
        (checked_healthy_run, "monitor"),
    ],
)  # fmt: skip
def test_studies_of_twins_own_law_refuse_another(mine: Path, study: Callable[[Experiment], Any], role: str):
    kind = {"controller": "Still", "estimator": "Estimator", "monitor": "Monitor"}[role]
    with pytest.raises(
        InputRefused, match=rf"its {role} is mine.py:{kind}; .* knows the law of twin's own {role} only"
    ):
        study(shipped(FORCE, SHORT, named(role, kind, mine)))


def test_a_replay_refuses_an_estimator_of_another_make(mine: Path, tmp_path: Path):
    run = execute(shipped(FORCE, SHORT, named("estimator", "Estimator", mine)), tmp_path / "run")
    with pytest.raises(InputRefused, match=r"\[estimator\] is third-party; only the twin's own can be replayed"):
        model_for(run.recording, None)
    run = execute(shipped(FORCE, SHORT, named("controller", "Still", mine)), tmp_path / "other")
    assert model_for(run.recording, None).belief.N == 2.0


def test_a_fault_of_a_belief_needs_twins_own_estimator(mine: Path):
    fault = 'fault=[{kind="belief_k_s", onset_s=0.1, magnitude_factor=1.2}]'
    with pytest.raises(InputRefused, match="which has none; remove the fault or use the native estimator"):
        assemble(shipped(FORCE, SHORT, named("estimator", "Estimator", mine), fault))


def test_faults_break_what_surrounds_another_controller(mine: Path):
    fault = 'fault=[{kind="drive_runaway", onset_s=0.1, magnitude_rad_per_s=2.0}]'
    still = named("controller", "Still", mine)
    theta_m = run_in_memory(shipped(FORCE, SHORT, still, fault))["fault/1.theta_m"]
    assert theta_m[-1] - theta_m[0] == pytest.approx(0.2, abs=0.01)


def test_an_fmu_keeps_nothing_for_the_next_run(mine: Path):
    part = third_party_part("controller", shipped(FORCE, "controller.fmu=fmus/parts/paper_law").stand_ins["controller"])
    assert part.fmu is not None
    assert part.sha256 == part.fmu.sha256
    assert Port("omega_ref", 3, "rad/s", "commanded motor speeds") in part.outputs
