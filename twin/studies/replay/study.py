"""A replay, from a log to files: recording, picture, facts."""

import shlex
from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from pathlib import Path

from twin.recording.folder import RECORDING, claim_run_folder, create_run_folder
from twin.recording.logs.column_map import column_map
from twin.recording.logs.reader import read_log
from twin.studies.answer import Answer
from twin.studies.replay.model import model_for
from twin.studies.replay.picture import draw_replay
from twin.studies.replay.record import record
from twin.studies.replay.replay import Indicator, Replay, replayed
from twin.studies.replay.text import replay_text, verdict
from twin.studies.steps import Say, Steps, silent
from twin.writing import finite, write_json

HOME = Path("results") / "replay"
PICTURE, FACTS = "replay.png", "replay.json"


def replay(
    log: Path,
    maps: Sequence[str] = (),
    experiment: Path | None = None,
    settings: Sequence[str] = (),
    plant: bool = False,
    baseline: tuple[float, float] = (0.0, 1.0),
    tolerance: float | None = None,
    out: Path | None = None,
    say: Say = silent,
) -> Answer:
    """A robot's log through the twin, and files: recording, picture, facts.

    Exit code 1: twin and robot part.

    Args:
        log: a recording, another MCAP file or a CSV file.
        maps: see `column_map`.
        experiment: of the robot; None: the one that the recording carries.
        settings: laid over it.
        plant: see `replayed`.
        baseline: see `replayed`.
        tolerance: see `replayed`.
        out: folder; None: a new one in results/replay/NAME.
        say: told what is being done.

    Raises:
        InputRefused: log, map, experiment or folder cannot be used.
        ComponentFailed: the plant model left the workspace.
    """
    steps = Steps(say, 3)
    steps.next("reading")
    curves = read_log(log, column_map(maps))
    model = model_for(curves.path, experiment, settings)
    steps.next("estimating, and the plant model" if plant else "estimating")
    done = replayed(curves, model, plant, baseline, tolerance)
    name = model.name if experiment is None else curves.path.stem
    folder = claim_run_folder(out) if out else create_run_folder(HOME, name, datetime.now())
    files = {"recording": folder / RECORDING, "picture": folder / PICTURE, "facts": folder / FACTS}
    steps.next("recording and drawing")
    record(done, files["recording"])
    draw_replay(done, name, files["picture"])
    facts = replay_facts(done)
    write_json(files["facts"], facts)
    named = {kind: str(path) for kind, path in files.items()}
    options = {"--experiment": [experiment] if experiment else [], "--map": maps, "--set": settings}
    words = [word for option, values in options.items() for value in values for word in (option, str(value))]
    following = shlex.join([*_following(done, str(log)), *words]) if _following(done, str(log)) else ""
    text = replay_text(done, name, named, following)
    return Answer(text, facts | named | {"next": following}, 0 if done.first_alarm is None else 1)


def _following(replay: Replay, log: str) -> list[str]:
    """What finds out which part has changed, or, without a measured force, whether one has; then nothing."""
    if replay.log.force is not None:
        return ["twin", "identify", log]
    return [] if replay.plant else ["twin", "replay", log, "--plant"]


def replay_facts(replay: Replay) -> dict[str, object]:
    """Everything that a replay says in numbers; keys carry units, what does not exist is None."""
    log = replay.log
    return {
        "log": log.path.name,
        "experiment": replay.model.name,
        "verdict": verdict(replay).value,
        "start_s": float(log.t[0]),
        "end_s": float(log.t[-1]),
        "samples": len(log.t),
        "missing": log.missing,
        "gaps_s": log.gaps.tolist(),
        "force_N": {name: finite(asdict(one)) for name, one in replay.statistics.items()},
        "indicators": [_indicator_facts(one) for one in replay.indicators],
        "notes": list(log.notes),
    }


def _indicator_facts(one: Indicator) -> dict[str, object]:
    d = one.drift
    return finite(
        {
            "name": one.name, "unit": one.unit, "matches": d.matches, "since_s": d.since, "alarm_s": d.alarm,
            "size": d.size, "baseline": d.baseline, "sigma": d.sigma, "tolerance": d.tolerance, "slack": d.slack,
            "threshold": d.threshold, "block_s": d.block,
        }
    )  # fmt: skip
