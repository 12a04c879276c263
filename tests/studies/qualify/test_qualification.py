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
@pytest.mark.parametrize(
    ("function", "noted"), [("fmi2Reset", {"reset"}), ("fmi2FreeInstance", {"reset", "state", "written"})]
)
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


LIES = {
    "SetFMUstate": ("memcpy(&slave->state, saved, sizeof(State));", "(void)saved;", {"state", "written"}),
    "DeSerializeFMUstate": (
        "return keep(c, &state, saved);",
        "return keep(c, &((const Slave *)c)->state, saved);",
        {"written"},
    ),
}
"""What an FMU that lies does in place of bringing its state back, and what notices it."""


@pytest.mark.slow
@pytest.mark.parametrize("function", LIES)
def test_an_fmu_whose_state_does_not_come_back_counts_as_one_without(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, function: str
):
    honest, lie, noted = LIES[function]

    def edit(text: str) -> str:
        assert honest in text
        return text.replace(honest, lie)

    fmu = compiled_drive(root, tmp_path, "liar", {"fmu_state.c": edit})
    before = twin("run", "fig4_force_position", "--drive", fmu, *SHORT, "--out", tmp_path / "before", cwd=tmp_path)
    done = twin("drive", "check", fmu, "--json", cwd=tmp_path, isolated=True)
    checks = json.loads(done.stdout)["checks"]
    assert {name for name in ("state", "written") if checks[name]["verdict"] == "note"} == noted
    assert checks["written"]["detail"].startswith("it continues differently from a restored state")
    after = twin("run", "fig4_force_position", "--drive", fmu, *SHORT, "--out", tmp_path / "after", cwd=tmp_path)
    sentence = "no state is saved: liar.fmu (drive_1) continues differently after a saved state is restored"
    assert sentence not in " ".join(before.stdout.split()) and sentence in " ".join(after.stdout.split())
    done = twin("run", "--from", tmp_path / "after", "--out", tmp_path / "again", cwd=tmp_path)
    assert done.returncode == 0 and "run again from the start" in done.stdout


SHORT = ("--set", "duration_s=0.2", "--set", "recording.states_s=[0.1]")
