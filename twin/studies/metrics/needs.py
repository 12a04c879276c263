"""Which series each verdict rests on: what a part of another make has to put out for a run to be scored in full."""

from collections.abc import Container, Iterable

MEASURES = {
    "the estimated force": ("plant.F_ee_B", "controller.F_z"),
    "settling": ("plant.F_ee_B", "controller.F_z_ref"),
    "overshoot": ("plant.F_ee_B", "controller.F_z_ref"),
    "force error": ("plant.F_ee_B", "controller.F_z_ref", "controller.triggered"),
    "settled force error": ("plant.F_ee_B", "controller.F_z_ref"),
    "distance from the path": ("plant.p_B", "controller.p_ref_B"),
    "the estimated position": ("plant.p_B", "estimator.p_B"),
}
"""Short names of a report's measures, by which runs are compared -> the series that each needs."""
OF_A_CONSTANT_FORCE = ("settling", "overshoot", "settled force error")
"""Measures of runs without tasks."""
FIG4 = (
    "plant.p_B", "plant.F_ee_B", "scale.F_z", "estimator.p_B", "estimator.F_ee_B", "controller.p_ref_B",
    "controller.p_cmd_B", "controller.F_z", "controller.F_z_ref", "controller.triggered",
)  # fmt: skip
"""What the claims of Fig. 4 are judged on."""
FIG5 = ("plant.p_B", "plant.v_B", "plant.F_ee_B", "controller.task", "controller.phase")
"""What the claims of Fig. 5 are judged on: without any of these nothing can be said."""


def lacking(series: Iterable[str], fields: Container[str]) -> list[str]:
    """Those of `series` that are not among `fields`."""
    return [name for name in series if name not in fields]
