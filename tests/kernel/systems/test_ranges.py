"""A value reaches a variable as it was given, or it is refused by name: every type, every way in."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tests.kernel.fmi.archives import redescribed
from tests.kernel.fmi.odd import FMI2, FMI3, RANGES, odd_fmu
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.errors import ComponentFailed, InputRefused, TwinError
from twin.kernel.systems.additions import Additions
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.opening import open_system
from twin.kernel.systems.reading import read_system
from twin.kernel.systems.session import Cosimulation

REALS = ("Real", "Float64", "Float32")
TYPES = (*(one for one in FMI2 if one != "Boolean"), *(one for one in FMI3 if one != "Boolean"))
STOP = 0.3


class Value:
    """A component in Python that gives a value from its second step on, first 1."""

    inputs, outputs, sampled = (), (Port("y"),), True

    def __init__(self, value: float):
        self.value = value

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        y[0] = self.value if t > 0.05 else 1.0


def one_fmu(fmu: Path, **more: list) -> float | int:
    """What out_TYPE is at the end of a run of that FMU alone."""
    name = next(v for v in (f"out_{one}" for one in TYPES) if v.encode() in _description(fmu))
    with open_system(read_system(fmu), MasterChoice(stop=STOP), additions=Additions(**more)) as (plan, made):
        rows = Simulation(made.system, plan.timing.ticks).run()
        return float(rows[-1, made.system.columns(f"{plan.parts[0].name}.{name}")][0])


def _description(fmu: Path) -> bytes:
    import zipfile

    with zipfile.ZipFile(fmu) as archive:
        return archive.read("modelDescription.xml")


def by_set(fmu: Path, name: str, value: float) -> float:
    return one_fmu(fmu, settings=[f"in_{name}={value!r}"])


def by_ssv(fmu: Path, name: str, value: float) -> float:
    kind = "Integer" if isinstance(value, int) else "Real"
    file = fmu.with_suffix(".ssv")
    file.write_text(
        '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" '
        f'name="x"><ssv:Parameters><ssv:Parameter name="in_{name}"><ssv:{kind} value="{value!r}"/></ssv:Parameter>'
        "</ssv:Parameters></ssv:ParameterSet>"
    )
    return one_fmu(fmu, parameters=[file])


def start_value(name: str, value: float) -> dict[str, Any]:
    return {name: value}


def by_input(fmu: Path, name: str, value: float) -> float:
    return one_fmu(fmu, inputs=[f"in_{name}=1 - step(0.1) + {value!r} * step(0.1)"])


def by_wire(fmu: Path, name: str, value: float) -> float:
    """From an FMU whose output has the value, of the widest type that may be connected."""
    source = "Float64" if name in REALS else "Int64"
    start = odd_fmu(fmu.with_name(f"source_{source}.fmu"), types=[source])
    with Cosimulation(0.1, STOP) as made:
        made.load("a", start, **start_value(f"in_{source}", 1))
        made.load("b", fmu)
        made.wire(f"a.out_{source}", f"b.in_{name}")
        made.step()
        made.set(f"a.in_{source}", value)
        made.step(2)
        return cast(float, made.get(f"b.out_{name}"))


def by_component(fmu: Path, name: str, value: float) -> float:
    with Cosimulation(0.1, STOP) as made:
        made.add("a", Value(float(value)))
        made.load("b", fmu)
        made.wire("a.y", f"b.in_{name}")
        made.run()
        return cast(float, made.get(f"b.out_{name}"))


def by_start(fmu: Path, name: str, value: float) -> float:
    with Cosimulation(0.1, STOP) as made:
        made.load("b", fmu, **start_value(f"in_{name}", value))
        made.run()
        return cast(float, made.get(f"b.out_{name}"))


def by_python(fmu: Path, name: str, value: float) -> float:
    with Cosimulation(0.1, STOP) as made:
        made.load("b", fmu)
        made.step()
        made.set(f"b.in_{name}", value)
        made.step()
        return cast(float, made.get(f"b.out_{name}"))


WAYS: dict[str, Callable[[Path, str, float], float]] = {
    "--set": by_set, "SSV": by_ssv, "--input": by_input, "wire": by_wire, "component": by_component, "start": by_start,
    "Python": by_python,
}  # fmt: skip
EDGES = sorted({edge + d for pair in RANGES.values() for edge in pair for d in (-1, 0, 1)} | {3 * 10**9, 2**60, 2**64})
NUMBERS = st.one_of(
    st.sampled_from(EDGES),
    st.integers(-(2**65), 2**65),
    st.sampled_from([math.nan, math.inf, -math.inf, 1e39, -1e300, 2.0**53, 3.5e38]),
)


def fits(name: str, value: float) -> bool:
    if name in REALS:
        most = float(np.finfo(np.float32).max) if name == "Float32" else math.inf
        return math.isfinite(value) and abs(value) <= most
    low, high = RANGES[name]
    return low <= value <= high


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("odd")
    return {one: odd_fmu(folder / f"{one}.fmu", types=[one]) for one in TYPES}


@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(TYPES), value=NUMBERS)
@example(name="Integer", value=3 * 10**9)
@example(name="UInt8", value=300)
@example(name="UInt8", value=-1)
@example(name="Int64", value=2**53)
@example(name="Int64", value=2**53 + 1)
@example(name="Float32", value=1e39)
@example(name="Float64", value=math.nan)
def test_a_value_arrives_as_it_was_given_or_is_refused_by_name(
    way: str, name: str, value: float, fmus: dict[str, Path]
):
    possible = fits(name, value)
    if way == "component":
        # a signal of Python is a double
        value = float(value)
        possible = fits(name, value)
    if name not in REALS and way == "--input" and abs(value) >= 2**53:
        # a constant in an expression may have been rounded
        possible = False
    try:
        came = WAYS[way](fmus[name], name, value)
    except (InputRefused, ComponentFailed) as refusal:
        assert not possible, refusal
        assert (
            f"in_{name}" in str(refusal)
            or (way in ("wire", "component") and "Int64" in str(refusal))
            or (way in ("wire", "component", "--input") and ("returned" in str(refusal) or "finite" in str(refusal)))
        )
    else:
        assert possible, came
        assert came == (float(np.float32(value)) if name == "Float32" else float(value) if name in REALS else value)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("value", [0, 1, 2, 3, 4, 5, 2**31 - 1])
def test_an_enumeration_takes_no_value_between_or_beyond_its_items(
    way: str, value: int, fmus: dict[str, Path], tmp_path: Path
):
    fmu = redescribed(fmus["Enumeration"], tmp_path / "gap.fmu", '<Item name="three" value="3"/>',
                      '<Item name="four" value="4"/>')  # fmt: skip
    if value in (1, 2, 4):
        assert WAYS[way](fmu, "Enumeration", value) == value
        return
    with pytest.raises((InputRefused, ComponentFailed), match=r"one \(1\), two \(2\), four \(4\)"):
        WAYS[way](fmu, "Enumeration", value)


TEXT_WAYS: dict[str, Callable[[Path, str], object]] = {
    "--set": lambda fmu, text: one_fmu(fmu, settings=[f"in_Real={text}"]),
    "--input": lambda fmu, text: one_fmu(fmu, inputs=[f"in_Real={text}"]),
    "CSV": lambda fmu, text: one_fmu(fmu, inputs=[_written(fmu.with_suffix(".csv"), f"time,in_Real\n0,{text}\n1,0\n")]),
    "SSV": lambda fmu, text: by_ssv(fmu, "Real", _Text(text)),
}


class _Text(float):
    """A value of an SSV file that is written as a text of its own."""

    text: str

    def __new__(cls, text: str) -> "_Text":
        made = super().__new__(cls, 0.0)
        made.text = text
        return made

    def __repr__(self) -> str:
        return self.text


def _written(file: Path, text: str) -> str:
    file.write_text(text, encoding="utf-8")
    return str(file)


@pytest.mark.parametrize("way", TEXT_WAYS)
@pytest.mark.parametrize("text", ["1_000", "1_0.5", "1e1_0", "\u0661", "\uff11\uff12", "0x10"])
def test_a_number_in_a_text_has_ascii_digits_alone(way: str, text: str, fmus: dict[str, Path], tmp_path: Path):
    fmu = tmp_path / "x.fmu"
    fmu.write_bytes(fmus["Real"].read_bytes())
    with pytest.raises(TwinError):
        TEXT_WAYS[way](fmu, text)
    assert TEXT_WAYS[way](fmu, "1.5e1") is not None


@pytest.mark.parametrize(("given", "arrives"), [(2.6, 3), (-2.6, -3), (0.4, 0)])
def test_what_is_not_whole_is_rounded_on_its_way_into_an_integer(given: float, arrives: int, fmus: dict[str, Path]):
    assert by_component(fmus["Integer"], "Integer", given) == arrives


@pytest.mark.parametrize("types", [["Boolean"], ["Boolean", "Int8"]], ids=["FMI 2.0", "FMI 3.0"])
@pytest.mark.parametrize(("value", "arrives"), [(0.4, 0), (0.5, 1), (1.4, 1), (1.6, None), (2.0, None), (-1.0, None)])
def test_a_boolean_is_rounded_and_what_is_neither_true_nor_false_ends_the_run_by_name(
    types: list[str], value: float, arrives: int | None, tmp_path: Path
):
    fmu = odd_fmu(tmp_path / "b.fmu", types=types)
    if arrives is not None:
        assert by_component(fmu, "Boolean", value) == arrives
        return
    with pytest.raises(ComponentFailed, match=r"for in_Boolean, which is Boolean \(0 \.\. 1\)"):
        by_component(fmu, "Boolean", value)


@pytest.mark.parametrize("name", ["Int64", "UInt64"])
def test_a_whole_number_beyond_what_a_double_holds_ends_the_run_by_name_and_is_exact_in_python(
    name: str, tmp_path: Path
):
    more = f'<{name} name="large" valueReference="64" causality="local" variability="discrete"/>'
    fmu = odd_fmu(tmp_path / "x.fmu", types=[name], more=more)
    value = 2**50 + 1
    with Cosimulation(0.1, STOP) as made:
        made.load("x", fmu, **start_value(f"in_{name}", value))
        made.step()
        assert made.get("x.large") == 1024 * value
    with (
        open_system(read_system(fmu), additions=Additions([f"in_{name}=1"], recorded=["large"])) as (plan, made),
        pytest.raises(ComponentFailed, match=rf"x.fmu \(x\) returned {2**61 + 1024} for large \({name}\)"),
    ):
        simulation = Simulation(made.system, plan.timing.ticks)
        simulation.advance(1)
        part: Any = made.system.components[0]
        part.instance.write([(part.instance.description.variables[f"in_{name}"], 2.0**51 + 1.0)])
        simulation.run()


@pytest.mark.parametrize(
    ("in_", "out", "factor"),
    [(2**31, 32, 1), (2**32 - 1, 63, 1), (0, 2**31, 1024), (31, 2**32 - 1, 1024), (2**31, 2**32 - 32, 1024)],
)
def test_value_references_of_32_bits_reach_their_variables(in_: int, out: int, factor: int, tmp_path: Path):
    assert by_set(referring(tmp_path, in_, out), "Int64", 3) == 3 * factor
    with Cosimulation(0.1, STOP) as made:
        made.load("x", tmp_path / "x.fmu")
        made.load("y", tmp_path / "x.fmu")
        made.wire("x.out_Int64", "y.in_Int64")
        made.set("x.in_Int64", 5)
        made.step(2)
        assert made.get("y.out_Int64") == 5 * factor**2


@pytest.mark.parametrize("reference", [2**32, 2**63, -1])
def test_a_value_reference_beyond_32_bits_is_refused_by_name(reference: int, tmp_path: Path):
    with pytest.raises(
        InputRefused, match=rf"'out_Int64' has the value reference {reference}; expected 0 .. 4294967295"
    ):
        read_system(referring(tmp_path, 0, reference))


def referring(folder: Path, in_: int, out: int) -> Path:
    """The FMU x.fmu with these value references of its input and output; odd.c takes them by their last bits."""
    plain = odd_fmu(folder / "plain.fmu", types=["Int64"])
    first = redescribed(plain, folder / "first.fmu", 'valueReference="0"', f'valueReference="{in_}"')
    return redescribed(first, folder / "x.fmu", 'valueReference="32"', f'valueReference="{out}"')
