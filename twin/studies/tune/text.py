"""What tuning came to as text of at most 80 columns: whether the goals are met, the gains, then before and after."""

import math
from collections.abc import Iterator
from pathlib import Path

from twin.studies.lines import wrapped
from twin.studies.tune.fragment import goals_sentence
from twin.studies.tune.prediction import HORIZON, StepAnswer
from twin.studies.tune.search import Miss
from twin.studies.tune.trial import Whole
from twin.studies.tune.tuned import Judged, Tuned, worst_places

DOUBT = 0.03
"""Distance of a drive's model from what was measured that a reader has to know of."""


def tuning_text(done: Tuned) -> str:
    """For people."""
    lines = [*_verdict(done), "", *_gains(done), *wrapped(goals_sentence(done), "  goals     "), ""]
    lines += [*_table(done), "", *_runs(done)]
    for drive in done.drives:
        model = drive.drives[0]
        if model.turning or model.residual > DOUBT:
            text = f"the linear model of {drive.labels[0]} is {100.0 * model.residual:.2g} % off its measured response"
            lines += wrapped(f"{text}; trust what is simulated", "note  ")
    if not done.after.trials:
        lines += wrapped("no step is simulated: tasks lead this robot, and damping that only they have acts", "note  ")
    for problem in done.problems:
        lines += wrapped(f"left out: {problem}", "note  ")
    return "\n".join(line.rstrip() for line in lines)


def _verdict(done: Tuned) -> Iterator[str]:
    name, corners = done.experiments[0].name, len(done.after.predictions)
    if done.met:
        confirmed = ", and the co-simulation agrees" if done.after.trials else ""
        where = "the one corner" if corners == 1 else f"all {corners} corners"
        yield f"{name}  GOALS MET at {where}{confirmed}"
        return
    yield f"{name}  GOALS NOT MET; this is the best that was found"
    for miss in done.after.misses:
        yield from wrapped(_miss(done, miss), "  missed    ")
    for sentence in done.contradictions:
        yield from wrapped(sentence, "  missed    ")


def _miss(done: Tuned, miss: Miss) -> str:
    where = f"{miss.at.corner.name} with {Path(miss.at.corner.drive).stem}"
    goals = done.goals
    if miss.goal == "stability":
        return f"no gains found that are stable: {where}"
    if miss.goal == "margin":
        return f"M_s at most {goals.sensitivity:g}: it is {miss.reached:.3g}, {where}"
    if miss.goal == "overshoot":
        return f"overshoot at most {100 * goals.overshoot:g} %: it is {100 * miss.reached:.2g} %, {where}"
    reached = miss.reached / (2.0 * math.pi)
    return f"bandwidth at least {goals.bandwidth_hertz:g} Hz: it is {reached:.3g} Hz, {where}; margin goes first"


def _gains(done: Tuned) -> Iterator[str]:
    before, after = done.before.gains, done.after.gains
    yield _gain("position", f"kp = {after.kp:.3g} 1/s", before.kp)
    if done.goals.law == "force":
        yield _gain("force", f"kp = {1e3 * after.force_kp:.3g} mm/N", 1e3 * before.force_kp)
        yield _gain("", f"ki = {1e3 * after.force_ki:.3g} mm/(N s)", 1e3 * before.force_ki)


def _gain(law: str, now: str, before: float) -> str:
    return f"  {law:8}  {now:24} was {before:.3g}"


def _table(done: Tuned) -> Iterator[str]:
    head = f"{'M_s':>4} {'over':>5} {'5 % in':>7} {'-3 dB':>7}"
    yield f"{'':23}  {'before':-^26}  {'after':-^26}"
    yield f"{'a step of':23}  {head}  {head}"
    drive = ""
    for i in worst_places(done.after.predictions):
        corner = done.after.predictions[i].corner
        if corner.drive != drive:
            drive = corner.drive
            yield Path(drive).stem
        yield f"  {corner.name:21}  {_predicted(done.before, i)}  {_predicted(done.after, i)}"
        if i in done.after.trials:
            yield f"  {'  simulated':21}  {_simulated(done.before, i)}  {_simulated(done.after, i)}"


def _predicted(judged: Judged, i: int) -> str:
    prediction = judged.predictions[i]
    if not prediction.stable:
        return f"{'UNSTABLE':^26}"
    found = next(iter(prediction.answers.values()))
    return f"{prediction.sensitivity:#4.3g} {_answer(found)} {_bandwidth(found.bandwidth)}"


def _simulated(judged: Judged, i: int) -> str:
    trial = judged.trials.get(i)
    if trial is None:
        return f"{'failed' if i in judged.trials else 'not tried':^26}"
    return f"{'':4} {_answer(trial.answer)} {_bandwidth(trial.answer.bandwidth)}"


def _bandwidth(omega: float) -> str:
    hertz = omega / (2.0 * math.pi)
    digits = 2 if hertz < 1.0 else 1 if hertz < 10.0 else 0
    return f"{'-':>7}" if math.isnan(omega) else f"{hertz:4.{digits}f} Hz"


def _answer(found: StepAnswer) -> str:
    settling = f"{found.settling:.2f} s" if math.isfinite(found.settling) else f"> {HORIZON:g} s"
    return f"{100.0 * found.overshoot:3.0f} % {settling:>7}"


def _runs(done: Tuned) -> Iterator[str]:
    for before, after in zip(done.before.wholes, done.after.wholes, strict=True):
        text = f"{_run(before)} before, {_run(after)} after"
        kind = "z" if after.outcome is None or after.outcome.force_error is None else "force"
        yield from wrapped(f"the experiment itself, {Path(after.drive).stem}: {kind} off by {text} (rms)", "run   ")


def _run(whole: Whole) -> str:
    if whole.outcome is None:
        return "it failed"
    force, z = whole.outcome.force_error, whole.outcome.z_error
    assert z is not None, "twin's own controller has a reference"
    error = f"{1e3 * z:.2g} mm" if force is None else f"{force:.2g} N"
    return f"{error} and a safety trip" if whole.trip else error
