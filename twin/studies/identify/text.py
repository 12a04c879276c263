"""Report of an identification: text, TOML to paste, picture, and the truth of a simulated log."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from twin.kernel.atomic_write import inline_table
from twin.kernel.errors import escape_controls
from twin.robot.experiment.schema import Cosim
from twin.robot.plant.dynamics import TrueRobot, series_share, spring_stiffness
from twin.studies.figure import INK, JOINT_COLORS, PAPER_BLUE, PAPER_ORANGE, RED, Axes, picture
from twin.studies.identify.estimate import Estimate, decimals, display_unit, display_value
from twin.studies.identify.identification import Identification, Quantity
from twin.studies.identify.one_pose import PRINTED_STEP
from twin.studies.identify.windows import JOINTS_PER_METRE
from twin.studies.replay.model import RobotModel
from twin.studies.result import Block, Column, Note, Result, Table, note

ALL_THREE = {"zero of joint": "zeros of the joints", "zero of deflection": "zeros of the deflections"}
QUANTITY_COLUMNS = (Column("", 27, left=True), Column("found", 9), Column("+- 95 %", 9), Column("", 10, left=True),
           Column("believed", 9))  # fmt: skip
PAPER_COLUMNS = (Column("", 20, left=True), Column("", 8, ".3f"), Column("", 6, "+.1f", gap=2), Column(""))
LOADING_COLOR, UNLOADING_COLOR = PAPER_BLUE, PAPER_ORANGE
MIN_LOADING_SPEED = 5e-4
"""Minimum speed in z of loading or unloading (m/s)."""


def truth(model: RobotModel) -> Mapping[str, float]:
    """Collect the true values of a simulated robot's plant, by the names of `identification.Quantity`, SI.

    The viscous friction is the apparent one of encoders read at the same instant. A co-simulation holds the motor angle
    over its tick H: the spring sees it half a tick early (Gauss-Seidel) or late (Jacobi), a torque k_s eta N^2 H/2
    theta_l' along or against the motion (docs/physics.md, "Springs are inside the plant").
    """
    plant = TrueRobot.model_validate(model.values["plant"])
    surface = model.plant
    k_s = spring_stiffness(surface, 0) * series_share(surface, 0)
    k = k_s * plant.eta
    motor, joint = np.array(plant.motor_zero), np.array(plant.joint_zero)
    scheme = Cosim.model_validate(model.values.get("cosim", {})).scheme
    early = 0.5 * model.tick if scheme == "gauss_seidel" else -0.5 * model.tick
    directed = plant.eta_rate > 0.0
    return {
        "k_s_eta": k_s if directed else k,
        "k_s": k_s,
        "eta": plant.eta,
        **{f"deflection_zero_{i + 1}": float(motor[i] - plant.N * joint[i]) for i in range(3)},
        **{f"joint_zero_{i + 1}": float(joint[i]) for i in range(3)},
        "backlash": plant.backlash,
        "b_j": plant.b_j - k * plant.N**2 * early,
        "height": surface.z_s,
        # the normal of `surface_frame` of the plant leans towards +x and -y
        "slope_x": -float(np.tan(surface.tilt)),
        "slope_y": float(np.tan(surface.tilt_x)),
        "stiffness": surface.K,
        "damping": surface.damping,
        "delay": 0.0,
        "friction": surface.mu,
    }


def identification_result(
    one: Identification,
    name: str,
    files: dict[str, str],
    true: Mapping[str, float],
    facts: dict[str, object],
    paper: bool = False,
) -> Result:
    """Create the report of an identification.

    Args:
        files: kind -> path.
        true: values of a run of the twin, SI; empty for other logs.
    """
    k = one.quantities["k_s_eta"]
    assert k.found is not None and k.believed is not None
    digits = decimals(k.found)
    verdict = (
        f"{name}: {k.meaning} = {k.found.value:.{digits}f} +- {k.found.half_width:.{digits}f} N m/rad (95 %), "
        f"believed {k.believed:g}"
    )
    rows = [_row(name, quantity, true) for name, quantity in one.quantities.items() if quantity.found is not None]
    parts = [
        "",
        Table([*QUANTITY_COLUMNS, *([Column("true", 9)] if true else [])], rows),
        "",
        "  Not identifiable from this log:",
        *(Note(text, "    ", 6, whole=True) for text in _unknown(one)),
        "",
        *(_paper(one) if paper else []),
        *_residuals(one),
        *(note("note", text, whole=True) for text in one.notes),
    ]
    return Result(Note(verdict, later=2, whole=True), parts, facts | files, files)


def _row(name: str, quantity: Quantity, true: Mapping[str, float]) -> list[str]:
    found = quantity.found
    assert found is not None
    digits, unit = decimals(found), found.unit

    def format_number(value: float | None) -> str:
        return Column(form=f".{digits}f").text(None if value is None else display_value(value, unit))

    numbers = [format_number(value) for value in (found.value, found.half_width, quantity.believed)]
    cells = [*numbers[:2], display_unit(unit), numbers[2]]
    return [quantity.meaning, *cells, *([format_number(true.get(name))] if true else [])]


def _unknown(one: Identification) -> list[str]:
    reasons = []
    if one.quantities["k_s"].found is None:
        agree = "loading and unloading agree" if one.knows_loss else "loading is not compared with unloading"
        reasons.append(
            f"k_s and eta one by one: encoders and scale see only their product (20), and {agree}; a measured motor "
            "torque would separate them (--motor-torque)"
        )
    others = (quantity for name, quantity in one.quantities.items() if name not in ("k_s", "eta", "friction"))
    if missing := [quantity.meaning for quantity in others if quantity.found is None]:
        reasons.append(f"{_list(missing)}: uncertain by more than a tenth of their plausible range")
    if one.quantities["friction"].found is None:
        reasons.append("friction under the head: no sweep under load that is long enough")
    alike = dict.fromkeys(_list(group) for group in one.inseparable if len(group) > 1)
    reasons += [f"trade against each other: {names}" for names in alike]
    if "height" in one.quantities:
        reasons.append("joint zeros as well as a level scale of known height would give them: measure it (--height MM)")
    return [
        *reasons,
        "b_j by itself: encoders of motor and joint that are read dt apart look like friction of k_s eta N^2 dt",
        "lengths, N and masses: taken from the experiment; weigh and measure them",
    ]


def _list(names: Sequence[str]) -> str:
    """Join names to a list in words, with three of a kind as one name."""
    names = list(names)
    for one, all_three in ALL_THREE.items():
        numbered = [f"{one} {i}" for i in (1, 2, 3)]
        if set(numbered) <= set(names):
            names[names.index(numbered[0])] = all_three
            names = [name for name in names if name not in numbered]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _paper(one: Identification) -> list[Block]:
    press = one.one_pose
    if press is None:
        return [note("paper", "no gradual press in one place, so Sec. III.A cannot be followed", whole=True)]
    k = one.fit.x[0]
    # + 0.0: no minus before a zero
    x, y = (1e3 * press.place).round() + 0.0
    text = (
        f"Sec. III.A on the press of {press.start:.1f} to {press.end:.1f} s at ({x:.0f}, {y:.0f}) mm, "
        f"{press.force[0]:.1f} to {press.force[-1]:.1f} N, k_s eta by a line through the origin:"
    )
    rows = [(name, k_s_eta, 100.0 * (k_s_eta / k - 1.0), "%") for name, k_s_eta in press.steps.items()]
    return [note("paper", text, whole=True), Table(PAPER_COLUMNS, rows, indent=4), ""]


def _residuals(one: Identification) -> list[Block]:
    fit = one.fit
    air, scale = int((fit.rows.kind == 0).sum()) // 3, int((fit.rows.kind == 1).sum())
    share = fit.misfit(0, 1, 2)
    text = (
        f"{air} windows of {fit.seen.length:g} s in free air, {scale} on the scale, in {fit.clusters} independent "
        f"stretches; residuals are {share:.2f} of what rounding leaves in one sample"
    )
    doubt = "more than rounding explains: lengths, masses or the scale are not as believed"
    return [note("fit", text, whole=True), *([note("doubt", doubt, whole=True)] if share > 1.0 else [])]


def identification_facts(one: Identification, log: str, true: Mapping[str, float]) -> dict[str, object]:
    """Convert all results of an identification to numbers, SI; undetermined values are None."""
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
        "only_together": [list(group) for group in one.inseparable],
        "singular_values": one.fit.singular.tolist(),
        "windows": len(one.fit.seen.t),
        "clusters": one.fit.clusters,
        "one_pose": press.steps if press else None,
        "notes": list(one.notes),
    }


def model_fragment(one: Identification, log: str) -> str:
    """Create the TOML tables [controller] and [controller.model] with the determined values only; `log`: file name.

    [plant] follows as a comment: a simulated robot keeps its own springs.
    """
    belief, q = one.model.belief, one.quantities
    k = one.estimate("k_s_eta")
    d = decimals(k)
    says = f"identified from {log}: k_s eta = {k.value:.{d}f} +- {k.half_width:.{d}f} (95 %)"
    eta = q["eta"].found
    k_s = one.estimate("k_s").value if eta is not None else k.value / belief.eta
    says = says if eta else f"{says}, eta as believed"
    model = {"k_s_Nm_per_rad": inline_table({"value": round(k_s, d), "source": says})}
    if eta is not None:
        model["eta"] = inline_table({"value": round(min(eta.value, 1.0), d), "source": f"identified from {log}"})
    joints = [q[f"joint_zero_{i}"].found for i in (1, 2, 3)]
    believed = np.array(belief.joint_zero)
    zero = np.array([j.value if j else b for j, b in zip(joints, believed, strict=True)]) if all(joints) else believed
    zeros = [q[f"deflection_zero_{i}"].found for i in (1, 2, 3)]
    if all(zeros):
        motor = np.array([w.value for w in zeros if w]) + belief.N * zero
        model["motor_zero_deg"] = _zeros(motor, f"identified from {log}: within {_width(zeros)} of N joint zeros")
    if all(joints):
        model["joint_zero_deg"] = _zeros(zero, f"identified from {log}: +- {_width(joints)}")
    controller: dict[str, Any] = {"model": model}
    plant: dict[str, Any] = {key: model[key] for key in ("k_s_Nm_per_rad", "eta") if key in model}
    backlash = q["backlash"].found
    if backlash is not None and backlash.value >= 0.0:
        digits = decimals(backlash)
        source = f"identified from {log}: +- {display_value(backlash.half_width, 'rad'):.{digits}f} deg"
        value = round(display_value(backlash.value, "rad"), digits)
        controller = {"dead_zone_deg": inline_table({"value": value, "source": source})} | controller
        plant["backlash_deg"] = controller["dead_zone_deg"]
    head = f"# identified from {escape_controls(log)}; lay it over an experiment, or paste it there\n"
    robot = "for the twin of a real robot (`twin shadow`, `twin replay --plant`), also:\n"
    robot += tomlkit.dumps({"plant": plant})
    return head + tomlkit.dumps({"controller": controller}) + "\n" + "".join(f"# {x}\n" for x in robot.splitlines())


def _zeros(angles: np.ndarray, source: str) -> Any:
    return inline_table({"value": [round(float(angle), 4) for angle in np.degrees(angles)], "source": source})


def _width(found: Sequence[Estimate | None]) -> str:
    """Format the widest of several 95 % intervals (deg)."""
    return f"{max(display_value(one.half_width, 'rad') for one in found if one):.2g} deg"


def draw_identification(one: Identification, name: str, path: Path) -> None:
    k = one.estimate("k_s_eta")
    with picture(path, 11, 8, f"{name}: k_s eta = {k.value:.4f} +- {k.half_width:.4f} N m/rad") as figure:
        draws = (_draw_force, _draw_air, _draw_depth, _draw_paper)
        for draw, panel in zip(draws, figure.subplots(2, 2).flat, strict=True):
            draw(panel, one)


def _of_kind(one: Identification, kind: int) -> tuple[np.ndarray, np.ndarray]:
    rows = one.fit.rows
    return rows.residual[rows.kind == kind], rows.window[rows.kind == kind]


def _draw_force(axes: Axes, one: Identification) -> None:
    _, window = _of_kind(one, 1)
    F, r = one.fit.seen.force[window], one.fit.force_residual
    _draw_halves(axes, one, window, F, r)
    for side in (-0.5, 0.5):
        axes.axhline(side * max(one.model.resolution, 0.0), color="0.5", lw=0.8, ls="--")
    axes.set_title("on the scale: force by the springs less the reading", fontsize="medium", loc="left")
    axes.set(xlabel="scale (N); dashed: half a step of its display", ylabel="residual (N)")
    if len(F):
        axes.legend(fontsize="small", loc="best")


def _draw_halves(axes: Axes, one: Identification, window: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    down = np.mean(one.fit.seen.speed[window], axis=1) / JOINTS_PER_METRE
    for chosen, color, label in (
        (down > MIN_LOADING_SPEED, LOADING_COLOR, "loading"),
        (down < -MIN_LOADING_SPEED, UNLOADING_COLOR, "unloading"),
        (np.abs(down) <= MIN_LOADING_SPEED, "0.6", "sweeping"),
    ):
        if np.any(chosen):
            axes.plot(x[chosen], y[chosen], ".", ms=4, color=color, alpha=0.7, label=label)


def _draw_air(axes: Axes, one: Identification) -> None:
    r, window = _of_kind(one, 0)
    t = one.fit.seen.t[window[::3]]
    for i, color in enumerate(JOINT_COLORS):
        axes.plot(t, np.degrees(r[i::3]), ".", ms=3, color=color, alpha=0.7, label=f"joint {i + 1}")
    axes.set_title("in free air: deflection less that of the robot's weight", fontsize="medium", loc="left")
    axes.set(xlabel="time (s)", ylabel="residual (deg, motor side)")
    if len(t):
        axes.legend(fontsize="small", loc="best", ncols=3)


def _draw_depth(axes: Axes, one: Identification) -> None:
    r, window = _of_kind(one, 2)
    _draw_halves(axes, one, window, one.fit.seen.force[window], 1e6 * r)
    axes.set_title("the scale's own law: height less z_s - F/K/(1 - c p_z')", fontsize="medium", loc="left")
    axes.set(xlabel="scale (N)", ylabel="residual (micrometres)")


def _draw_paper(axes: Axes, one: Identification) -> None:
    axes.set_title("Sec. III.A as printed: one press, a line through 0", fontsize="medium", loc="left")
    press = one.one_pose
    if press is None:
        axes.text(0.5, 0.5, "no gradual press in one place", ha="center", va="center", transform=axes.transAxes)
        return
    believed = one.model.belief.k_s * one.model.belief.eta
    axes.plot(press.calculated, press.force, "o", ms=4, color=INK, label="measured, against (27)")
    reach = np.array([min(0.0, float(press.calculated.min())), float(press.calculated.max())])
    printed = press.steps[PRINTED_STEP]
    axes.plot(reach, printed / believed * reach, color=RED, label=f"{PRINTED_STEP}: k_s eta = {printed:.3f}")
    slope = one.fit.x[0] / believed
    middle = press.calculated.mean(), press.force.mean()
    axes.plot(
        reach, middle[1] + slope * (reach - middle[0]), color=LOADING_COLOR, ls="--",
        label=f"slope of the identified {one.fit.x[0]:.3f}",
    )  # fmt: skip
    axes.set(xlabel="F_z by (20) to (27), believed k_s eta (N)", ylabel="scale (N)")
    axes.legend(fontsize="small", loc="best")
