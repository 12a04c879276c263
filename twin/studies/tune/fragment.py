"""Gains as an experiment file that extends the one they were found for."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomlkit

from twin.studies.tune.tuned import Tuned
from twin.writing import inline_table


def goals_sentence(done: Tuned) -> str:
    """`M_s at most 1.6, overshoot at most 5 %, on 300 to 5000 N/m, with velocity_servo`."""
    goals = done.goals
    parts = [f"M_s at most {goals.sensitivity:g}", f"overshoot at most {100.0 * goals.overshoot:g} %"]
    if goals.bandwidth is not None:
        parts.append(f"{goals.law} bandwidth at least {goals.bandwidth_hertz:g} Hz")
    if done.stiffness is not None:
        parts.append("on {:g} to {:g} N/m".format(*done.stiffness))
    return ", ".join([*parts, "with " + " and ".join(Path(drive.labels[0]).stem for drive in done.drives)])


def fragment(done: Tuned, experiment: Path, folder: Path, options: Sequence[str]) -> str:
    """TOML: `extends` the file `experiment`, and all gains of the laws with where they come from.

    Args:
        folder: where it will stand.
        options: of the command line, with which the experiment is as it was tuned.
    """
    source = f"twin tune: {goals_sentence(done)}" + ("" if done.met else "; GOALS NOT MET")

    def found(value: float, before: float) -> Any:
        # six digits are more than a search knows
        return inline_table({"value": float(f"{value:.6g}"), "source": f"{source}; was {before:.6g}"})

    before, after = done.before.gains, done.after.gains
    laws = {"position": {"kp_per_s": found(after.kp, before.kp), "ki_per_s2": 0, "kd": 0}}
    if done.goals.law == "force":
        laws["force"] = {
            "kp_mm_per_N": found(1e3 * after.force_kp, 1e3 * before.force_kp),
            "ki_mm_per_N_s": found(1e3 * after.force_ki, 1e3 * before.force_ki),
            "kd_mm_s_per_N": 0,
        }
    head = f"# twin tune {shlex.join([str(experiment), *options])}: {goals_sentence(done)}\n"
    return head + tomlkit.dumps({"extends": str(findable(experiment, folder)), "controller": laws})


def findable(experiment: Path, folder: Path) -> Path:
    """`experiment` as it was typed if it is found so from `folder` or a folder around it, else absolute."""
    here, file = folder.resolve(), experiment.resolve()
    found = next((place / experiment for place in (here, *here.parents) if (place / experiment).exists()), None)
    return experiment if found is not None and found.resolve() == file else file
