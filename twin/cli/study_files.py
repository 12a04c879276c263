"""Where the studies are that are commands: nothing but their files says so."""

from pathlib import Path

FOLDER = Path(__file__).parents[1] / "studies"
MARK = "\n@study("


def study_file(name: str) -> Path | None:
    """Where the study that is the command `name` is, if there is one."""
    return next((file for file in (FOLDER / name / "study.py", FOLDER / f"{name}.py") if _is_study(file)), None)


def study_names() -> list[str]:
    """All studies that are commands, by the alphabet."""
    files = [*FOLDER.glob("*/study.py"), *FOLDER.glob("*.py")]
    return sorted(file.parent.name if file.stem == "study" else file.stem for file in files if _is_study(file))


def _is_study(file: Path) -> bool:
    return file.exists() and MARK in file.read_text("utf-8")
