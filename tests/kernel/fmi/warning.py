"""A drive that logs a warning in one step."""

from pathlib import Path

from tests.kernel.fmi.compiled import compiled_drive

STEP = "fmi2Status fmi2DoStep("


def warning_drive(root: Path, folder: Path, time: float) -> Path:
    """An FMU that says `the winding is hot` in the step that begins at `time` (s)."""

    def edit(text: str) -> str:
        assert STEP in text
        shim = (
            f"\n{STEP}fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean b)\n{{\n"
            f"    Slave *slave = c;\n    if (t > {time} - h / 2 && t < {time} + h / 2)\n"
            '        slave->logger(slave->environment, slave->name, fmi2Warning, "logStatusWarning",'
            ' "the winding is hot");\n    return quiet_step(c, t, h, b);\n}\n'
        )
        return text.replace(STEP, "static fmi2Status quiet_step(") + shim

    return compiled_drive(root, folder, "warning", {"lifecycle.c": edit})
