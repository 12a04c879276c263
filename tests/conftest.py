"""What many tests stand on: the repository's files, and the paper's experiment run once."""

import gc
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from hypothesis import settings

from tests.kernel.fmi.eventful import Maker, maker
from tests.machine_code import call_compiled
from tests.warm import WarmStart
from twin.kernel import cache_folder
from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute

call_compiled()
ROOT = Path(__file__).parents[1]
STRANGER = 1234
"""Another user."""
# it colours the message of each form of a function that it tries in vain, a tenth of what compiling takes here
os.environ.setdefault("NUMBA_DISABLE_ERROR_MESSAGE_HIGHLIGHTING", "1")
USUAL = 100
"""Examples of a property."""

# Loading a compiled function for the first time takes longer than hypothesis grants one example. Everywhere the same
# examples are drawn; `make endurance` draws new ones, twenty times as many, which its seed draws again.
settings.register_profile("same", deadline=None, max_examples=USUAL, derandomize=True)
settings.register_profile("endurance", deadline=None, max_examples=20 * USUAL, database=None)
settings.load_profile("same")


# a shell starts what runs in its background deaf to Ctrl-C, and what that starts inherits it
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


LONG = (
    "studies/shadow/test_fleet.py", "docs/test_code_blocks.py", "browser/explore",
    "laws/test_state_combinations.py", "studies/identify/test_identification.py", "studies/faults/test_trials.py",
    "docs/test_tutorial.py", "studies/check/test_baselines.py", "laws/test_state.py", "cli/test_examples.py",
    "kernel/process", "studies/shadow", "studies/sweep", "studies/identify", "studies/build", "docs", "cli",
    "installed", "browser", "coupling", "fmu", "cli/test_without_numba.py",
)  # fmt: skip
"""Files and rooms that take longest: they go first, so that no process has one left to do when the others are done. The
last of them goes when others have had compiled what it would have compiled."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What is in `LONG` in its order, then all others."""
    order = {ROOT / "tests" / name: place for place, name in enumerate(LONG)}

    def place(item: pytest.Item) -> int:
        # a file before its room
        return next((order[path] for path in (item.path, *item.path.parents) if path in order), len(LONG))

    items.sort(key=place)


def pytest_collection_finish() -> None:
    """What is there now stays; to look through it for garbage again and again takes a tenth of the tests' time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


def examples(count: int, **options: Any) -> settings:
    """Settings of a test that affords `count` examples where others have a hundred; more in `make endurance`."""
    drawn = settings().max_examples
    return settings(max_examples=count * drawn // USUAL, **options)


@pytest.fixture(scope="session", autouse=True)
def warm_start() -> Iterator[None]:
    """Guarded processes do not import anew what all of them import."""
    with mock.patch("twin.kernel.process.process.Popen", WarmStart()):
        yield


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT


@pytest.fixture(params=["faked", "real"] if os.name == "posix" and os.geteuid() == 0 else ["faked"])
def give_away(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """Makes a file, folder or link another user's: in truth, which only root can, or in the eyes of the cache."""
    given: set[tuple[int, ...]] = set()

    def known(found: os.stat_result) -> tuple[int, ...]:
        # with the time: a disk uses the numbers of what was deleted again
        return found.st_dev, found.st_ino, found.st_mtime_ns

    if request.param == "real":
        return lambda path: os.lchown(path, STRANGER, STRANGER)
    monkeypatch.setattr(cache_folder, "_owner", lambda found: STRANGER if known(found) in given else found.st_uid)
    return lambda path: given.add(known(path.lstat()))


@pytest.fixture(scope="session")
def shaft(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Maker:
    """Makes drives of one binary with events, clocks and tricks; see `eventful_drive`."""
    return maker(root, tmp_path_factory.mktemp("eventful"))


@pytest.fixture(scope="session")
def force_position(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Fig. 4 under force-position control."""
    return _ran("fig4_force_position", tmp_path_factory)


@pytest.fixture(scope="session")
def position(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Fig. 4 under position control alone."""
    return _ran("fig4_position", tmp_path_factory)


@pytest.fixture(scope="session")
def imperfect(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recording, Recording]:
    """Both again, on a tilted scale and with encoders off zero."""
    return _ran("fig4_imperfect", tmp_path_factory), _ran("fig4_imperfect_position", tmp_path_factory)


def _ran(name: str, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    experiment = load_experiment(ROOT / "experiments" / f"{name}.toml")
    return read(execute(experiment, tmp_path_factory.mktemp(name)).recording)
