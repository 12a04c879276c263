"""The bodies of experiments/bodies beside people: what their curves are, as numbers and as a picture."""

import sys
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.plant.contact_law import Contact, elastic_force
from twin.robot.plant.dynamics import PlantParameters
from twin.studies.figure import BLUE, GREEN, GREY, INK, ORANGE, PINK, SKY, VERMILION, picture

Numbers = NDArray[np.float64]

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
REGIONS = ("back", "shoulder", "belly", "upper_arm", "forearm", "thigh", "calf")
COLORS = (BLUE, SKY, VERMILION, PINK, ORANGE, GREEN, INK)
HEAD = 0.010
"""Radius of the massage head (m), as docs/contact.md assumes it."""
FORCES = (2.0, 5.0, 8.0, 15.0)
"""N: a light touch, Fig. 4, a firm press, the monitor's limit."""
DEEPEST = 0.03


@cache
def body(name: str) -> tuple[Contact, PlantParameters]:
    """What its file says, and what the plant makes of it."""
    experiment = load_experiment(EXPERIMENTS / "fig4_force_position.toml", (), None, name)
    return experiment.contact, plant_parameters(experiment.plant, experiment.contact)


def force(name: str, depth: float) -> float:
    """N, held at a depth (m)."""
    return float(elastic_force(body(name)[1], depth))


def depth_at(name: str, held: float) -> float:
    """m, at which the body answers with the force `held` (N)."""
    from scipy.optimize import brentq

    return float(brentq(lambda d: force(name, d) - held, 1e-9, 0.1, xtol=1e-12))


def stiffness_at(name: str, held: float) -> float:
    """Slope (N/m) where the body answers with the force `held` (N)."""
    d, h = depth_at(name, held), 1e-6
    return (force(name, d + h) - force(name, d - h)) / (2.0 * h)


def pressure(held: float) -> float:
    """Mean pressure (Pa) under all of the head."""
    return held / (np.pi * HEAD**2)


def cells(name: str) -> list[str]:
    """The body's row in docs/bodies.md: depths at `FORCES`, slopes at the first touch that counts, 5 N and 15 N."""
    depths = (f"{1e3 * depth_at(name, held):.1f}" for held in FORCES)
    slopes = (f"{1e-3 * stiffness_at(name, held):.2f}" for held in (0.5, 5.0, 15.0))
    return [f"`{name}`", *depths, *slopes]


def draw(path: Path) -> None:
    """Force over depth of every body, to `path` (PNG)."""
    depths = np.linspace(1e-6, DEEPEST, 300)
    with picture(path, 9, 4.8, "Force over depth of the bodies") as figure:
        axes = figure.subplots()
        for name, color in zip(REGIONS, COLORS, strict=True):
            axes.plot(1e3 * depths, [force(name, d) for d in depths], color=color, lw=1.5, label=name.replace("_", " "))
        for held, label in ((5.0, "Fig. 4"), (15.0, "the monitor trips")):
            axes.axhline(held, color=GREY, lw=0.8, ls="--")
            axes.text(1e3 * DEEPEST, held, f"{label} ", color=GREY, ha="right", va="bottom", fontsize=9)
        axes.set(xlim=(0.0, 1e3 * DEEPEST), ylim=(0.0, 20.0), xlabel="depth (mm)", ylabel="force (N)")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.02), ncols=2, fontsize=9)


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
