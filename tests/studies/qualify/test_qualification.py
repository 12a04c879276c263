"""An FMU that crashes in what no experiment needs costs those checks only."""

import json
from pathlib import Path

import pytest

from tests.command_line import twin
from tests.kernel.fmi.compiled import compiled_drive

CRASH = "*(volatile int *)8 = 1; "


def crashing(function: str):
    """An edit of lifecycle.c: the beginning of `function` crashes."""

    def edit(text: str) -> str:
        head, name, rest = text.partition(f"{function}(fmi2Component c)")
        before, brace, after = rest.partition("{")
        return "#include <signal.h>\n" + head + name + before + brace + " signal(SIGSEGV, SIG_DFL); " + CRASH + after

    return edit


@pytest.mark.slow
@pytest.mark.parametrize(("function", "noted"), [("fmi2Reset", {"reset"}), ("fmi2FreeInstance", {"reset", "state"})])
def test_a_crash_in_reset_or_when_it_is_freed_does_not_disqualify(
    root: Path, tmp_path: Path, function: str, noted: set[str]
):
    fmu = compiled_drive(root, tmp_path, "fragile", {"lifecycle.c": crashing(function)})
    done = twin("drive", "check", fmu, "--json", cwd=tmp_path, isolated=True)
    assert done.returncode == 0, done.stderr
    checks = json.loads(done.stdout)["checks"]
    assert {name for name, check in checks.items() if check["verdict"] == "note"} == noted
    for name in noted:
        assert checks[name]["detail"].startswith(
            "fragile.fmu (drive) crashed (SIGSEGV, segmentation fault) in " + function
        )
