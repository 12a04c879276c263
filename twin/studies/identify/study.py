"""An identification, from a log to files: picture, model to paste, facts."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path

from twin.recording.folder import claim_run_folder, create_run_folder
from twin.recording.logs.column_map import column_map
from twin.recording.logs.reader import is_recording, read_log
from twin.studies.answer import Answer
from twin.studies.identify.identification import Identification, identified
from twin.studies.identify.model_file import model_fragment
from twin.studies.identify.picture import draw_identification
from twin.studies.identify.text import identification_text
from twin.studies.identify.truth import truth
from twin.studies.replay.model import model_for
from twin.studies.steps import Say, silent
from twin.writing import write_json, write_text

HOME = Path("results") / "identify"
PICTURE, MODEL, FACTS = "identify.png", "model.toml", "identify.json"


def identify(
    log: Path,
    maps: Sequence[str] = (),
    experiment: Path | None = None,
    settings: Sequence[str] = (),
    height: float | None = None,
    motor_torque: bool = False,
    out: Path | None = None,
    say: Say = silent,
) -> Answer:
    """What a log of presses on a scale says of its robot, and files: picture, model to paste, facts.

    Args:
        log: a recording, another MCAP file or a CSV file.
        maps: see `column_map`.
        experiment: that describes the robot; None: the one the recording carries.
        settings: laid over it.
        height: of the scale (m), if measured.
        motor_torque: whether drive/n.tau_motor is measured.
        out: folder; None: a new one in results/identify/NAME.
        say: told what is being done.

    Raises:
        InputRefused: log, map, experiment or folder cannot be used.
        NotIdentifiable: k_s eta cannot be had from the log.
    """
    say("reading", 0.0)
    curves = read_log(log, column_map(maps))
    model, own = model_for(curves.path, experiment, settings), is_recording(curves.path)
    one = identified(curves, model, height, motor_torque, say)
    # only a run of the twin that is taken for what it was has a truth to be scored by
    true = truth(model) if own and experiment is None else {}
    name = model.name if own else curves.path.stem
    folder = claim_run_folder(out) if out else create_run_folder(HOME, name, datetime.now())
    files = {"model": folder / MODEL, "picture": folder / PICTURE, "facts": folder / FACTS}
    draw_identification(one, name, files["picture"])
    write_text(files["model"], model_fragment(one, curves.path.name))
    facts = identification_facts(one, curves.path.name, true)
    write_json(files["facts"], facts)
    named = {kind: str(path) for kind, path in files.items()}
    return Answer(identification_text(one, name, named, true), facts | named)


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
