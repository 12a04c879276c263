"""Where the experiments, robots, bodies, drives and baselines are that come with this product."""

from pathlib import Path

PACKAGE = Path(__file__).parent
CARRIED = PACKAGE / "carried"
"""Where a wheel puts them; a clone has no such folder."""

HOME = CARRIED if CARRIED.is_dir() else PACKAGE.parent
"""The folder with experiments/, fmus/ and tests/baselines/, found from anywhere: the repository of a clone, installed
as editable or not at all, else what the wheel carries inside the package."""


def is_clone() -> bool:
    """Whether `HOME` is a repository, with pyproject.toml and tests, and may be written to."""
    return HOME != CARRIED
