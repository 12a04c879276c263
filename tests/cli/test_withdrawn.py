"""A withdrawn option ends with exit code 2 and one sentence on what to type in its place."""

import pytest

from tests.command_line import twin
from twin.cli.withdrawn import WITHDRAWN


@pytest.mark.parametrize(("command", "option"), WITHDRAWN)
def test_a_withdrawn_option_is_refused_with_what_to_type_in_its_place(command: str, option: str, tmp_path):
    for words in ([option, "x"], [f"{option}=x"]):
        refused = twin(command, "file", *words, cwd=tmp_path)
        assert refused.returncode == 2 and not refused.stdout and not list(tmp_path.iterdir())
        assert refused.stderr == f"twin {command}: {option} is no longer an option; {WITHDRAWN[command, option]}\n"
