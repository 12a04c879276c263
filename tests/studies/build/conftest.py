"""Plant and computer of Fig. 4, built once."""

from collections.abc import Callable
from pathlib import Path

import pytest

from twin.studies.build import fmu
from twin.studies.build.emission import Emitted, emitted
from twin.studies.build.study import build_fmu

ROOT = Path(__file__).parents[3]
FIG4 = ROOT / "experiments" / "fig4_force_position.toml"
MASSAGE = ROOT / "experiments" / "massage.toml"
DELAYED = ("controller.delay_ticks=3",)
"""A computer with a ring of memory."""
MODULES: dict[str, str] = {}
"""LLVM's assembly of all steps that were built, by their symbols."""


def silent(what: str) -> None:
    """Hears what is being done."""


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Builds a part: `built("plant")`, once for each; steps that parts share are emitted once."""
    folder, done = tmp_path_factory.mktemp("built"), dict[tuple[object, ...], Path]()
    steps: dict[tuple[object, str], Emitted] = {}

    def kept(step: object, symbol: str) -> Emitted:
        if (step, symbol) not in steps:
            steps[step, symbol] = emitted(step, symbol)  # type: ignore[arg-type]
            MODULES[symbol] = steps[step, symbol].text
        return steps[step, symbol]

    def build(part: str, fmi: str = "2.0", settings: tuple[str, ...] = (), experiment: str = str(FIG4)) -> Path:
        key = part, fmi, settings, experiment
        if key not in done:
            file = folder / f"{len(done)}" / f"{part}.fmu"
            file.parent.mkdir()
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(fmu, "emitted", kept)
                build_fmu(Path(experiment), part, fmi, file, settings, silent)
            done[key] = file
        return done[key]

    return build
