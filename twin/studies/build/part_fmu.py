"""A part of an experiment's robot, from what names it to an FMU that needs nothing of the twin."""

from collections.abc import Callable, Sequence
from pathlib import Path

from twin.kernel.writing import made_folder, refuse_unwritable, write_bytes
from twin.robot.assembly.load import load_experiment
from twin.studies.answer import Answer
from twin.studies.build.fmu import packed
from twin.studies.build.layout import Layout, laid_out
from twin.studies.build.linking import Platform, platforms_named, refuse_platform
from twin.studies.build.parameters import Parameter, fixed, parameters
from twin.studies.build.part import RobotPart, part_of

HOME = Path("results/build")


def build_fmu(
    experiment: Path,
    part: str,
    fmi: str,
    platforms: Sequence[str],
    out: Path | None,
    settings: Sequence[str],
    say: Callable[[str], None],
) -> Answer:
    """Write a part of the robot as a co-simulation FMU with native code.

    Args:
        experiment: file or name.
        part: "plant", "computer", or a component by its name.
        fmi: "2.0" or "3.0".
        platforms: for which beside x86-64 Linux, as FMI 3.0 calls them.
        out: the file; None: results/build/EXPERIMENT/PART.fmu.
        settings: laid over the experiment.
        say: told what is being done.

    Raises:
        InputRefused: the experiment or the part cannot be used, or there is no compiler.
        NotWritten: the disk refuses.
    """
    targets = platforms_named(platforms, fmi)
    loaded = load_experiment(experiment, settings)
    file = out or HOME / loaded.name / f"{part}.fmu"
    if out is not None:
        refuse_unwritable(file)
    found = part_of(loaded, part)
    refuse_platform(file, targets)
    offered = parameters(found)
    layout, closed = laid_out(found, offered), fixed(found, offered)
    text = readme(found, layout, closed, targets)
    content = packed(found, layout, fmi, targets, about(found), text, file, say)
    if out is None:
        made_folder(file.parent)
    write_bytes(file, content)
    return Answer(_text(found, file, fmi, targets, len(content), layout, offered, closed), {
        "file": str(file),
        "part": found.name,
        "components": [component.name for component in found.components],
        "fmi": fmi,
        "platforms": [target.name for target in targets],
        "bytes": len(content),
        "parameters": [parameter.key for parameter in offered],
        "fixed": closed,
        "inputs": _names(layout, "input"),
        "outputs": _names(layout, "output"),
    })  # fmt: skip


def about(part: RobotPart) -> str:
    """What the part is, and what its steps mean, in some sentences."""
    experiment = part.experiment
    names = ", ".join(component.name for component in part.components)
    sampled = [component.name for component in part.components if component.sampled]
    sentences = [
        f"{part.name} of {experiment.title}: {names}. Steps are multiples of {1e3 * experiment.cosim.tick:g} ms, "
        "inputs are held over a step."
    ]
    if sampled:
        them = ", ".join(sampled)
        sentences.append(
            f"Sampled at the start of a step and published at its end: {them}. In a master in which all exchange "
            "their values between steps (Jacobi) that is a delay of one step; in one that steps it before those it "
            "feeds, and hands its values on at once (Gauss-Seidel), there is none."
        )
    for number, fault in enumerate(experiment.faults, start=1):
        if part.component(f"fault_{number}"):
            sentences.append(f"fault_{number}: {fault.kind} of {fault.target}.")
    if part.component("controller") and experiment.controller.bus_delay_ticks:
        sentences.append(
            f"The delay of the bus, controller.bus_delay_ticks = {experiment.controller.bus_delay_ticks}, is not in "
            "it: of these ticks a Jacobi master makes one."
        )
    return " ".join(sentences)


def _named(platforms: Sequence[Platform]) -> str:
    return ", ".join(platform.name for platform in platforms)


def _names(layout: Layout, kind: str) -> list[str]:
    return [variable.name for variable in layout.variables if variable.kind == kind]


def readme(part: RobotPart, layout: Layout, closed: Sequence[str], platforms: Sequence[Platform]) -> str:
    rows = [
        f"| `{v.name}` | {v.kind} | {v.text} | {', '.join(f'{x:g}' for x in v.start) if v.kind != 'output' else ''} | "
        f"{v.meaning} |"
        for v in layout.variables
    ]
    return "\n".join(
        [
            f"# {part.name}",
            "",
            about(part),
            "",
            f"Native code for {_named(platforms)}; it needs the C library with its mathematics and nothing else.",
            "",
            "| variable | | unit | start | |",
            "|---|---|---|---|---|",
            *rows,
            "",
            "Fixed, because something was worked out of it when this was built: " + ", ".join(closed) + ".",
            "",
        ]
    )


def _text(
    part: RobotPart,
    file: Path,
    fmi: str,
    platforms: Sequence[Platform],
    size: int,
    layout: Layout,
    offered: Sequence[Parameter],
    closed: Sequence[str],
) -> str:
    inputs, outputs = _names(layout, "input"), _names(layout, "output")
    return "\n".join(
        [
            f"{part.name} of {part.experiment.name}, FMI {fmi} co-simulation, {size / 1000:.0f} KB",
            f"  runs on  {_named(platforms)}",
            f"  holds    {', '.join(component.name for component in part.components)}",
            f"  step     multiples of {1e3 * part.experiment.cosim.tick:g} ms",
            f"  inputs   {', '.join(inputs) or 'none'}",
            f"  outputs  {len(outputs)}: {', '.join(outputs[:4])}{' ..' if len(outputs) > 4 else ''}",
            f"  open     {len(offered)} parameters, as the experiment's file calls them",
            f"  fixed    {', '.join(closed)}",
            f"  written  {file}",
        ]
    )
