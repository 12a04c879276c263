"""An identification from files to files: picture, model to paste, facts; and its text."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from twin.errors import InputRefused
from twin.recording.folder import claim_run_folder, create_run_folder
from twin.recording.logs.column_map import column_map
from twin.recording.logs.reader import is_recording, read_log
from twin.recording.reader import read
from twin.studies.identify.identification import Identification, identified
from twin.studies.identify.model_file import model_fragment
from twin.studies.identify.picture import draw_identification
from twin.studies.identify.text import identification_text
from twin.studies.identify.truth import truth
from twin.studies.replay.model import loaded_model, recorded_model
from twin.writing import write_json, write_text

HOME = Path("results") / "identify"
PICTURE, MODEL, FACTS = "identify.png", "model.toml", "identify.json"


@dataclass(frozen=True)
class Request:
    """What a user asks.

    Attributes:
        log: a recording, another MCAP file or a CSV file. maps: see `column_map`.
        experiment: that describes the robot; None: the one the recording carries. settings: laid over it.
        height: of the scale (m), if measured. motor_torque: whether drive/n.tau_motor is measured.
        out: the folder to write; None: a new one in results/identify/NAME.
    """

    log: Path
    maps: Sequence[str] = ()
    experiment: Path | None = None
    settings: Sequence[str] = ()
    height: float | None = None
    motor_torque: bool = False
    out: Path | None = None


@dataclass(frozen=True)
class Report:
    """What comes of it. text: at most 80 columns; facts: for programs."""

    text: str
    facts: dict[str, object]


def identification_report(request: Request) -> Report:
    """Identify a log, and write picture, model and facts.

    Raises:
        InputRefused: log, map, experiment or folder cannot be used.
        NotIdentifiable: k_s eta cannot be had from the log.
    """
    log = read_log(request.log, column_map(request.maps))
    own = is_recording(request.log)
    if request.experiment is not None:
        model = loaded_model(request.experiment, request.settings)
    elif own:
        model = recorded_model(read(log.path).metadata, log.path, request.settings)
    else:
        raise InputRefused(f"{log.path}: does not say of which robot it is; name its experiment with --experiment FILE")
    one = identified(log, model, request.height, request.motor_torque)
    # only a run of the twin that is taken for what it was has a truth to be scored by
    true = truth(model) if own and request.experiment is None else {}
    name = model.name if own else log.path.stem
    folder = claim_run_folder(request.out) if request.out else create_run_folder(HOME, name, datetime.now())
    draw_identification(one, name, folder / PICTURE)
    write_text(folder / MODEL, model_fragment(one, log.path.name))
    facts = identification_facts(one, log.path.name, true)
    write_json(folder / FACTS, facts)
    files = {"model": folder / MODEL, "picture": folder / PICTURE, "facts": folder / FACTS}
    named = {kind: str(path) for kind, path in files.items()}
    return Report(identification_text(one, name, named, true), facts | named)


def identification_facts(one: Identification, log: str, true: Mapping[str, float]) -> dict[str, object]:
    """Everything in numbers, SI; what was not found is None."""
    quantities: dict[str, object] = {}
    for name, quantity in one.quantities.items():
        found = quantity.found
        quantities[name] = {
            "value": found.value if found else None, "half_width_95": found.half_width if found else None,
            "unit": found.unit if found else None, "believed": quantity.believed, "true": true.get(name),
        }  # fmt: skip
    press = one.one_pose
    return {
        "log": log,
        "experiment": one.model.name,
        "quantities": quantities,
        "only_together": [list(group) for group in one.alike],
        "singular_values": one.fit.singular.tolist(),
        "windows": len(one.fit.seen.t),
        "clusters": one.fit.clusters,
        "one_pose": {step.name: step.k_s_eta for step in press.steps} if press else None,
        "notes": list(one.notes),
    }
