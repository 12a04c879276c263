import ast
from pathlib import Path

import pytest

from tests.house import ASKED, circles, imports, measures, statements


@pytest.mark.parametrize(
    "arrows, expected",
    [
        ({"a": {"b"}, "b": {"c"}, "c": set()}, []),
        ({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}, [{"a", "b", "c"}]),
    ],
)
def test_a_circle_is_what_leads_back_to_itself(arrows: dict[str, set[str]], expected: list[set[str]]) -> None:
    assert circles(arrows) == expected


def test_docstrings_are_no_statements() -> None:
    assert statements(ast.parse('"""Text."""\ndef f():\n    """Text."""\n    return 1\n')) == 2


def test_imports_inside_functions_and_of_names_count() -> None:
    modules = dict.fromkeys(("p", "p.a", "p.b", "p.c"))
    tree = ast.parse("import numpy\nfrom p import a\ndef f():\n    from p.b import name\n    import p.c\n")
    assert imports("p.x", tree, modules) == {"p.a", "p.b", "p.c"}


def test_every_measure_of_a_package_is_counted(tmp_path: Path) -> None:
    package = tmp_path / "p"
    for name, text in {
        "__init__": "",
        "one": "import p.room.a\n\n\nX = 1\n",
        "room/__init__": "",
        "room/a": "from p.room import b\n",
        "room/b": "def f():\n    import p.room.a\n",
    }.items():
        path = package / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    found = {row.name: row.now for row in measures(package, 5)}
    assert list(found) == [name for name, *_ in ASKED]
    assert list(found.values()) == [7, 5, 3, 2, 1, 5, 1, 2, 1]
