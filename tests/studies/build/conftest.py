"""Plant and computer of Fig. 4, built once."""

from collections.abc import Callable
from pathlib import Path

import pytest

from twin.kernel.compiled.machine import Module
from twin.studies.build import linking as emission
from twin.studies.build.fmu import build_fmu
from twin.studies.build.linking import EmittedStep, Platform, ProcessorForm, emit_step

ROOT = Path(__file__).parents[3]
FIG4 = ROOT / "experiments" / "fig4_force_position.toml"
MASSAGE = ROOT / "experiments" / "massage.toml"
DELAYED = ("controller.delay_ticks=3", "plant.encoder_latency_ms=2")
"""A computer with two rings of memory."""
MODULES: dict[tuple[str, str], str] = {}
"""LLVM's assembly of all steps that were built, by their symbols and platforms."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What builds starts a compiler."""
    for item in items:
        if Path(__file__).parent in item.path.parents and "built" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)


def silent(what: str) -> None:
    """Hears what is being done."""


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Builds a part: `built("plant")`, once for each; steps that parts share are emitted once."""
    folder, done = tmp_path_factory.mktemp("built"), dict[tuple[object, ...], Path]()
    steps: dict[tuple[Module, str, str], EmittedStep] = {}

    def kept(step: Module, platform: Platform, form: ProcessorForm) -> EmittedStep:
        key = step, platform.name, form.suffix
        if key not in steps:
            steps[key] = emit_step(step, platform, form)
        MODULES[steps[key].symbol, platform.name] = steps[key].text
        return steps[key]

    def build(
        part: str,
        fmi: str = "2.0",
        settings: tuple[str, ...] = (),
        experiment: str = str(FIG4),
        platforms: tuple[str, ...] = (),
    ) -> Path:
        key = part, fmi, settings, experiment, platforms
        if key not in done:
            file = folder / f"{len(done)}" / f"{part}.fmu"
            file.parent.mkdir()
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(emission, "emit_step", kept)
                build_fmu(Path(experiment), part, fmi, platforms, file, settings, silent)
            done[key] = file
        return done[key]

    return build
