"""Compiled functions are named after the code that they reach, whatever stands in its comments and docstrings."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.kernel.compiled.conftest import forget
from twin.kernel.compiled import store
from twin.kernel.compiled.source import parse_source
from twin.kernel.compiled.store import name_of, source_digest


def digest(module: str = "twin.deep.kernel") -> str:
    forget()
    return source_digest(module)


@pytest.mark.parametrize("name", ["kernel", "part", "far", "lazy"])
def test_an_edit_of_whatever_it_reaches_gives_another_name_and_back(package: Path, name: str):
    before = digest()
    file = package / "deep" / f"{name}.py"
    text = file.read_text()
    file.write_text(f"{text}a = 2\n")
    assert digest() != before
    file.write_text(text)
    assert digest() == before


def test_what_it_does_not_reach_does_not_count(package: Path):
    before = digest()
    (package / "deep" / "other.py").write_text("a = 2\n")
    (package / "deep" / "new.py").write_text("a = 2\n")
    assert digest() == before != digest("twin.deep.other")


def test_every_module_that_a_compiled_one_imports_is_reached(root: Path):
    # else a constant frozen into machine code could change without a new name
    code = (
        "import sys; from twin.kernel.compiled import source, store\n"
        "import twin.robot.plant.component, twin.kernel.recording.messages\n"
        "seen = []; read = source.Sources.source\n"
        "source.Sources.source = lambda self, m: (seen.append(m), read(self, m))[1]\n"
        "store.source_digest('twin.robot.plant.component', 'twin.kernel.recording.messages')\n"
        "rooms = 'twin.robot.plant', 'twin.robot.mechanism', 'twin.kernel.recording'\n"
        "print(sorted({m for m in sys.modules if m.startswith(rooms)} - set(seen)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    # packages, in which nothing is written
    unseen = [name.replace(".", "/") for name in eval(done.stdout)]
    assert [name for name in unseen if not (root / name / "__init__.py").is_file()] == []


def test_a_part_of_the_users_own_is_known_by_its_file_and_what_that_imports(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_gain.py").write_text("GAIN = 2.0\n")
    (tmp_path / "my_part.py").write_text("import os, my_gain as g\n\n\ndef step(x):\n    return g.GAIN * x\n")
    import my_part

    forget()
    before = name_of(my_part.step, "")
    assert before.startswith("my_part.step-")
    (tmp_path / "my_gain.py").write_text("GAIN = 3.0\n")
    forget()
    assert name_of(my_part.step, "") != before


CODE = '''"""A module."""
from math import sin  # of an angle


@decorated
def f(x: float) -> str:
    """Return it,

    over lines."""
    text = """# no comment"""
    return g(x)  # why


LIMIT = 3.0
"""Of what."""
first, second = (lambda: 1), [
    lambda: 2,
]
'''


@pytest.mark.parametrize(
    "old, new",
    [
        ('"""A module."""', '"""Another\n\nmodule: from nowhere import everything\n"""\n# and a comment'),
        ("  # of an angle", ""),
        ('"""Return it,\n\n    over lines."""', '"Gibt es zurück"'),
        ("  # why", " # warum: äöü"),
        ('"""Of what."""', ""),
        ("\n\n\nLIMIT", "\nLIMIT"),
    ],
)
def test_text_is_no_code(old: str, new: str):
    assert old in CODE
    assert parse_source(CODE.replace(old, new).encode()).digest == parse_source(CODE.encode()).digest
    assert parse_source(CODE.replace(old, new).encode()).imports == (("math", ("sin",)),)


@pytest.mark.parametrize(
    "old, new",
    [
        ("no comment", "other text"),
        ("3.0", "3.5"),
        ("    return", "    x = x\n    return"),
        ("g(x)", "g( x)"),
        ("import sin", "import cos as sin"),
        ("decorated", "adorned"),
    ],
)
def test_code_is_code(old: str, new: str):
    assert old in CODE
    assert parse_source(CODE.replace(old, new).encode()).digest != parse_source(CODE.encode()).digest


def test_what_is_no_python_is_known_by_all_its_bytes():
    assert parse_source(b"\xff = 1") != parse_source(b"\xff = 2") != parse_source(b"x = ")


def test_text_above_a_function_does_not_change_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(tmp_path)
    text = "def made():\n    return (lambda x: x), (\n        lambda x: -x)\n"

    def names() -> list[str]:
        (tmp_path / "my_lambdas.py").write_text(text)
        sys.modules.pop("my_lambdas", None)
        shutil.rmtree(tmp_path / "__pycache__", ignore_errors=True)
        import my_lambdas

        forget()
        return [name_of(one, "") for one in my_lambdas.made()]

    before = names()
    assert before[0] != before[1]
    text = '"""Two\n\nfunctions."""\n\n\n# of one name\n' + text
    assert names() == before


def test_an_unchanged_file_is_parsed_once_on_a_machine(tmp_path: Path, package: Path, monkeypatch: pytest.MonkeyPatch):
    kept = tmp_path / "objects"
    kept.mkdir(0o700)
    monkeypatch.setattr(store, "object_folder", lambda: kept)
    first = digest()
    assert store._sources().parsed > 0
    assert digest() == first and store._sources().parsed == 0
    file = package / "deep" / "far.py"
    file.write_text("# another\n" + file.read_text())
    assert digest() == first and store._sources().parsed == 1
    # what is damaged, or of another layout, is found again
    for content in (
        b"",
        b"nothing",
        store.seal(store.DIGESTS_FILE, b"[1]"),
        store.seal(store.DIGESTS_FILE, b'{"a": 1}'),
    ):
        (kept / store.DIGESTS_FILE).write_bytes(content)
        assert digest() == first and store._sources().parsed > 1


RUN = "run fig4_force_position --set duration_s=1 --set recording.states_s=[0.5] --isolate none --out"


@pytest.mark.slow
def test_a_rewritten_sentence_compiles_nothing_and_a_state_goes_on_but_code_does(tmp_path: Path, root: Path):
    for name in ("twin", "experiments", "fmus"):
        shutil.copytree(root / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    kernel = tmp_path / "twin" / "robot" / "plant" / "contact.py"
    objects = tmp_path / "cache" / "objects"

    def twin(*words: str) -> "subprocess.CompletedProcess[str]":
        env = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "PYTHONPATH": str(tmp_path)}
        env["NUMBA_CACHE_DIR"] = str(tmp_path / "cache")
        return subprocess.run(
            [sys.executable, "-m", "twin", *words], cwd=tmp_path, env=env, capture_output=True, text=True
        )

    first = twin(*RUN.split(), "a")
    assert first.returncode == 0, first.stderr
    compiled = {path.name for path in objects.glob("*.o")}
    text = kernel.read_text("utf-8")
    docstring = json.dumps(text.partition('"""')[2].partition('"""')[0])
    kernel.write_text(f'"""Another sentence."""\n{docstring}\n# and a comment\n{text}', "utf-8")
    done = twin("run", "--from", "a@0.5", "--isolate", "none", "--out", "b")
    assert (done.returncode, {path.name for path in objects.glob("*.o")}) == (0, compiled), done.stderr
    assert "compiling" not in done.stderr
    kernel.write_text(f"{text}\n\nCHANGED = 1\n", "utf-8")
    refused = twin("run", "--from", "a@0.5", "--isolate", "none", "--out", "c")
    assert refused.returncode == 2 and "of another version of twin's code" in refused.stderr
    assert twin(*RUN.split(), "d").returncode == 0
    assert {path.name for path in objects.glob("*.o")} > compiled
