"""What was identified as TOML: a fragment to lay over an experiment, each value with its interval as its source."""

import numpy as np

from twin.studies.identify.identification import Identification
from twin.studies.identify.units import decimals, shown


def model_fragment(one: Identification, log: str) -> str:
    """[controller] and [controller.model] with what was found; what was not stays as it is. log: the file's name."""
    belief, q = one.model.belief, one.quantities
    k = one.estimate("k_s_eta")
    d = decimals(k)
    says = f"identified from {log}: k_s eta = {k.value:.{d}f} +- {k.half_width:.{d}f} (95 %)"
    eta = q["eta"].found
    k_s = one.estimate("k_s").value if eta is not None else k.value / belief.eta
    rows = {"k_s_Nm_per_rad": (f"{k_s:.{d}f}", says if eta else f"{says}, eta as believed")}
    if eta is not None:
        rows["eta"] = (f"{min(eta.value, 1.0):.{d}f}", f"identified from {log}")
    joints = [q[f"joint_zero_{i}"].found for i in (1, 2, 3)]
    believed = np.array(belief.joint_zero)
    zero = np.array([j.value if j else b for j, b in zip(joints, believed, strict=True)]) if all(joints) else believed
    winds = [q[f"wind_up_zero_{i}"].found for i in (1, 2, 3)]
    if all(winds):
        motor = np.array([w.value for w in winds if w]) + belief.N * zero
        width = max(shown(w.half_width, "rad") for w in winds if w)
        rows["motor_zero_deg"] = (_degrees(motor), f"identified from {log}: within {width:.2g} deg of N joint zeros")
    if all(joints):
        width = max(shown(j.half_width, "rad") for j in joints if j)
        rows["joint_zero_deg"] = (_degrees(zero), f"identified from {log}: +- {width:.2g} deg")
    lines = [f"# identified from {log}; lay it over an experiment, or paste it there", "[controller]"]
    backlash = q["backlash"].found
    if backlash is not None and backlash.value >= 0.0:
        digits = decimals(backlash)
        lines.append(
            f'dead_zone_deg = {{ value = {shown(backlash.value, "rad"):.{digits}f}, source = "identified from {log}: '
            f'+- {shown(backlash.half_width, "rad"):.{digits}f} deg" }}'
        )
    lines += ["", "[controller.model]"]
    lines += [f'{key} = {{ value = {value}, source = "{source}" }}' for key, (value, source) in rows.items()]
    return "\n".join(lines) + "\n"


def _degrees(angles: np.ndarray) -> str:
    return "[" + ", ".join(f"{np.degrees(angle):.4f}" for angle in angles) + "]"
