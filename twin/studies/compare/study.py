"""`twin compare`: comparison of two logs within a tolerance tube, or of runs with the paper's claims."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from twin.kernel.errors import InputRefused
from twin.studies.command import Argument, ArgumentValues, FromS, Option, Say, ToS, study, write_verdict
from twin.studies.precheck import find_logs, print_latest
from twin.studies.result import Result

RESULTS_FOLDER = Path("results") / "compare"
PAPER_FIGURES = ("fig4", "fig5")


def _print_latest(asked: ArgumentValues) -> dict[str, Any]:
    """Print which runs the comparison reads as the latest, also if the command line names no run."""
    if asked["paper"] is not None and not asked["runs"]:
        from twin.studies.paper.study import FIGURE_EXPERIMENTS
        from twin.studies.paper.study import RESULTS_FOLDER as RESULTS

        asked = {"runs": [RESULTS / name for name in FIGURE_EXPERIMENTS.get(asked["paper"], ())]}
    return print_latest(asked)


@study(draws=True, before=[find_logs, _print_latest])
def compare(
    say: Say,
    runs: Annotated[
        Sequence[Path],
        Argument(
            "A recording (its folder, its .mcap file, results/EXPERIMENT), another MCAP file or a CSV file. With "
            "--paper: fig4: the run with force control, then the one without, then the same two of the imperfect robot "
            "for the forces in x; fig5: any runs of tasks; default: the figure's latest runs in results/.",
            "A B",
        ),
    ] = (),
    paper: Annotated[str | None, Option("Score runs against the paper: fig4 or fig5.", "FIGURE")] = None,
    signals: Annotated[
        Sequence[str], Option("Signal to compare, with wildcards * and ?; may be repeated.", "NAME", "--signal")
    ] = (),
    tolerances: Annotated[
        Sequence[str], Option("2%@4ms (the default), NAME=0.05N, NAME=0.1mm@10ms, FILE.toml.", "RULE", "--tol")
    ] = (),
    maps: Annotated[Sequence[str], Option("Column of a log: NAME=[-]COLUMN[UNIT], or FILE.toml.", "MAP", "--map")] = (),
    align: Annotated[str, Option("Time of B: none, start, event or fit.", "HOW")] = "none",
    by: Annotated[str, Option("Signal to align by, for event and fit.", "NAME")] = "",
    max_shift: Annotated[float, Option("Largest shift of fit, in s.", "S")] = 1.0,
    partial: Annotated[bool, Option("Allow B to cover only a part of A's time.")] = False,
    from_s: FromS = None,
    to_s: ToS = None,
    out: Annotated[Path | None, Option("Folder; default: results/compare, or results/FIGURE.", "DIR")] = None,
) -> Result:
    """Compare B with A within a tolerance tube, or runs with a figure of the paper.

    B agrees with A where, within the tolerance in time, it comes within the
    tolerance in value of A. See docs/compare.md, and docs/compare_reference.md
    for columns, units, tolerances and alignment.

    Exit code: 0 inside, or no claim fails; 1 outside, or B lacks a part of A's
    time (without --partial), or a claim fails or cannot be scored; 2 refused;
    3 not written.

    Example: twin compare --paper fig4 results/fig4_force_position results/fig4_position
    """
    if paper is not None:
        if paper not in PAPER_FIGURES:
            raise InputRefused(f"--paper {paper}: expected one of {', '.join(PAPER_FIGURES)}")
        if signals or tolerances or maps or partial or align != "none" or (from_s, to_s) != (None, None):
            raise InputRefused(
                f"--paper {paper}: takes no --signal, --tol, --map, --align, --partial, --from-s, --to-s; claims have "
                "bounds"
            )
        from twin.studies.paper.study import score_fig4, score_fig5

        return (score_fig4 if paper == "fig4" else score_fig5)(runs, out)
    if len(runs) != 2:
        raise InputRefused(
            f"twin compare: got {len(runs)} path{'s' * (len(runs) != 1)}, expected A and B, or --paper FIGURE"
        )
    from twin.studies.compare.comparison import compare_logs, experiments_differ, read_logs
    from twin.studies.compare.picture import draw_comparison
    from twin.studies.compare.text import comparison_result
    from twin.studies.compare.tolerance import alignment, rules

    logs = read_logs(runs[0], runs[1], maps, (from_s, to_s))
    found = compare_logs(*logs, rules(tolerances), signals, alignment(align, by, max_shift))
    result = comparison_result(found, partial, experiments_differ(found.a, found.b))
    return write_verdict("compare", out or RESULTS_FOLDER, result, lambda path: draw_comparison(found, path))
