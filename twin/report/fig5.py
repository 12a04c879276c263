"""Fig. 5."""

from pathlib import Path
from twin.paper.fig5_score import Fig5Score


def draw_fig5(score: Fig5Score, path: Path) -> None:
    path.write_bytes(b"")
