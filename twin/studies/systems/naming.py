"""What components and variables of a system are called in the master and in a recording, where names are words."""

import re
from collections.abc import Iterable

_ELEMENT = re.compile(r"(.+)\[(\d+)\]")


def word(name: str) -> str:
    """`name` with letters, digits and underscores alone, a letter first."""
    text = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "x"
    return text if text[0].isalpha() else f"x_{text}"


def distinct(names: Iterable[str]) -> list[str]:
    """`names`, those that have come before with a number."""
    seen: set[str] = set()
    found = []
    for name in names:
        number = 1
        while (one := name if number == 1 else f"{name}_{number}") in seen:
            number += 1
        seen.add(one)
        found.append(one)
    return found


def topic(path: str) -> str:
    """Of a component: `arm/motor` of `arm.motor`."""
    return "/".join(word(part) for part in path.split("."))


def field(variable: str, path: str) -> str:
    """Of a variable of the component at `path`, whose own name in front of it is left out: `p_B` of `plant.p_B`."""
    return word(variable.removeprefix(f"{path.rpartition('.')[2]}."))


def element(variable: str) -> tuple[str, int]:
    """(array, number) of a variable that is an element of one, `p_B[2]`; number 0: it is none."""
    match = _ELEMENT.fullmatch(variable)
    return (match[1], int(match[2])) if match else (variable, 0)
