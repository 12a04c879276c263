import ast
from pathlib import Path

import pytest

from tests.house import IDEAS, MEASURES, circles, found, imports, late_constants, measures, sources, titles


@pytest.mark.parametrize(
    "arrows, expected",
    [
        ({"a": {"b"}, "b": {"c"}, "c": set()}, []),
        ({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}, [{"a", "b", "c"}]),
    ],
)
def test_a_circle_is_what_leads_back_to_itself(arrows: dict[str, set[str]], expected: list[set[str]]) -> None:
    assert circles(arrows) == expected


def test_imports_inside_functions_and_of_names_count() -> None:
    modules = dict.fromkeys(("p", "p.a", "p.b", "p.c"))
    tree = ast.parse("import numpy\nfrom p import a\ndef f():\n    from p.b import name\n    import p.c\n")
    assert imports("p.x", tree, modules) == {"p.a", "p.b", "p.c"}


def test_a_title_is_a_paragraph_of_one_short_sentence() -> None:
    text = """
    Gains of a loop: P and I.

    A filter of second order,
    with three outputs.

    Text of two sentences. It explains.

    The law is:

        e = a - b

    - an item

    A sentence that goes on {}.
    """.replace("{}", "and on " * 30)
    tree = ast.parse(f'"""{text}"""')
    assert titles(tree) == ["Gains of a loop: P and I.", "A filter of second order, with three outputs."]


def test_constants_below_the_first_definition_count() -> None:
    tree = ast.parse("A = 1\ndef f():\n    B = 2\nC, D = 3, 4\nE: int = 5\nname = 6\n")
    assert late_constants(tree) == ["C", "D", "E"]


def test_a_type_of_a_folder_is_that_of_no_other_one(tmp_path: Path) -> None:
    modules = sources(
        _package(tmp_path, {"run/a": "class Outcome: ...\n", "other/a": "class Outcome: ...\nRuns = 1\n"})
    )
    types = IDEAS[0]._replace(types="run.Outcome Runs")
    assert found(types, modules) == ["run.a.Outcome", "other.a.Runs"]


def test_every_measure_of_a_package_is_counted(tmp_path: Path) -> None:
    files = {
        "__init__": "",
        "one": '"""A.\n\nB.\n\nC.\n"""\nclass FaultTrial: ...\nX = 1\nY_MAX = 1\n',
        "room/a": "from p.room import b\nclass Trials: ...\nclass Runs:\n    def held(): ...\n"
        "class Apart:\n    MOST = 1\n",
        "room/b": "def f():\n    import p.room.a\n",
    }
    rows = {row.name: row.now for row in measures(sources(_package(tmp_path, files)), 5)}
    assert list(rows) == [*(one.name for one in IDEAS), *(name for name, *_ in MEASURES)]
    assert list(rows.values()) == [1, 0, 2, 0, 0, 0, 0, 1, 1, 2, 1, 2, 5, 1, 17]


def _package(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = folder / "p" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder / "p"
