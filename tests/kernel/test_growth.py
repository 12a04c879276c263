"""Readers of TOML, JSON and XML take work in proportion to the text, whatever is in it."""

import contextlib
from collections.abc import Callable

import pytest

from tests.growth import assert_linear
from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_json, parse_toml, parse_xml
from twin.kernel.ssp.ssd import parameter_set

SSV = (
    '<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="a">'
    "<ssv:Parameters>{}</ssv:Parameters></ssv:ParameterSet>"
)


def toml(text: Callable[[int], str]) -> Callable[[int], object]:
    return lambda n: parse_toml(text(n), "a.toml")


TOML = {
    "keys": toml(lambda n: "".join(f"a{k} = {k}\n" for k in range(20 * n))),
    "tables": toml(lambda n: "".join(f"[a{k}]\nb = {k}\n" for k in range(20 * n))),
    "array of tables": toml(lambda n: "".join(f"[[a]]\nb = {k}\n" for k in range(20 * n))),
    "dotted keys": toml(lambda n: "".join(f"a.b.c{k} = {k}\n" for k in range(20 * n))),
    "numbers": toml(lambda n: f"a = [{'1.5, ' * (40 * n)}]\n"),
    "text": toml(lambda n: f'a = "{"x" * (2000 * n)}"\n'),
    "quotes": toml(lambda n: f"a = '''{'q' * (40 * n)}''' # {'.' * (40 * n)}\n"),
    "blanks": toml(lambda n: f"a{' ' * (2000 * n)}= 1\n"),
    "unclosed quotes": toml(lambda n: "a = '\n" * (40 * n)),
    "brackets": toml(lambda n: "a = [" * (40 * n)),
}
XML = {
    "parameters": lambda n: parameter_set(
        SSV.format(
            "".join(
                f'<ssv:Parameter name="p{k}"><ssv:Real value="{k}" unit="m"/></ssv:Parameter>' for k in range(10 * n)
            )
        ).encode(),
        "a.ssv",
    ),
    "one parameter of many values": lambda n: parameter_set(
        SSV.format(f'<ssv:Parameter name="p"><ssv:Real value="{"1.5 " * (40 * n)}"/></ssv:Parameter>').encode(), "a.ssv"
    ),
    "elements": lambda n: parse_xml(f"<a>{'<b/>' * (100 * n)}</a>".encode(), "a.xml"),
    "attributes": lambda n: parse_xml(("<a" + "".join(f' b{k}="1"' for k in range(20 * n)) + "/>").encode(), "a.xml"),
}
JSON = {
    "numbers": lambda n: parse_json(f"[{'1.5, ' * (100 * n)}1]", "a.json"),
    "keys": lambda n: parse_json("{" + ",".join(f'"a{k}": 1' for k in range(40 * n)) + "}", "a.json"),
}


@pytest.mark.parametrize(
    "read",
    [
        pytest.param(one, id=f"{form} {name}")
        for form, group in (("toml", TOML), ("xml", XML), ("json", JSON))
        for name, one in group.items()
    ],
)
def test_a_text_of_four_times_the_size_takes_four_times_the_work(read: Callable[[int], object]):
    def prepared(n: int) -> Callable[[], None]:
        def call() -> None:
            # a text that is refused may take no longer either
            with contextlib.suppress(InputRefused):
                read(n)

        return call

    assert_linear(prepared, 48)
