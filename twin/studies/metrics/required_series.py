"""Recorded series that a verdict needs: a third-party part must provide them for a run to be scored in full."""

from collections.abc import Container, Iterable

MEASURE_SERIES = {
    "the estimated force": ("plant.F_ee_B", "controller.F_z"),
    "error since the first touch": ("plant.F_ee_B", "controller.F_z_ref", "controller.triggered"),
    "lateral error": ("plant.p_B", "controller.p_ref_B"),
    "the estimated position": ("plant.p_B", "estimator.p_B"),
}
"""Measure that compares runs -> series that it needs; measures of a held force give their own reasons when missing."""
FIG4_SERIES = (
    "plant.p_B", "plant.F_ee_B", "scale.F_z", "estimator.p_B", "estimator.F_ee_B", "controller.p_ref_B",
    "controller.p_cmd_B", "controller.F_z", "controller.F_z_ref", "controller.triggered",
)  # fmt: skip
FIG5_SERIES = ("plant.p_B", "plant.v_B", "plant.F_ee_B", "controller.task", "controller.phase")
"""Series needed to judge the claims of Fig. 5; all of them are required."""


def missing_series(series: Iterable[str], fields: Container[str]) -> list[str]:
    return [name for name in series if name not in fields]
