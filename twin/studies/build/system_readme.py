"""What an SSP archive of a robot says of itself to people."""

from collections.abc import Mapping, Sequence

from twin.cosim.ssp.structure import Connection
from twin.cosim.ssp.unit import NONE
from twin.experiment.experiment import Experiment
from twin.studies.build.platforms import Platform
from twin.studies.build.structure import Member

_SCHEME = {
    "gauss_seidel": (
        "Step the elements one after the other in this order, and hand the values of each on at once (Gauss-Seidel): "
        "the computer, the drives, the plant. What leads back in this order (angles to the computer, the load to the "
        "drives) is what was valid before the step. In that order the system gives the trace of the twin's own run; "
        "where all exchange their values between steps (Jacobi), the computer's come a tick later and the plant sees "
        "the drives' angles of the tick before."
    ),
    "jacobi": (
        "Let all elements make a step, and exchange their values between steps (Jacobi). The step that the computer's "
        "values take to get to the drives is the tick of the bus that the experiment has (controller.bus_delay_ticks)."
    ),
}


def system_readme(
    experiment: Experiment,
    members: Sequence[Member],
    connections: Sequence[Connection],
    hashes: Mapping[str, str],
    platforms: Sequence[Platform],
) -> str:
    """documentation/README.md of the archive."""
    cosim = experiment.cosim
    lines = [
        f"# {experiment.name}",
        "",
        f"{experiment.title}. A robot as a system of FMUs for co-simulation, SSP 1.0, written by twin.",
        "",
        "| element | FMU | values | |",
        "|---|---|---|---|",
        *(f"| `{m.name}` | `{m.entry}` | {f'`{m.values.source}`' if m.values else ''} | {m.about} |" for m in members),
        "",
        f"FMUs of twin's own are native code for {', '.join(p.name for p in platforms)}; drives are as they came.",
        "",
        "## How to step it",
        "",
        f"Steps of {1e3 * cosim.tick:g} ms until {experiment.duration_ticks * cosim.tick:g} s. {_SCHEME[cosim.scheme]}",
        "",
        "## Lines on connections",
        "",
        "A drive counts from a zero of its own, and may have units and a gear of its own: these connections have a "
        "LinearTransformation, factor * value + offset, and no other conversion. For a master that leaves the offset "
        "away, set the start value of the drive's angle so that it begins where the robot rests; a last bit may be "
        "another one then.",
        "",
        "| from | to | factor | offset |",
        "|---|---|---|---|",
        *(
            f"| `{'.'.join(c.start)}` | `{'.'.join(c.end)}` | {c.transformation.factor!r} | "
            f"{c.transformation.offset!r} |"
            for c in connections
            if c.transformation != NONE
        ),
        "",
        "## What it was made of",
        "",
        "| file | SHA-256 |",
        "|---|---|",
        *(f"| `{entry}` | `{digest}` |" for entry, digest in hashes.items()),
        "",
    ]
    return "\n".join(lines)
