"""How cost grows as the work grows: `python -m benchmarks.growth` measures, and writes docs/building.md's table.

Of each kind of work several sizes; the slope is that of a straight line through the logarithms of the larger half,
where what is paid once no longer counts: 1 is proportional.
"""

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.figure_4 import stepped
from benchmarks.report import _twin
from benchmarks.sweep import KEY
from twin.kernel.atomic_write import make_folder, write_json, write_text
from twin.kernel.process.job import JobLimits
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.studies.figure import BLUE, picture
from twin.studies.result import markdown
from twin.studies.sweep.engine import Job, LocalEngine
from twin.studies.sweep.measures import METRICS, failure, run_fields
from twin.studies.sweep.plan import plan_of, short_definition
from twin.studies.sweep.rows import ROWS_FILE, RowFile
from twin.studies.sweep.stored import SWEEP_FILE

ROOT = Path(__file__).parents[1]
EXPERIMENT = ROOT / "experiments" / "fig4_force_position.toml"
DOCS = ROOT / "docs"
BEGIN = "<!-- from here on written by python -m benchmarks.growth -->\n"
TURNS = 3
ACROSS = 4
"""Panels side by side."""
HEAD = ("what grows", "from", "to", "cost there", "slope")


@dataclass(frozen=True)
class Growth:
    """Seconds at several sizes of a kind of work.

    Attributes:
        name: what is done.
        size: what the sizes count.
        sizes, seconds: (n,), rising sizes.
    """

    name: str
    size: str
    sizes: list[float]
    seconds: list[float]

    @property
    def slope(self) -> float:
        """Of the logarithms, over the larger half of the sizes."""
        half = len(self.sizes) // 2
        return float(np.polyfit(np.log(self.sizes[half:]), np.log(self.seconds[half:]), 1)[0])


def grown(name: str, size: str, sizes: list[float], work: Callable[[float], float]) -> Growth:
    """`work` done at each of the sizes, the median of a few turns; it returns its seconds."""
    return Growth(name, size, sizes, [median(work(one) for _ in range(TURNS)) for one in sizes])


def lasting(experiment: Experiment, seconds: float) -> Experiment:
    """`experiment` for another time; the robot stays where its reference ends."""
    return replace(experiment, duration_ticks=round(seconds / experiment.cosim.tick))


def faulty(count: float) -> Experiment:
    """Fig. 4 with so many faults, each a component of its own; every second takes back what the one before it adds."""
    faults = [f'{{kind="encoder_bias",onset_s=1.0,magnitude_deg={(-1) ** n * 0.02}}}' for n in range(int(count))]
    return load_experiment(EXPERIMENT, [f"fault=[{','.join(faults)}]"])


def swept(runs: float) -> float:
    """Seconds of so many runs of Fig. 4 with a row each, in two processes, from the first order on."""
    plan = plan_of(short_definition(EXPERIMENT, [f"{KEY}=500:5000:{int(runs)}"], None), EXPERIMENT, "fig4", "growth")
    with tempfile.TemporaryDirectory() as scratch:
        job = Job(experiment=EXPERIMENT, recordings=Path(scratch), record="none", limits=JobLimits(), claims="")
        began = time.perf_counter()
        assert sum(len(batch) for batch in LocalEngine(2).results(job, plan.tasks)) == int(runs)
        return time.perf_counter() - began


def reported(folder: Path, runs: float) -> float:
    """Seconds of `twin report` of so many runs, which are copies of the one in `folder`."""
    copies = [folder.with_name(f"copy_{number}") for number in range(int(runs))]
    for copy in copies:
        with suppress(FileExistsError):
            shutil.copytree(folder, copy)
    return _twin("report", *copies, "--out", folder.with_name("report.html"))


def made_up(folder: Path, runs: int) -> None:
    """A sweep's folder with so many rows of three drawn parameters, one in a hundred failed, none of them ever run."""
    labels, metrics = [KEY, "plant.k_s_Nm_per_rad", "plant.eta"], list(METRICS)
    facts = {"sweep": "made_up", "runs": runs, "design": "random", "drives": [], "labels": labels, "metrics": metrics}
    write_json(make_folder(folder) / SWEEP_FILE, facts | {"limits": {}, "configuration": {}})
    rng = np.random.default_rng(0)
    with RowFile(folder / ROWS_FILE) as rows:
        for first in range(1, runs + 1, 10_000):
            numbers = rng.normal(5.0, 1.0, (min(10_000, runs + 1 - first), len(labels) + len(metrics))).tolist()
            batch = []
            for run, drawn in enumerate(numbers, start=first):
                measured = dict(zip(metrics, drawn[len(labels) :], strict=True))
                done, failed = run_fields("done", "", measured, 0.03, 0.02), failure("drive_1: it crashed")
                row = {"run": run, "key": f"{run:016x}", "drive": None, "within_limits": None}
                row["parameters"] = dict(zip(labels, drawn, strict=False))
                batch.append(row | (done if run % 100 else failed))
            rows.add(batch)


def opened(scratch: Path, runs: float) -> float:
    """Seconds of `twin sweep show` of so many rows."""
    folder = scratch / f"sweep_{runs:g}"
    if not folder.exists():
        made_up(folder, int(runs))
    return _twin("sweep", "show", folder)


def growths() -> Iterator[Growth]:
    """All of them, as they are measured."""
    fig4 = load_experiment(EXPERIMENT)
    yield grown(
        "stepping Fig. 4", "simulated s", [1.0, 10.0, 60.0, 600.0, 3600.0],
        lambda seconds: stepped(lasting(fig4, seconds), timed=False)[0],
    )  # fmt: skip
    yield grown(
        "stepping 60 s with faults", "faults", [1, 4, 16, 64],
        lambda count: stepped(lasting(faulty(count), 60.0), timed=False)[0],
    )  # fmt: skip
    yield grown(
        "stepping Fig. 4, slow drives", "steps of each drive a tick", [1, 4, 16, 64],
        lambda steps: stepped(load_experiment(EXPERIMENT, [f"drive.substeps={steps:g}"]), timed=False)[0],
    )  # fmt: skip
    yield grown("a sweep of Fig. 4, two processes", "runs", [10, 100, 1000], swept)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        _twin("run", EXPERIMENT, "--out", folder)
        yield grown("twin report", "runs", [1, 2, 5, 10, 20], lambda runs: reported(folder, runs))
    yield from openings()


def openings() -> Iterator[Growth]:
    """Those of `twin sweep show`."""
    with tempfile.TemporaryDirectory() as scratch:
        yield grown("twin sweep show", "rows", [1e3, 1e4, 1e5, 1e6], partial(opened, Path(scratch)))


def table(found: list[Growth]) -> str:
    """What docs/building.md ends with."""
    rows = [
        (one.name, f"{one.sizes[0]:g}", f"{one.sizes[-1]:g} {one.size}", f"{one.seconds[-1]:.3g} s", f"{one.slope:.2f}")
        for one in found
    ]
    return markdown(HEAD, rows) + "\n"


def draw(found: list[Growth], path: Path) -> None:
    """Seconds over sizes, logarithmic, a panel each; grey is proportional."""
    lines = -(-len(found) // ACROSS)
    with picture(path, 2.6 * ACROSS, 2.8 * lines) as figure:
        panels = figure.subplots(lines, ACROSS).ravel()
        for axes in panels[len(found) :]:
            axes.set_visible(False)
        for axes, one in zip(panels, found, strict=False):
            last = one.seconds[-1] / one.sizes[-1]
            axes.loglog(one.sizes, [last * size for size in one.sizes], color="0.8", linewidth=4)
            axes.loglog(one.sizes, one.seconds, "o-", color=BLUE, markersize=4)
            axes.set_title(one.name, fontsize=8)
            axes.set_xlabel(one.size)
        for axes in panels[::ACROSS]:
            axes.set_ylabel("s")


def main() -> None:
    """Measure, and write the page's picture and table."""
    found = []
    for one in growths():
        found.append(one)
        cost = f"{one.seconds[-1]:.3g} s at {one.sizes[-1]:g} {one.size}"
        print(f"{one.name:34} {cost:34} slope {one.slope:.2f}", flush=True)
    write_json(DOCS / "performance.json", [vars(one) for one in found])
    rewrite(found)


def rewrite(found: list[Growth]) -> None:
    """The picture and the table of docs/building.md."""
    draw(found, DOCS / "performance.png")
    prose, _, _ = (DOCS / "building.md").read_text().partition(BEGIN)
    write_text(DOCS / "building.md", f"{prose}{BEGIN}\n{table(found)}")


if __name__ == "__main__":
    main()
