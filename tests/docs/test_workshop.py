"""What runs the code of the pages notices code that does not do what its page says."""

from pathlib import Path

import pytest

from tests.docs.code_blocks import Block, blocks
from tests.docs.workshop import Workshop

PAGE = """
<!-- slow -->
```sh
twin faults a.toml
```

```python
# jobs.py
x = 1
```

- a list
  ```
  bare
  ```
"""


@pytest.fixture(scope="module")
def workshop(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop(root, tmp_path_factory.mktemp("workshop"))


def block(language: str, text: str, remark: str = "") -> Block:
    return Block("page.md", 1, language, text, remark)


def test_blocks_are_found_with_line_language_remark_and_file_name(tmp_path: Path):
    (tmp_path / "page.md").write_text(PAGE)
    found = blocks(tmp_path, "page.md")
    assert [(b.line, b.language, b.remark, b.file_name) for b in found] == [
        (3, "sh", "slow", ""),
        (7, "python", "", "jobs.py"),
        (13, "", "", ""),
    ]


def test_a_long_command_goes_on_and_may_say_how_it_ends():
    commands = block("sh", "twin drive check a \\\n    b\n\ntwin run x.toml   # exit 2\n").commands
    assert commands == [("twin drive check a      b", 0), ("twin run x.toml", 2)]


@pytest.mark.parametrize(
    ("language", "text", "remark"),
    [
        ("sh", "false", ""),
        ("sh", "true   # exit 2", ""),
        ("sh", "false; true", ""),
        ("sh", "make nothing_of_the_kind", ""),
        ("sh", "pip install -c nowhere.txt -e .", ""),
        ("sh", "pip install .[no,such]", ""),
        ("sh", "twin run x.toml --no-such-option", "not run: takes for ever"),
        ("sh", "rm -rf results", "not run: only twin can be left out"),
        ("toml", "[monitor]\nforce_limit_N = 12.0\n", ""),
        ("python", "assert 1 + 1 == 3", ""),
    ],
)
def test_code_that_does_not_do_what_the_page_says_fails(workshop: Workshop, language: str, text: str, remark: str):
    with pytest.raises(AssertionError):
        workshop.run(block(language, text, remark), {})


def test_a_refusal_is_held_to_the_text_after_it(workshop: Workshop):
    refused = block("sh", "twin run nowhere.toml   # exit 2\n")
    workshop.run(refused, {})
    workshop.run(block("text", "nowhere.toml: no such experiment file\n"), {})
    workshop.run(refused, {})
    with pytest.raises(AssertionError, match="not what the commands before it say"):
        workshop.run(block("text", "nowhere.toml: all is well\n"), {})


def test_commands_that_are_not_run_have_options_that_exist(workshop: Workshop):
    workshop.run(block("sh", "twin drive check a.fmu --table\n", "not run: no such FMU"), {})


def test_python_blocks_of_a_page_share_their_names(workshop: Workshop):
    namespace: dict[str, object] = {}
    workshop.run(block("python", "x = 1"), namespace)
    workshop.run(block("python", "assert x == 1"), namespace)
