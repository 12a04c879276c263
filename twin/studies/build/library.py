"""The robot's computer as a C interface: header, static libraries, an example that calls it."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from twin.errors import disk_refusals
from twin.monitor.reasons import Reason
from twin.runs.assembly.load import load_experiment
from twin.studies.answer import Answer
from twin.studies.build.emission import emitted_steps, object_files
from twin.studies.build.fixed import fixed
from twin.studies.build.interface import fields, header, parameters_of, step_ticks
from twin.studies.build.layout import laid_out
from twin.studies.build.linking import c_files, guid_of, refuse_platform, static_library
from twin.studies.build.parameters import parameters
from twin.studies.build.part import RobotPart, part_of
from twin.studies.build.part_fmu import HOME
from twin.studies.build.platforms import HERE, PLATFORMS, Platform, platforms_named
from twin.studies.build.tables import sizes, tables
from twin.writing import made_folder, write_bytes

PART = "controls"
LIBRARY = "libcomputer.a"
OURS = "computer_"
"""What all names of the library begin with that a program sees."""


def build_c(
    experiment: Path,
    platforms: Sequence[str],
    out: Path | None,
    settings: Sequence[str],
    say: Callable[[str], None],
) -> Answer:
    """Write what the robot's own computer runs, from the counts of the encoders to the speeds of the drives, as C.

    Args:
        experiment: file or name.
        platforms: for which beside x86-64 Linux, as FMI 3.0 calls them.
        out: the folder; None: results/build/EXPERIMENT/c.
        settings: laid over the experiment.
        say: told what is being done.

    Raises:
        InputRefused: the experiment cannot be used, or there is no compiler.
        NotWritten: the disk refuses.
    """
    targets = platforms_named(platforms)
    loaded = load_experiment(experiment, settings)
    folder = out or HOME / loaded.name / "c"
    part = part_of(loaded, PART)
    refuse_platform(folder, targets)
    offered = parameters(part)
    layout = laid_out(part, offered)
    layout = replace(layout, rows=tuple(row._replace(symbol=OURS + row.symbol) for row in layout.rows))
    closed = fixed(part, offered)
    # before what takes long
    made_folder(folder)
    steps = emitted_steps(layout, targets, say)
    source = tables(layout, layout.variables).encode()
    shared = c_files("part.h", "part.c", "computer.c", "main.c") | {
        "computer.h": header(part, layout),
        "fields.c": fields(part, layout),
        "tables.c": source,
    }
    guid = guid_of(*(step.content for step in steps[HERE]), *shared.values())
    shared["sizes.h"] = sizes(layout, layout.variables, guid, loaded.cosim.tick).encode()

    def library(platform: Platform) -> bytes:
        return static_library("computer.c", platform, shared | object_files(steps[platform]), folder)

    say("linking")
    with ThreadPoolExecutor() as threads:
        libraries = dict(zip(targets, threads.map(library, targets), strict=True))
    files = {name: shared[name] for name in ("computer.h", "main.c")} | {
        "README.md": _readme(part, targets, closed).encode(),
        **{f"{platform.name}/{LIBRARY}": content for platform, content in libraries.items()},
    }
    for name, content in files.items():
        made_folder((folder / name).parent)
        write_bytes(folder / name, content)
    with disk_refusals(folder, "cannot be tidied"):
        # what an earlier build has left does not belong to this header
        for other in PLATFORMS.keys() - {target.name for target in targets}:
            (folder / other / LIBRARY).unlink(missing_ok=True)
    names = [variable.name for variable in parameters_of(layout)]
    return Answer(_text(part, folder, targets, len(names), closed), {
        "folder": str(folder),
        "files": {name: len(content) for name, content in files.items()},
        "components": [component.name for component in part.components],
        "step_s": step_ticks(part) * loaded.cosim.tick,
        "platforms": [target.name for target in targets],
        "parameters": names,
        "fixed": closed,
    })  # fmt: skip


def _readme(part: RobotPart, platforms: Sequence[Platform], closed: Sequence[str]) -> str:
    experiment = part.experiment
    step = step_ticks(part) * experiment.cosim.tick
    names = ", ".join(component.name for component in part.components)
    rate = f" --rate {1 / step:g}" if step_ticks(part) < experiment.controller_ticks else ""
    reasons = ", ".join(f"{reason.value} {reason.name.lower().replace('_', ' ')}" for reason in Reason)
    lines = [
        f"# The robot's computer of {experiment.title}",
        "",
        f"{names}: from the counts of the encoders to the speeds of the drives, the very code that the twin runs.",
        f"A step every {1e3 * step:g} ms takes the counts of that instant; in the twin the drives have what follows",
        "from them at that same instant. `computer.h` says what goes in, what comes out, which parameters there are;",
        "`main.c` reads counts from a file and prints what the drives are told:",
        "",
        "```sh",
        *(_compile(platform) for platform in platforms),
        f"twin export RUN --csv --signals encoder{rate} --out counts.csv",
        "./main counts.csv",
        "```",
        "",
        "A library needs libm, and `memcpy` and `memset`, which a compiler takes for granted; all names in it begin",
        f"with `{OURS}`. On x86-64 Linux its numbers are the twin's, bit for bit; another libm may end `sin`, `cos` or",
        "`exp` in another bit.",
        "",
        *([f"`monitor.reason`: {reasons}.", ""] if part.component("monitor") else []),
        f"Fixed, because something was worked out of it when this was built: {', '.join(closed)}.",
        "",
    ]
    return "\n".join(lines)


def _compile(platform: Platform) -> str:
    if platform is HERE:
        return f"cc -O2 main.c {HERE.name}/{LIBRARY} -lm -o main"
    suffix = ".exe" if platform.suffix == "dll" else ""
    libm = " -lm" if platform.is_elf else ""
    target = platform.target
    return f"python -m ziglang cc -target {target} -O2 main.c {platform.name}/{LIBRARY}{libm} -o main{suffix}"


def _text(part: RobotPart, folder: Path, platforms: Sequence[Platform], open_ones: int, closed: Sequence[str]) -> str:
    return "\n".join(
        [
            f"C for the robot's own computer, of {part.experiment.name}",
            f"  runs on  {', '.join(platform.name for platform in platforms)}",
            f"  holds    {', '.join(component.name for component in part.components)}",
            f"  step     {1e3 * step_ticks(part) * part.experiment.cosim.tick:g} ms: counts in, motor speeds out",
            f"  open     {open_ones} parameters, as the experiment's file calls them",
            f"  fixed    {', '.join(closed)}",
            f"  written  {folder}: computer.h, main.c, README.md, PLATFORM/{LIBRARY}",
        ]
    )
