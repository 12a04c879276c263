"""A replay from files to files: recording, picture, facts; and its text."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

from twin.errors import InputRefused
from twin.recording.folder import RECORDING, claim_run_folder, create_run_folder
from twin.recording.logs.column_map import column_map
from twin.recording.logs.log import Log
from twin.recording.logs.mcap_file import written_by_twin
from twin.recording.logs.reader import read_log
from twin.recording.reader import read
from twin.studies.replay.model import Model, loaded_model, recorded_model
from twin.studies.replay.picture import draw_replay
from twin.studies.replay.record import record
from twin.studies.replay.replay import Indicator, Replay, replayed
from twin.studies.replay.text import replay_text, verdict
from twin.writing import finite, write_json

HOME = Path("results") / "replay"
PICTURE, FACTS = "replay.png", "replay.json"


@dataclass(frozen=True)
class Request:
    """What a user asks of a replay.

    Attributes:
        log: a recording, another MCAP file or a CSV file. maps: see `column_map`.
        experiment: of the robot; None: the one that the recording carries. settings: laid over it.
        plant, baseline, tolerance: see `replayed`.
        out: the folder to write; None: a new one in results/replay/NAME.
    """

    log: Path
    maps: Sequence[str] = ()
    experiment: Path | None = None
    settings: Sequence[str] = ()
    plant: bool = False
    baseline: float = 1.0
    tolerance: float | None = None
    out: Path | None = None


@dataclass(frozen=True)
class Report:
    """What comes of it. text: at most 80 columns; facts: for programs; matches: False if twin and robot part."""

    text: str
    facts: dict[str, object]
    matches: bool


def replay_report(request: Request) -> Report:
    """Replay a log, and write recording, picture and facts.

    Raises:
        InputRefused: log, map, experiment or folder cannot be used.
        ComponentFailed: the plant model left the workspace.
    """
    log = read_log(request.log, column_map(request.maps))
    model = _model(log, request)
    replay = replayed(log, model, request.plant, request.baseline, request.tolerance)
    name = model.name if request.experiment is None else log.path.stem
    now = datetime.now()
    folder = claim_run_folder(request.out) if request.out else create_run_folder(HOME, name, now)
    record(replay, folder / RECORDING)
    draw_replay(replay, name, folder / PICTURE)
    facts = replay_facts(replay)
    write_json(folder / FACTS, facts)
    files = {"recording": folder / RECORDING, "picture": folder / PICTURE, "facts": folder / FACTS}
    text = replay_text(replay, name, {kind: str(path) for kind, path in files.items()})
    return Report(text, facts | {kind: str(path) for kind, path in files.items()}, replay.first_alarm is None)


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


def _model(log: Log, request: Request) -> Model:
    if request.experiment is not None:
        return loaded_model(request.experiment, request.settings)
    if log.path.suffix != ".csv" and written_by_twin(log.path):
        return recorded_model(read(log.path).metadata, log.path, request.settings)
    raise InputRefused(f"{log.path}: does not say of which robot it is; name its experiment with --experiment FILE")
