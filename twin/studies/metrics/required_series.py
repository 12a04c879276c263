"""Series that verdicts rest on: a third-party part has to provide them for a run to be scored in full."""

from collections.abc import Container, Iterable

MEASURE_SERIES = {
    "the estimated force": ("plant.F_ee_B", "controller.F_z"),
    "error since the first touch": ("plant.F_ee_B", "controller.F_z_ref", "controller.triggered"),
    "lateral error": ("plant.p_B", "controller.p_ref_B"),
    "the estimated position": ("plant.p_B", "estimator.p_B"),
}
"""Names of a report's measures, by which runs are compared -> the series that each needs. Those of a held force have
reasons of their own."""
FIG4_SERIES = (
    "plant.p_B", "plant.F_ee_B", "scale.F_z", "estimator.p_B", "estimator.F_ee_B", "controller.p_ref_B",
    "controller.p_cmd_B", "controller.F_z", "controller.F_z_ref", "controller.triggered",
)  # fmt: skip
"""What the claims of Fig. 4 are judged on."""
FIG5_SERIES = ("plant.p_B", "plant.v_B", "plant.F_ee_B", "controller.task", "controller.phase")
"""What the claims of Fig. 5 are judged on: without any of these nothing can be said."""


def missing_series(series: Iterable[str], fields: Container[str]) -> list[str]:
    """Those of `series` that are not among `fields`."""
    return [name for name in series if name not in fields]
