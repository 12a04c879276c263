from pathlib import Path

import numpy as np
import pytest

from . import samples


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample recording, finished; not to be written to."""
    return samples.finished(tmp_path_factory.mktemp("finished") / "sample.mcap")


@pytest.fixture(scope="session")
def unfinished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample recording, abandoned at its end; not to be written to."""
    return samples.unfinished(tmp_path_factory.mktemp("unfinished") / "sample.mcap")


@pytest.fixture(scope="session")
def truth() -> dict[str, np.ndarray]:
    """What is in both."""
    return samples.truth()
