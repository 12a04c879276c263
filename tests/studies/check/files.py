"""Experiments of somebody else's, which extend one of the repository."""

from pathlib import Path


def step_file(root: Path, file: Path, more: str = "") -> Path:
    """Write the step in the air to `file`, with `more` laid over it."""
    file.write_text(f'extends = "{root}/experiments/step_z_air.toml"\ntitle = "mine"\n{more}\n')
    return file
