"""Systems that cannot be run are refused in a sentence, before anything is loaded or written."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.kernel.fmi.archives import redescribed
from tests.kernel.systems.archives import archive, component, connection, connector, line, structure, system, values
from twin.kernel.errors import InputRefused
from twin.kernel.process.reporter import DirectReporter
from twin.kernel.ssp.flat import UnitStep
from twin.kernel.ssp.structure import Transformation, UnitDefinition
from twin.kernel.systems import coupling
from twin.kernel.systems.unit_conversion import AffineMap, connection_map, parse_unit
from twin.kernel.units import Dimension
from twin.studies.systems.recorded import record_system

Change = tuple[str, str]
A, B = component("a", "a.fmu"), component("b", "a.fmu")
SPEED = connection("a.omega_m", "b.omega_ref")
NO_START = ('<Real start="0.0" unit="N.m" />', '<Real unit="N.m" />')
STRANGE = ('unit="N.m" />\n    </ScalarVariable>', 'unit="furlong" />\n    </ScalarVariable>')
WHOLE = ('<Real start="0.0" unit="N.m" />', '<Integer start="0" />')
ONCE = ('<CoSimulation modelIdentifier="ideal_velocity"', '<CoSimulation modelIdentifier="ideal_velocity" '
        'canBeInstantiatedOnlyOncePerProcess="true"')  # fmt: skip
STEPLESS = (' stepSize="0.001"', "")
ENDLESS = (' stopTime="1.0"', "")
SILENT = ('<DefaultExperiment startTime="0.0" stopTime="1.0" stepSize="0.001" />', "")
ORDERED = system([A, B]).replace(
    "<ssd:Elements>",
    '<ssd:Annotations><ssc:Annotation type="twin.order"><order><component name="%"/></order></ssc:Annotation>'
    "</ssd:Annotations><ssd:Elements>",
)
MAP = (
    '<ssc:BooleanMappingTransformation><ssc:MapEntry source="true" target="false"/></ssc:BooleanMappingTransformation>'
)


def ssd(*parts: str, wires: tuple[str, ...] = (), bound: str = "", stop: float | None = 0.01, **more: str) -> str:
    return structure(system(parts or [A, B], wires, bindings=bound), stop, **more)


BAD: dict[str, tuple[str, Change | None, str]] = {
    "no components": (structure(system([]), 1.0), None, "a system without components"),
    "a missing resource": (ssd(component("a", "b.fmu")), None, "its resource 'b.fmu' is not a file of this"),
    "a resource outside": (ssd(component("a", "../../a.fmu")), None, "'../../a.fmu' is not a file of this"),
    "a resource elsewhere": (ssd(component("a", "file:///a.fmu")), None, "'file:///a.fmu' is not a file of this"),
    "another resource": (
        ssd(component("a", "a.fmu", more='type="application/x-ssp-package"')), None,
        "component 'a' is of type application/x-ssp-package, which is not supported",
    ),
    "for scheduled execution": (
        ssd(component("a", "a.fmu", more='implementation="ScheduledExecution"')), None,
        "component 'a' is to be used for ScheduledExecution, which is not supported",
    ),
    "for the other kind": (
        ssd(component("a", "a.fmu", more='implementation="ModelExchange"')), None,
        "x.ssp: a.fmu: offers co-simulation alone, and its component a is to be used for model exchange; export it",
    ),
    "no FMU": (ssd(component("a", "x.txt")), None, "x.ssp: x.txt: not a complete FMU"),
    "no variable": (
        ssd(wires=(connection("a.omega", "b.omega_ref"),)), None,
        "a connection with a.omega: a.fmu has no such variable; did you mean 'omega_m'?",
    ),
    "into an output": (ssd(wires=(connection("a.omega_m", "b.theta_m"),)), None, "b.theta_m: it is output"),
    "from an input": (ssd(wires=(connection("a.omega_ref", "b.omega_ref"),)), None, "a.omega_ref: it is input"),
    "other quantities": (
        ssd(wires=(connection("a.theta_m", "b.omega_ref"),)), None,
        "the connection from a.theta_m to b.omega_ref: from 'rad' to 'rad/s', which have different dimensions",
    ),
    "an unknown unit": (
        ssd(wires=(connection("a.omega_m", "b.tau_load"),)), STRANGE, "the unit 'furlong' is not defined",
    ),
    "units at odds": (
        ssd(A, component("b", "a.fmu", [connector("omega_ref", "input", "rpm")]), wires=(SPEED,)), None,
        "omega_ref is in 'rpm' by its connector, and in 'rad/s' by the FMU",
    ),
    "a factor 0": (ssd(wires=(connection("a.omega_m", "b.omega_ref", line(0)),)), None, "the factor 0; leave"),
    "a table": (
        ssd(wires=(connection("a.omega_m", "b.omega_ref", MAP),)), None, "BooleanMappingTransformation is not",
    ),
    "real into whole": (ssd(wires=(connection("a.omega_m", "b.tau_load"),)), WHOLE, "a Real into a Integer; expected"),
    "two writers": (ssd(wires=(SPEED, SPEED)), None, "b.omega_ref is fed by two connections"),
    "no start value": (ssd(), NO_START, "input a.tau_load has no source and no start value; connect it"),
    "a second instance": (ssd(), ONCE, "x.ssp: a.fmu: can be instantiated only once in a process"),
    "no such value": (ssd(bound=values("a.omega_ref=1 N.m")), None, "from 'N.m' to 'rad/s', which have different"),
    "a unit of a value": (ssd(bound=values("a.omega_ref=1 furlong")), None, "the unit 'furlong' is not defined"),
    "no step": (ssd(A), STEPLESS, "neither the structure nor an FMU states a step size (give --tick-ms)"),
    "no stop": (ssd(stop=None), ENDLESS, "neither the structure nor an FMU states a stop time (give --stop-s)"),
    "neither": (
        ssd(A, stop=None), SILENT,
        "neither the structure nor an FMU states a step size (give --tick-ms) and a stop time (give --stop-s)",
    ),
    "no whole step": (ssd(stop=0.0105), None, "0.0105 s is not a whole number of steps of 1 ms"),
    "steps without end": (ssd(stop=1e300), None, "from 0 to 1e+300 s in steps of 0.001 s; expected at least"),
    "an end long before": (ssd(stop=-1e308), None, "from 0 to -1e+308 s in steps of 0.001 s; expected at"),
    "a start behind the end": (
        ssd().replace('startTime="0.0"', 'startTime="5"'), None, "from 5 to 0.01 s in steps of 0.001 s; expected at",
    ),
    "a start before 0": (
        ssd().replace('startTime="0.0"', 'startTime="-1"'), None, "starts at -1 s; expected 0 or later: give --start-s",
    ),
    "a start within a step": (
        ssd().replace('startTime="0.0"', 'startTime="0.0005"'), None,
        "the start at 0.0005 s is not a whole number of steps of 1 ms; set --start-s or --tick-ms",
    ),
    "an order of strangers": (
        structure(ORDERED.replace("%", "c"), 0.01), None, "annotation twin.order: 'c' is not a component of the system",
    ),
}  # fmt: skip


@pytest.fixture
def fmu(ideal: Path, tmp_path: Path) -> Callable[[Change | None], Path]:
    def changed(change: Change | None) -> Path:
        return redescribed(ideal, tmp_path / "changed.fmu", *change) if change else ideal

    return changed


@pytest.mark.parametrize("bad", BAD)
def test_what_cannot_be_run_is_refused_before_anything_is_loaded(
    bad: str, fmu: Callable[[Change | None], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    text, change, told = BAD[bad]
    file = archive(tmp_path / "x.ssp", text, {"a.fmu": fmu(change), "x.txt": "x"})
    monkeypatch.setattr(coupling, "instance_class", None)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputRefused) as refused:
        record_system(DirectReporter(lambda note: None), Path("x.ssp"))
    assert str(refused.value).startswith("x.ssp: ") and told in str(refused.value)
    assert not (tmp_path / "results").exists()
    assert file.exists()


LENGTH = Dimension(m=1)
UNITS = (
    UnitDefinition("m", LENGTH),
    UnitDefinition("inch", LENGTH, 0.0254),
    UnitDefinition("over", LENGTH, 2.0, -3.0),
    UnitDefinition("s", Dimension(s=1)),
)
names = st.sampled_from(["m", "inch", "over", ""])
numbers = st.floats(-1e3, 1e3)
factors = numbers.filter(lambda factor: abs(factor) > 1e-3)
hops = st.lists(
    st.builds(UnitStep, st.builds(Transformation, factors, numbers), st.booleans(), names), min_size=1, max_size=4
)


def si(value: float, unit: str) -> float:
    factor, offset = {one.name: (one.factor, one.offset) for one in UNITS}[unit]
    return factor * value + offset


def by_hand(value: float, start: str, parts: list[UnitStep], end: str) -> float:
    """As the standard tells it: to the unit of where it gets, then the line."""
    here = start
    for number, (transformation, suppressed, unit) in enumerate(parts):
        there = end if number == len(parts) - 1 else unit
        if here and there and not suppressed:
            factor, offset = {one.name: (one.factor, one.offset) for one in UNITS}[there]
            value = (si(value, here) - offset) / factor
        value = transformation.factor * value + transformation.offset
        here = there or here
    return value


@given(numbers, names, hops, names)
def test_the_whole_way_is_its_parts_one_after_the_other(value: float, start: str, parts: list[UnitStep], end: str):
    whole = connection_map(parse_unit(start, UNITS), parts, parse_unit(end, UNITS), UNITS, "x")
    # roundings of sums whose terms may cancel: of the largest term there can be
    size = math.prod(abs(part.transformation.factor) * 80.0 + 1.0 for part in parts) * 1e4
    assert whole.apply(value) == pytest.approx(by_hand(value, start, parts, end), rel=1e-9, abs=1e-13 * size)


@given(numbers)
def test_a_way_on_which_nothing_happens_changes_no_bit(value: float):
    for one, other in (("inch", "inch"), ("", "m"), ("m", ""), ("", "")):
        led = connection_map(parse_unit(one, UNITS), [UnitStep(), UnitStep()], parse_unit(other, UNITS), UNITS, "x")
        assert led == AffineMap() and led.apply(value) == value


@pytest.mark.parametrize(
    ("start", "line", "end", "told"),
    [
        ("m", Transformation(), "s", "from 'm' to 's', which have different dimensions"),
        ("m", Transformation(), "ell", "the unit 'ell' is not defined"),
        ("m", Transformation(0.0), "m", "the factor 0"),
        ("m", Transformation(5e-324), "m", "exceeds the range of a number"),
        ("m", Transformation(1e-300, 1e300), "m", "exceeds the range of a number"),
        (
            "m",
            Transformation(table="IntegerMappingTransformation"),
            "m",
            "IntegerMappingTransformation is not supported",
        ),
    ],
)
def test_a_way_that_leads_nowhere_is_refused(start: str, line: Transformation, end: str, told: str):
    with pytest.raises(InputRefused) as refused:
        connection_map(parse_unit(start, UNITS), [UnitStep(line)], parse_unit(end, UNITS), UNITS, "x")
    assert told in str(refused.value)
