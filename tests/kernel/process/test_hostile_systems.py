"""What an FMU of an SSP can do to `twin cosim`: by default nothing but the run is lost."""

from pathlib import Path

import pytest

from tests.command_line import twin
from tests.kernel.process.hostile import HANG, HANG_IN_INITIALISATION, SEGFAULT
from tests.kernel.systems.archives import archive, component, structure, system, values


@pytest.mark.slow
@pytest.mark.parametrize(
    ("attack", "code", "told"),
    [
        (SEGFAULT, 3, "hostile.fmu (bad) crashed (SIGSEGV, segmentation fault) in the step from t = 0.999 s"),
        pytest.param(HANG, 3, "hostile.fmu (bad) did not return within 1 s", marks=pytest.mark.endurance),
        pytest.param(
            HANG_IN_INITIALISATION, 2, "hostile.fmu (bad) did not return within 1 s in fmi2ExitInitializationMode",
            marks=pytest.mark.endurance,
        ),
    ],
)  # fmt: skip
def test_an_fmu_that_kills_its_process_is_named(drive: Path, tmp_path: Path, attack: int, code: int, told: str):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    whole = system([component("bad", "hostile.fmu", bindings=values(f"droop={attack}"))])
    file = archive(tmp_path / "x.ssp", structure(whole, 2.0), {"hostile.fmu": drive})
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", str(scratch))
        done = twin("cosim", file, "--out", "run", "--limit-step", "1", cwd=tmp_path, isolated=True)
    assert (done.returncode, done.stdout) == (code, "") and told in done.stderr
    assert not list(scratch.iterdir())
    if code == 3:
        # as far as whole chunks go: so narrow a system fills one in some hundred ticks
        assert "Recorded until then: run/run.mcap.partial (" in done.stderr
        assert (tmp_path / "run" / "run.mcap.partial").is_file()
    else:
        assert not (tmp_path / "run").exists()
