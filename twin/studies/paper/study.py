"""The claims of the paper judged from recordings: picture and facts."""

from collections.abc import Sequence
from pathlib import Path

from twin.kernel.errors import InputRefused
from twin.kernel.recording.folder import recording_in
from twin.kernel.recording.reader import Recording, read
from twin.studies.answer import judged
from twin.studies.paper.fig4 import fig4_score
from twin.studies.paper.fig4_measures import draw_fig4, fig4_runs
from twin.studies.paper.fig5 import fig5_score
from twin.studies.paper.fig5_picture import draw_fig5
from twin.studies.paper.text import fig4_result, fig5_result
from twin.studies.result import Result

FIG4_EXPERIMENTS = ("fig4_force_position", "fig4_position", "fig4_imperfect", "fig4_imperfect_position")
FIG5_EXPERIMENTS = ("pressing", "tapping", "rolling", "pushing")
FIGURE_EXPERIMENTS = {"fig4": FIG4_EXPERIMENTS, "fig5": FIG5_EXPERIMENTS}
HOME = Path("results")


def score_fig4(paths: Sequence[Path], out: Path | None) -> Result:
    """Which claims of Fig. 4 hold in recordings, and files in `out`, or results/fig4.

    Exit code 1: a claim fails, or cannot be scored because a run lacks a series.

    Args:
        paths: runs, in the order of `FIG4_EXPERIMENTS`, the first two or all; none: the latest in results/.
        out: folder; None: results/fig4.

    Raises:
        InputRefused: other runs, or what they hold or the folder cannot be used.
        NotWritten: the disk refuses.
    """
    paths = paths or _latest("fig4")
    if len(paths) not in (2, 4):
        raise InputRefused(
            f"--paper fig4: got {len(paths)} run{'s' * (len(paths) != 1)}, expected two: the run with force control, "
            f"then the one without; or four: {', '.join(FIG4_EXPERIMENTS)}"
        )
    recordings = _recordings(paths)
    runs = fig4_runs(*recordings)
    score = fig4_score(runs)
    notes = [*(recording.note for recording in recordings if recording.note), *_deviations(recordings)]
    return judged("fig4", out or HOME / "fig4", fig4_result(score), lambda path: draw_fig4(runs, path), notes)


def score_fig5(paths: Sequence[Path], out: Path | None) -> Result:
    """Which claims of Fig. 5 hold in recordings, and files in `out`, or results/fig5.

    Exit code 1: a claim fails.

    Args:
        paths: runs of tasks; none: the latest of `FIG5_EXPERIMENTS` in results/.
        out: folder; None: results/fig5.

    Raises:
        InputRefused: what the runs hold or the folder cannot be used.
        NotWritten: the disk refuses.
    """
    recordings = _recordings(paths or _latest("fig5"))
    score = fig5_score(recordings)
    notes = _deviations(recordings)
    return judged("fig5", out or HOME / "fig5", fig5_result(score), lambda path: draw_fig5(score, path), notes)


def _deviations(recordings: Sequence[Recording]) -> list[str]:
    return [
        f"{recording.path}: {text}"
        for recording in recordings
        for text in (*recording.deviations, *recording.other_parts)
    ]


def _latest(figure: str) -> list[Path]:
    paths = [HOME / name for name in FIGURE_EXPERIMENTS[figure]]
    missing = [path.name for path in paths if not path.exists()]
    if missing:
        files = " ".join(f"experiments/{name}.toml" for name in missing)
        raise InputRefused(f"--paper {figure}: no run of {', '.join(missing)} in results/; first: twin run {files}")
    return paths


def _recordings(paths: Sequence[Path]) -> list[Recording]:
    return [read(recording_in(path)) for path in paths]
