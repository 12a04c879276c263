"""`twin safety`: a hazard table, the runs behind each line, and a page for a reviewer."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from twin.kernel.errors import InputRefused
from twin.studies.command import Argument, DriveName, Option, Say, Settings, Steps, study
from twin.studies.result import Block, Note, Result

if TYPE_CHECKING:
    from twin.studies.safety.evidence import HazardLine
    from twin.studies.safety.hazards import SafetyTable
    from twin.studies.safety.sensitivity import ThresholdPoint

RESULTS_FOLDER = Path("results") / "safety"
DATA_FILE, PAGE_FILE = "safety.json", "safety.html"


@study(isolated=True)
def safety(
    hazards: Annotated[
        Sequence[Path], Argument("Hazard tables (TOML), such as experiments/safety/massage.toml.", "TABLE")
    ],
    say: Say,
    against: Annotated[
        Path | None, Option("safety.json of an earlier page: which lines got worse (exit code 1).", "OLD.json")
    ] = None,
    quick: Annotated[bool, Option("Without sensitivity and other hardware.", flags="--quick")] = False,
    drive: DriveName = None,
    settings: Settings = (),
    out: Annotated[Path | None, Option("Folder; default: results/safety/TABLE.", "DIR")] = None,
) -> Result:
    """Run every cause of a hazard table, and write a page from hazard to run.

    Each line shows the worst case found by search, with the monitor and without,
    the share of detected runs, force and duration at the person, and the result
    with other hardware. The page alone complies with no standard.

    Exit code: 0 every line is kept, or exceeded as its table states, 1 a line
    is exceeded, failed, or worse than --against, 2 input refused.

    Example: twin safety experiments/safety/massage.toml --quick
    """
    from twin.kernel.atomic_write import write_json
    from twin.studies.safety.hazards import read_hazards
    from twin.studies.safety.text import failures, lines_table, old_lines, regressions, verdict

    tables = [read_hazards(path) for path in hazards]
    before = old_lines(against) if against else None
    texts = [*settings, *([f"drive.fmu={drive}"] if drive else [])]
    for table in tables:
        refuse_unusable(table, texts)
    parts: list[Block] = []
    files: dict[str, object] = {}
    facts: dict[str, Any] = {"lines": [], "sensitivity": []}
    all_lines: list[HazardLine] = []
    for table in tables:
        folder = out if out and len(tables) == 1 else (out or RESULTS_FOLDER) / table.path.stem
        lines, points = write_page(table, texts, folder, quick, say)
        all_lines += lines
        facts["lines"] += [line.to_dict() for line in lines]
        facts["sensitivity"] += [point._asdict() for point in points]
        of_table = f" {table.path.stem}" if len(tables) > 1 else ""
        files |= {f"page{of_table}": folder / PAGE_FILE, f"data{of_table}": folder / DATA_FILE}
        parts += ["", lines_table(lines), *failures(lines)]
        write_json(folder.absolute() / DATA_FILE, facts | {"lines": [line.to_dict() for line in lines]})
    facts["worse"] = list(regressions(before, facts["lines"])) if before is not None else []
    if before is not None:
        sentences = facts["worse"] or ["no line got worse"]
        parts += ["", f"against {against}:", *(Note(sentence, "  ", later=4) for sentence in sentences)]
    return verdict(all_lines, facts, [*parts, ""], files)


def refuse_unusable(table: "SafetyTable", settings: Sequence[str]) -> None:
    """Reject invalid bodies, variants and sensitivities of a hazard table before the first run."""
    from twin.robot.assembly.load import load_experiment
    from twin.robot.experiment.experiment_files import experiment_file
    from twin.studies.safety.sensitivity import nominal_value

    path = experiment_file(Path(table.head.experiment))
    bodies = list(dict.fromkeys(body for hazard in table.hazards for body in hazard.evidence.bodies))
    robots: dict[str, tuple[str, Sequence[str]]] = {f"bodies: {body}": (body, ()) for body in bodies}
    robots |= {f"[[variant]] {variant.name}": (bodies[0], variant.set) for variant in table.variants}
    if asked := table.sensitivity:
        fleet = [(body, own) for body in asked.bodies for own in asked.fleet]
        robots |= {f"[sensitivity] {' '.join((body, *own))}": (body, own) for body, own in fleet}
    for name, (body, own) in robots.items():
        try:
            watched = load_experiment(path, (*settings, *own), None, body).monitor
        except InputRefused as problem:
            raise InputRefused(f"{table.path}: {name}: {problem}") from None
        if watched is None:
            raise InputRefused(f"{table.path}: {name}: no safety monitor watches {path}; add a table [monitor]")
    for key in asked.keys if asked else ():
        nominal_value(path, settings, key)


def write_page(
    table: "SafetyTable", settings: Sequence[str], folder: Path, quick: bool, say: Say
) -> tuple[list["HazardLine"], list["ThresholdPoint"]]:
    """Make the runs of a hazard table, write its page into `folder`, and return lines and tried thresholds.

    `settings`: `key=value` of the experiment, in addition to the table. `quick`: without sensitivity and other
    hardware.
    """
    from math import pi

    from twin.kernel.atomic_write import make_folder, write_text
    from twin.robot.experiment.experiment_files import experiment_file
    from twin.studies.faults.stage import Stage, load_stage
    from twin.studies.safety.argument import draw_argument
    from twin.studies.safety.evidence import variant_peaks
    from twin.studies.safety.lines import line_of
    from twin.studies.safety.page import hazard_page
    from twin.studies.safety.sensitivity import draw_sensitivity, threshold_points

    # absolute: an FMU may change the working directory
    home = make_folder(folder).absolute()
    path = experiment_file(Path(table.head.experiment))
    known: dict[tuple[str, tuple[float, float]], Stage] = {}
    grid = {(body, point) for h in table.hazards for body in h.evidence.bodies for point in h.evidence.points}

    def robots(body: str, point: tuple[float, float]) -> Stage:
        if (body, point) not in grid:
            return load_stage(path, settings, body, point, share=False)
        if (body, point) not in known:
            known[body, point] = load_stage(path, settings, body, point)
        return known[body, point]

    asked = None if quick else table.sensitivity
    places = sum(len(h.evidence.bodies) * len(h.evidence.points) for h in table.hazards)
    steps = Steps(say, places + (len(asked.keys) * len(asked.factors) if asked else 0))
    lines: list[HazardLine] = []
    worst: list[tuple[HazardLine, Stage]] = []
    try:
        for hazard in table.hazards:
            line, robot = line_of(hazard, robots, pi * table.head.head_radius**2, steps.next)
            if not quick:
                line = replace(line, variants=variant_peaks(line, table, path, robot))
            lines.append(line)
            worst += [(line, robot)] if robot is not None else []
    finally:
        for one in known.values():
            one.close()
    pictures = [("The argument", home / "argument.png")]
    draw_argument(table, lines, pictures[0][1])
    points = threshold_points(asked, path, settings, worst, steps.next) if asked else []
    if points:
        pictures.append(("Thresholds of the monitor", home / "sensitivity.png"))
        draw_sensitivity(points, pictures[1][1])
    command = " ".join(["twin safety", str(table.path), *(f"--set {text}" for text in settings)])
    write_text(home / PAGE_FILE, hazard_page(table, lines, pictures, command))
    return lines, points
