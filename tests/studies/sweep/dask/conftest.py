"""A cluster of two workers for all that does not break it, and short sweeps."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.studies.sweep.dask.running import Running, running


@pytest.fixture(scope="package")
def cluster(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """Two workers. Nobody may break it; what a test starts in it, the test ends."""
    with running(root, tmp_path_factory.mktemp("cluster"), 2) as cluster:
        yield cluster
