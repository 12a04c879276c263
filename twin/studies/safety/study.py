"""`twin safety`: a hazard table, the runs behind each line, and a page for a reviewer."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from twin.studies.command import Argument, DriveName, Option, Say, Settings, Steps, study
from twin.studies.result import Block, Column, Note, Result, Table

HOME = Path("results") / "safety"
DATA, PAGE = "safety.json", "safety.html"


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

    Each line: the worst case found by search, with the monitor and without,
    what is seen, how long and how hard a person feels it, what other hardware
    would give. The page complies with no standard by itself.

    Exit code: 0 every line is kept, or exceeded as its table states, 1 a line
    is exceeded, failed, or worse than --against, 2 input refused.

    Example: twin safety experiments/safety/massage.toml --quick

    Raises:
        InputRefused: a table is not right, or --against is no page's data.
        NotWritten: the disk refuses.
    """
    from dataclasses import replace
    from math import pi

    from twin.kernel.writing import made_folder, write_json, write_text
    from twin.robot.experiment.drive_files import experiment_file
    from twin.studies.safety.argument import draw_argument
    from twin.studies.safety.changes import old_lines, worse
    from twin.studies.safety.evidence import Line, Robot, hardware, line_of, robot_of
    from twin.studies.safety.hazards import read_hazards
    from twin.studies.safety.page import page, value_text
    from twin.studies.safety.sensitivity import draw_sensitivity, threshold_points

    tables = [read_hazards(path) for path in hazards]
    before = old_lines(against) if against else None
    texts = [*settings, *([f"drive.fmu={drive}"] if drive else [])]
    all_lines: list[Line] = []
    parts: list[Block] = []
    files: dict[str, object] = {}
    facts: dict[str, Any] = {"lines": [], "sensitivity": []}
    for table in tables:
        folder = made_folder(out or HOME / table.path.stem)
        home = folder.absolute()
        path = experiment_file(Path(table.head.experiment))
        known: dict[Any, Robot] = {}

        def robots(body: str, point: tuple[float, float], path: Path = path, known: dict = known) -> Robot:
            if (body, point) not in known:
                known[body, point] = robot_of(path, texts, body, point)
            return known[body, point]

        places = sum(len(h.evidence.bodies) * len(h.evidence.points) for h in table.hazards)
        asked = table.sensitivity if not quick else None
        steps = Steps(say, places + (len(asked.keys) * len(asked.factors) if asked else 0))
        lines, worst = [], []
        for hazard in table.hazards:
            name = f"{hazard.table.id}: {hazard.table.hazard}"
            line, robot = line_of(hazard, robots, pi * table.head.head_radius**2, lambda name=name: steps.next(name))
            if not quick:
                line = replace(line, variants=hardware(line, table, path, robot))
            lines.append(line)
            if robot is not None:
                worst.append((line, robot))
        pictures = [("The argument", home / "argument.png")]
        draw_argument(table, lines, pictures[0][1])
        if asked:
            points = threshold_points(asked, path, texts, worst, lambda: steps.next("thresholds of the monitor"))
            pictures.append(("Thresholds of the monitor", home / "sensitivity.png"))
            draw_sensitivity(points, pictures[1][1])
            facts["sensitivity"] += [point._asdict() for point in points]
        command = " ".join(["twin safety", str(table.path), *(f"--set {text}" for text in texts)])
        write_text(home / PAGE, page(table, lines, pictures, command))
        facts["lines"] += [line.facts() for line in lines]
        files[f"page {table.path.stem}" if len(tables) > 1 else "page"] = folder / PAGE
        files[f"data {table.path.stem}" if len(tables) > 1 else "data"] = folder / DATA
        write_json(home / DATA, facts)
        all_lines += lines
        columns = (
            Column("", 4, left=True), Column("hazard", 34, ".34s", left=True), Column("worst", 10), Column("without", 10),
            Column("seen", 9), Column("", left=True),
        )  # fmt: skip
        rows = []
        for line in lines:
            run, (seen, made) = line.worst, line.detected
            rows.append(
                (
                    line.hazard.table.id,
                    line.hazard.table.hazard,
                    value_text(line, run.watched if run else None),
                    value_text(line, run.unwatched if run else None),
                    f"{seen}/{made}",
                    line.status,
                )
            )
        parts += ["", Table(columns, rows, indent=0)]
    got_worse = list(worse(before, facts["lines"])) if before is not None else []
    if before is not None:
        said = got_worse or ["no line got worse"]
        parts += ["", f"against {against}:", *(Note(sentence, "  ", later=4) for sentence in said)]
        facts["worse"] = got_worse
    bad = [line for line in all_lines if line.status in ("exceeded", "failed")]
    stated = sum(line.status == "exceeded as stated" for line in all_lines)
    kept = sum(line.status == "kept" for line in all_lines)
    verdict = (
        f"{'FAILED' if bad or got_worse else 'PASSED'}: {kept} of {len(all_lines)} lines kept, {stated} exceeded as "
        f"stated, {len(bad)} exceeded or failed. This complies with no standard by itself."
    )
    return Result(Note(verdict, later=4), [*parts, ""], facts, files, exit_code=int(bool(bad or got_worse)))
