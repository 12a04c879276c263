"""Completion as a shell asks for it."""

import os
from pathlib import Path

import pytest

from tests.command_line import twin


def offered(line: str, cwd: Path) -> list[str]:
    words = line.split(" ")
    asked = {"_TWIN_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    return twin(cwd=cwd, env=os.environ | asked).stdout.split()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("twin sch", ["schema"]),
        ("twin drive l", ["list"]),
        ("twin run experiments/fig4_", [f"experiments/fig4_{name}.toml" for name in ("force_position", "imperfect")]),
        ("twin run experiments/pressing.toml --drive pm", ["pmsm_foc"]),
        ("twin drive check st", ["stepper"]),
        ("twin run experiments/pressing.toml --body b", ["back", "belly"]),
        ("twin run experiments/pressing.toml --set controller.force.k", ["controller.force.ki_mm_per_N_s="]),
        ("twin run experiments/nowhere.toml --set contr", []),
        ("twin init --from ta", ["tapping"]),
    ],
)
def test_the_shell_offers_what_there_is(root: Path, line: str, words: list[str]):
    found = offered(line, root)
    assert found[: len(words)] == words and bool(found) == bool(words)
