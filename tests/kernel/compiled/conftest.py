import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from twin.kernel.compiled import source, store

SOURCE = Path(__file__).parents[3] / "twin"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package of the same name whose modules can be edited."""
    folder = tmp_path / "twin"
    (folder / "deep").mkdir(parents=True)
    shutil.copytree(SOURCE / "kernel", folder / "kernel", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(SOURCE / "__init__.py", folder)
    (folder / "deep" / "__init__.py").write_text("")
    (folder / "deep" / "kernel.py").write_text("from twin.deep.part import (\n    x,\n)\nfrom twin.deep import far\n")
    (folder / "deep" / "part.py").write_text("def f():\n    import twin.deep.lazy as l\n\n\nx = y = 1\n")
    (folder / "deep" / "far.py").write_text("a = 1\n")
    (folder / "deep" / "lazy.py").write_text("a = 1\n")
    (folder / "deep" / "other.py").write_text("a = 1\n")
    monkeypatch.setattr(source, "PACKAGE_FOLDER", folder)
    yield folder
    forget()


def forget() -> None:
    """What was read of source, as a new process would not have it."""
    store._sources.cache_clear()
    source.source_file.cache_clear()
