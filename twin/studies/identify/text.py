"""An identification as text of at most 80 columns: the answer, the table, what cannot be had, the paper's way."""

from collections.abc import Mapping, Sequence
from functools import partial

from twin.studies.identify.identification import Identification, Quantity
from twin.studies.identify.units import decimals, shown, shown_unit
from twin.studies.lines import labelled, wrapped

ALL_THREE = {"zero of joint": "zeros of the joints", "zero of wind-up": "zeros of the wind-ups"}


def identification_text(one: Identification, name: str, files: Mapping[str, str], true: Mapping[str, float]) -> str:
    """The whole report. name: of the log; files: kind -> path; true: values of a run of the twin, SI, or nothing."""
    k = one.quantities["k_s_eta"]
    assert k.found is not None and k.believed is not None
    digits = decimals(k.found)
    verdict = (
        f"{name}: {k.meaning} = {k.found.value:.{digits}f} +- {k.found.half_width:.{digits}f} N m/rad (95 %), "
        f"believed {k.believed:g}"
    )
    lines = [
        *wrapped(verdict, later=2, whole=True),
        "",
        *_table(one, true),
        *_unknown(one),
        *_paper(one),
        *_residuals(one),
    ]
    for note in one.notes:
        lines += _labelled("note", note)
    return "\n".join([*lines, *(f"  {kind:<10} {path}" for kind, path in files.items())])


def _table(one: Identification, true: Mapping[str, float]) -> list[str]:
    head = f"  {'':<27} {'found':>9} {'+- 95 %':>9} {'':<10} {'believed':>9}"
    rows = [head + (f" {'true':>9}" if true else "")]
    for name, quantity in one.quantities.items():
        if quantity.found is not None:
            rows.append(_row(name, quantity, true))
    return [row.rstrip() for row in rows]


def _row(name: str, quantity: Quantity, true: Mapping[str, float]) -> str:
    found = quantity.found
    assert found is not None
    digits, unit = decimals(found), found.unit

    def told(value: float | None) -> str:
        # + 0.0: no minus before a zero
        return "" if value is None else f"{round(shown(value, unit), digits) + 0.0:.{digits}f}"

    row = f"  {quantity.meaning:<27} {told(found.value):>9} {told(found.half_width):>9} {shown_unit(unit):<10}"
    row += f" {told(quantity.believed):>9}"
    return row + (f" {told(true.get(name)):>9}" if true else "")


def _unknown(one: Identification) -> list[str]:
    """What this log does not say, in plain words."""
    lines = ["", "  Not identifiable from this log:"]
    if not one.apart:
        loss = (
            "and loading and unloading agree" if one.loss is not None else "and loading is not compared with unloading"
        )
        lines += _item(
            f"k_s and eta one by one: encoders and scale see only their product (20), {loss}; a measured motor torque "
            "would part them (--motor-torque)"
        )
    missing = [
        quantity.meaning
        for name, quantity in one.quantities.items()
        if quantity.found is None and name not in ("k_s", "eta", "friction")
    ]
    if missing:
        lines += _item(f"{_list(missing)}: less sure than a tenth of what they may plausibly be")
    if one.quantities["friction"].found is None:
        lines += _item("friction under the head: no sweep under load that is long enough")
    for told in dict.fromkeys(_list(group) for group in one.alike if len(group) > 1):
        lines += _item(f"trade against each other: {told}")
    if "height" in one.quantities:
        lines += _item("joint zeros as well as a level scale of known height would give them: measure it (--height MM)")
    lines += _item(
        "b_j by itself: encoders of motor and joint that are read dt apart look like friction of k_s eta N^2 dt"
    )
    lines += _item("lengths, N and masses: taken from the experiment; weigh and measure them")
    return [*lines, ""]


def _list(names: Sequence[str]) -> str:
    """Names as people list them, three of a kind as one."""
    names = list(names)
    for one, all_three in ALL_THREE.items():
        numbered = [f"{one} {i}" for i in (1, 2, 3)]
        if set(numbered) <= set(names):
            names[names.index(numbered[0])] = all_three
            names = [name for name in names if name not in numbered]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _paper(one: Identification) -> list[str]:
    """The paper's procedure and its bias."""
    press = one.one_pose
    if press is None:
        return _labelled("paper", "no gradual press in one place, so Sec. III.A cannot be followed")
    k = one.fit.x[0]
    # + 0.0: no minus before a zero
    x, y = (1e3 * press.place).round() + 0.0
    lines = _labelled(
        "paper",
        f"Sec. III.A on the press of {press.start:.1f} to {press.end:.1f} s at ({x:.0f}, {y:.0f}) mm, "
        f"{press.force[0]:.1f} to {press.force[-1]:.1f} N, k_s eta by a line through the origin:",
    )
    for step in press.steps:
        lines.append(f"    {step.name:<20} {step.k_s_eta:>8.3f}  {100.0 * (step.k_s_eta / k - 1.0):>+6.1f} %")
    return [*lines, ""]


def _residuals(one: Identification) -> list[str]:
    fit = one.fit
    air, scale = int((fit.rows.kind == 0).sum()) // 3, int((fit.rows.kind == 1).sum())
    share = fit.misfit(0, 1, 2)
    lines = _labelled(
        "fit",
        f"{air} windows of {fit.seen.length:g} s in free air, {scale} on the scale, in {fit.clusters} independent "
        f"stretches; residuals are {share:.2f} of what rounding leaves in one sample",
    )
    if share > 1.0:
        lines += _labelled("doubt", "more than rounding explains: lengths, masses or the scale are not as believed")
    return lines


def _item(text: str) -> list[str]:
    return wrapped(text, "    ", 6, whole=True)


_labelled = partial(labelled, whole=True)


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
