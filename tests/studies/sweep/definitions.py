"""Sweep files and definitions for tests."""

from pathlib import Path

from twin.kernel.process.job import JobLimits
from twin.studies.sweep.engine import Job
from twin.studies.sweep.plan import SweepFile, SweepPlan, read_plan

STIFFNESS = "contact.stiffness_N_per_m"
GAIN = "controller.force.kp_mm_per_N"
SHORT = '{ key = "duration_s", values = [0.02] }'
"""A run this short costs little more than its set-up."""


def definition(**table) -> SweepFile:
    return SweepFile.model_validate({"experiment": "e.toml", **table})


def written(folder: Path, text: str, name: str = "s.toml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def stiffnesses(root: Path, folder: Path, values: str, more: str = "") -> SweepPlan:
    """A plan of short runs over contact stiffness."""
    return read_plan(written(folder, stiffness_text(root, values, more)))


def stiffness_text(root: Path, values: str, more: str = "") -> str:
    return f"""
experiment = "{root}/experiments/fig4_force_position.toml"
vary = [{{ key = "{STIFFNESS}", values = {values} }}, {SHORT}]
{more}
"""


def job(plan: SweepPlan, folder: Path, record: str = "none", limits: JobLimits = JobLimits(step=2.0)) -> Job:  # noqa: B008
    """What its runs have in common; recordings go to `folder`."""
    return Job(
        experiment=plan.experiment,
        recordings=folder,
        record=record,
        limits=limits,
        claims=plan.definition.claims or "",
    )
