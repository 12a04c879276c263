"""A withdrawn option ends with exit code 2 and one sentence on what to type in its place."""

import pytest

from tests.command_line import twin
from twin.cli.withdrawn import WITHDRAWN_OPTIONS


@pytest.mark.parametrize(("command", "option"), WITHDRAWN_OPTIONS)
def test_a_withdrawn_option_is_refused_with_what_to_type_in_its_place(command: str, option: str, tmp_path):
    first = [command, "file"] if command else []
    for words in ([option], [option, "x"], [f"{option}=x"]):
        refused = twin(*first, *words, cwd=tmp_path)
        assert refused.returncode == 2 and not refused.stdout and not list(tmp_path.iterdir())
        name = f"twin {command}".strip()
        assert refused.stderr == f"{name}: {option} is no longer an option; {WITHDRAWN_OPTIONS[command, option]}\n"


def test_a_withdrawn_option_is_in_no_help(tmp_path):
    for command, option in WITHDRAWN_OPTIONS:
        assert option not in twin(*command.split(), "--help", cwd=tmp_path).stdout


def test_a_branch_takes_no_other_drive(tmp_path):
    refused = twin("branch", "results/run", "--at", "6", "--drive", "xl330", cwd=tmp_path)
    instead = "type twin run EXPERIMENT --drive FMU, a run with it from the start"
    assert refused.returncode == 2
    assert refused.stderr == f"twin branch: --drive is no longer an option; {instead}\n"
