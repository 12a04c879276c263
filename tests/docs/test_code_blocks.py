"""Every code block of the README and of docs/ does what the page says."""

from importlib.util import find_spec
from typing import Any

import pytest

from tests.conftest import ROOT
from tests.docs.code_blocks import PROSE, blocks, pages
from tests.docs.workshop import Workshop

LANGUAGES = ("python", "sh", "toml", "c", *PROSE)
ELSEWHERE = ("docs/tutorial.md", "docs/seven_questions.md")
"""Pages run by test_tutorial, in an environment of its own, and by test_seven_questions."""
WITH_CODE = [
    page
    for page in pages(ROOT)
    if page not in ELSEWHERE and any(block.language not in PROSE for block in blocks(ROOT, page))
]


@pytest.fixture(scope="module")
def recorded_workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    workshop = Workshop(ROOT, tmp_path_factory.mktemp("workshop"))
    workshop.twin("run", "experiments/fig4_force_position.toml", "experiments/fig4_position.toml")
    return workshop


@pytest.mark.parametrize("page", pages(ROOT))
def test_every_block_says_its_language(page: str):
    assert [block.place for block in blocks(ROOT, page) if block.language not in LANGUAGES] == []


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_CODE)
def test_the_code_of_a_page_runs(page: str, recorded_workshop: Workshop):
    namespace: dict[str, Any] = {"__name__": "__page__"}
    for block in blocks(ROOT, page):
        if block.remark != "slow":
            recorded_workshop.run(block, namespace)


@pytest.mark.endurance
@pytest.mark.parametrize("page", WITH_CODE)
def test_the_slow_code_of_a_page_runs(page: str, recorded_workshop: Workshop):
    for block in blocks(ROOT, page):
        if block.remark == "slow":
            if "--platform" in block.text and find_spec("ziglang") is None:
                pytest.skip("no compiler for other platforms: pip install .[fmus]")
            recorded_workshop.run(block, {})
