"""`twin serve`: the twin in the place of a robot, for a controller over ROS 2."""

import math
import re
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Literal

from twin.cli.ask import run_recording_job
from twin.cli.run import DEFAULT_MEMORY_LIMIT, RunPageWriter, require_isolation, step_limit
from twin.cli.terminal import TerminalDisplay
from twin.kernel.errors import InputRefused
from twin.kernel.process.job import JobLimits
from twin.studies.command import (
    DEFAULT_PORT,
    JOB_ISOLATION,
    BodyName,
    DriveName,
    ExperimentName,
    Isolation,
    LimitStep,
    LimitWall,
    LiveOrigins,
    LivePort,
    Option,
    Page,
    Settings,
    study,
)
from twin.studies.precheck import find_experiments

SERVE_JOB = "twin.studies.serve.session:served_run"
JOINT_NAMES = "m1,m2,m3,l1,l2,l3"
TOPIC_PATTERN = "(/[A-Za-z_][A-Za-z0-9_]*)+"
"""Regular expression of ROS 2 topic names."""


@study(json=False, before=[find_experiments])
def serve(
    experiment: ExperimentName,
    lockstep: Annotated[
        bool, Option("Wait for the answer to each sample, in simulation time; without it in real time.")
    ] = False,
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = (),
    commands: Annotated[
        Literal["joint", "array"],
        Option("Commands: stamped sensor_msgs/JointState, or std_msgs/Float64MultiArray without stamps."),
    ] = "joint",
    command_topic: Annotated[
        str | None, Option("Topic of the commands; default: the topic of ros2_control for the type.", "TOPIC")
    ] = None,
    names: Annotated[str, Option("Names of the joints, motors then links, with commas.", "NAMES")] = JOINT_NAMES,
    domain: Annotated[
        int | None, Option("Domain of DDS; default: that of ROS_DOMAIN_ID, else 0.", "N", least=0, most=232)
    ] = None,
    answer_s: Annotated[
        float, Option("With --lockstep: time without an answer that ends the run.", "S", least=0.0)
    ] = 10.0,
    watchdog_ms: Annotated[
        float | None,
        Option("Time without a command that sets the speeds to 0; 0: none; default: 5 periods.", "MS", least=0.0),
    ] = None,
    silence_ms: Annotated[
        float, Option("Time after that until the safety monitor retracts the robot; 0: never.", "MS", least=0.0)
    ] = 100.0,
    check: Annotated[bool, Option("Compare with the baseline, as twin check does; needs --lockstep.")] = False,
    update: Annotated[
        bool, Option("Accept the run's measures as the baseline; needs --lockstep and --baselines.")
    ] = False,
    reason: Annotated[str, Option("With --update: reason, stored in the baseline.", "TEXT")] = "",
    baselines: Annotated[
        Path | None, Option("With --check or --update: folder of baselines; default: the folder of twin check.", "DIR")
    ] = None,
    out: Annotated[Path | None, Option("Folder of the run; default: results/EXPERIMENT/TIME.", "DIR")] = None,
    as_json: Annotated[bool, Option("Print one JSON object instead of text.", flags="--json")] = False,
    report: Page = False,
    isolate: Annotated[
        Isolation, Option("Processes: one for the run, one more per drive, or none (for debuggers).")
    ] = JOB_ISOLATION,
    limit_step: LimitStep = JobLimits.step,
    limit_wall: LimitWall = math.inf,
    live: Annotated[bool, Option("Serve the run to Lichtblick or Foxglove; fault.N.start begins a fault.")] = False,
    port: LivePort = DEFAULT_PORT,
    origins: LiveOrigins = (),
    yes: Annotated[bool, Option("Allow runs of more than an hour or 5 GB.")] = False,
) -> None:
    """Stand in for the robot: a controller of yours commands it over ROS 2.

    The twin publishes encoders and scale as a robot does, and obeys the
    motor speeds that arrive. Drives, bus, safety monitor and faults are those
    of the experiment; its own controller runs unread. Nothing moves before
    the first command. Ctrl-C ends the run with a whole recording.

    Exit code: 0 done, 1 with --check: a measure deviates, 2 input refused, 3 a
    component failed or no answer came, 4 the safety monitor tripped although
    the experiment has no faults, 130 interrupted.

    Example: twin serve fig4_force_position --lockstep
    """
    require_isolation(isolate)
    if (check or update) and not lockstep:
        option = "--check" if check else "--update"
        raise InputRefused(f"{option}: needs --lockstep, as runs in real time do not repeat")
    if baselines and not (check or update):
        raise InputRefused("--baselines: needs --check or --update")
    if update != bool(reason.strip()) or (update and (check or baselines is None)):
        raise InputRefused('--update: expected --baselines DIR --reason "why the numbers may move", without --check')
    joints = [name.strip() for name in names.split(",")]
    if len(joints) != 6 or len(set(joints)) != 6 or not all(joints):
        raise InputRefused(f"--names {names}: expected six different names with commas, such as {JOINT_NAMES}")
    if command_topic is not None and not re.fullmatch(TOPIC_PATTERN, command_topic):
        raise InputRefused(
            f"--command-topic {command_topic}: expected a topic that begins with /, of letters, digits and _"
        )
    if math.isinf(answer_s) or answer_s == 0.0:
        raise InputRefused(f"--answer-s {answer_s:g}: expected a time > 0 s")
    if find_spec("cyclonedds") is None:
        raise InputRefused("twin serve: needs cyclonedds; pip install 'twin[shadow]'")
    arguments: dict[str, Any] = {
        "experiment": str(experiment),
        "settings": settings,
        "drive": drive,
        "body": body,
        "out": str(out) if out else None,
        "options": {
            "lockstep": lockstep,
            "answer_s": answer_s,
            "commands": commands,
            "command_topic": command_topic or "",
            "watchdog": None if watchdog_ms is None else 1e-3 * watchdog_ms,
            "silence": 1e-3 * silence_ms,
            "names": tuple(joints),
            "domain": domain,
        },
        "isolate_drives": isolate == "drive",
        "limit_step": limit_step,
        "check": check,
        "accept": reason,
        "baselines": str(baselines) if baselines else None,
        "sure": yes,
        "live": {"port": port, "origins": origins} if live else None,
    }
    limits = JobLimits(step_limit(limit_step, isolate), limit_wall, 1e6 * DEFAULT_MEMORY_LIMIT)
    with RunPageWriter(report, as_json, one_object=True) as reported, TerminalDisplay(as_json) as display:
        done = run_recording_job(
            SERVE_JOB, arguments, display, isolate, limits, reported.collect_folders(display.on_note)
        )
        if done["text"] and not as_json:
            print(f"\n{done['text']}")
    if done["exit_code"]:
        raise SystemExit(done["exit_code"])
