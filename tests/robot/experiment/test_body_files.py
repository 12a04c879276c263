"""The body files: what they say holds together, follows from its sources, and fills in a [contact]."""

from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import EXPERIMENTS, ComponentStepper, shipped
from twin.kernel.errors import InputRefused
from twin.robot.assembly.build import plant_parameters
from twin.robot.experiment.experiment_files import fill_from_body
from twin.robot.experiment.source import Source, apply_overrides, read_source
from twin.robot.plant.component import Plant, rest_state
from twin.robot.plant.contact_law import Contact, elastic_force

BODIES = sorted(path.stem for path in (EXPERIMENTS / "bodies").glob("*.toml"))
over_every_body = pytest.mark.parametrize("name", BODIES)

TISSUES = {
    "belly": (15e3, 0.040),
    "back": (30e3, 0.040),
    "shoulder": (35e3, 0.025),
    "upper_arm": (20e3, 0.030),
    "forearm": (30e3, 0.020),
    "thigh": (20e3, 0.050),
    "calf": (50e3, 0.040),
}
"""Modulus (Pa) and thickness (m) that docs/contact.md states."""
HEAD, NU = 0.010, 0.45
ISO = {"belly": 10e3, "back": 35e3, "shoulder": 35e3, "upper_arm": 30e3, "forearm": 40e3, "thigh": 50e3, "calf": 60e3}
"""Effective spring constants (N/m) of ISO/TS 15066:2016, Annex A."""


def body(name: str) -> Source:
    source = Source(values={"contact": {"body": name}}, origins={"contact.body": "set in test.toml"})
    fill_from_body(source, EXPERIMENTS)
    return source


def contact_of(name: str) -> Contact:
    return Contact.model_validate(body(name).values["contact"])


def kappa(aspect: float) -> float:
    """Hayes et al. (1972): stiffness of a bonded layer under a disc of radius a = aspect times its thickness, over that
    of a half-space; their integral equation by Gauss-Legendre quadrature.
    """
    k = 3.0 - 4.0 * NU
    t, w = np.polynomial.legendre.leggauss(40)
    t, w = (t + 1.0) / 2.0, w / 2.0
    u, wu = np.polynomial.legendre.leggauss(300)
    u, wu = 15.0 * (u + 1.0), 15.0 * wu
    layer = (2.0 * k * np.sinh(2.0 * u) - 4.0 * u) / (2.0 * k * np.cosh(2.0 * u) + 1.0 + k * k + 4.0 * u * u)
    waves = np.cos(aspect * np.outer(t, u))
    kernel = 2.0 / np.pi * aspect * (waves * ((1.0 - layer) * wu)) @ waves.T
    return float(w @ np.linalg.solve(np.eye(len(t)) - kernel * w, np.ones(len(t))))


def test_the_regions_of_a_massage_are_there():
    assert BODIES == ["back", "belly", "calf", "forearm", "scale", "shoulder", "thigh", "upper_arm"]


@over_every_body
def test_every_number_states_its_source(name):
    origins = read_source(EXPERIMENTS / "bodies" / f"{name}.toml").origins
    unsourced = {key.rpartition(".")[2] for key, origin in origins.items() if origin.startswith("set in")}
    assert unsourced <= {"kind", "law", "shape"}


@over_every_body
def test_every_body_is_a_complete_contact_at_the_height_of_the_scale(name):
    contact = contact_of(name)
    assert contact.height == -0.101
    assert contact.kind == ("scale" if name == "scale" else "skin")


def test_the_scale_is_that_of_the_paper():
    assert contact_of("scale") == shipped().contact.model_copy(update={"body": "scale"})


@pytest.mark.parametrize("name", TISSUES)
def test_stiffness_follows_from_the_modulus_and_the_thickness_of_the_tissue(name):
    E, thickness = TISSUES[name]
    contact = contact_of(name)
    half_space = 2.0 * HEAD * E / (1.0 - NU**2)
    # rounded to two or three digits in the files
    assert contact.stiffness == pytest.approx(half_space * kappa(HEAD / thickness), rel=0.01)
    assert contact.bristle == pytest.approx(half_space * 2.0 * (1.0 - NU) / (2.0 - NU), rel=0.015)


@pytest.mark.parametrize("name", ISO)
def test_a_massage_stays_far_below_the_stiffness_of_a_collision(name):
    contact = contact_of(name)
    assert 300.0 <= contact.stiffness <= 3000.0
    parameters = plant_parameters(shipped().plant, contact)
    # up to 10 mm and twice the force of Fig. 4, the secant
    depths = np.linspace(1e-3, 10e-3, 10)
    forces = np.array([elastic_force(parameters, d) for d in depths])
    assert np.all(forces[forces < 10.0] / depths[forces < 10.0] < 0.5 * ISO[name])


def test_regions_follow_different_laws():
    laws = {name: contact_of(name).law for name in BODIES}
    assert laws["belly"] == "kelvin_voigt"
    assert laws["back"] == laws["shoulder"] == "exponential"
    assert {laws[limb] for limb in ("upper_arm", "forearm", "thigh", "calf")} == {"hunt_crossley"}


@over_every_body
def test_every_body_takes_an_impact_at_100_millimetres_per_second_at_a_tick_of_one(name):
    parameters = plant_parameters(shipped().plant, contact_of(name))
    x, theta_m = rest_state(parameters, (0.003, -0.004, -0.102))
    x[3:6] = [0.02, -0.03, -0.1]

    def trajectory(substeps):
        stepped = ComponentStepper(Plant(parameters, x, theta_m, substeps))
        return np.array([stepped(theta_m, 0.0, 1e-3)[18:21] for _ in range(150)])

    fine = trajectory(20)
    assert np.abs(fine[:, 2]).max() > 0.5
    # N; friction that sticks, slips and turns is of order one in the step
    assert np.abs(trajectory(1) - fine).max() < 0.02 * np.abs(fine[:, 2]).max()


def test_what_the_experiment_says_is_laid_over_its_body():
    source = Source()
    source.merge(
        {"contact": {"body": "back", "friction": 0.4, "breathing": {"rate_per_min": 20.0}}}, "set in mine.toml"
    )
    fill_from_body(source, EXPERIMENTS)
    contact = Contact.model_validate(source.values["contact"])
    assert (contact.body, contact.friction, contact.stiffness) == ("back", 0.4, 1000.0)
    assert contact.breathing is not None
    assert (contact.breathing.rate, contact.breathing.amplitude) == (pytest.approx(1.0 / 3.0), 0.001)
    assert source.origins["contact.friction"] == "set in mine.toml"
    assert source.origins["contact.stiffness_N_per_m"].startswith("derived: 2 a E kappa")


def test_a_body_of_the_command_line_keeps_the_height_alone():
    source = read_source(EXPERIMENTS / "fig4_force_position.toml")
    apply_overrides(source, ["contact.height_mm=-99"])
    source.select_file("contact", "body", "belly")
    fill_from_body(source, EXPERIMENTS)
    contact = Contact.model_validate(source.values["contact"])
    assert (contact.height, contact.stiffness, contact.law) == (-0.099, 500.0, "kelvin_voigt")
    assert source.origins["contact.body"] == source.origins["contact.height_mm"] == "set on the command line"
    assert "Yap" in source.origins["contact.friction"]


def test_a_body_of_a_file_keeps_the_height_of_the_files_it_extends(tmp_path: Path):
    (tmp_path / "robot.toml").write_text("[contact]\nheight_mm = -141\nfriction = 0.1\n")
    (tmp_path / "press.toml").write_text("extends = 'robot.toml'\n[contact]\nbody = 'back'\n")
    source = read_source(tmp_path / "press.toml")
    assert source.values["contact"] == {"height_mm": -141, "body": "back"}
    fill_from_body(source, EXPERIMENTS)
    assert (source.values["contact"]["height_mm"], source.values["contact"]["friction"]) == (-141, 0.19)
    assert source.origins["contact.height_mm"] == "set in robot.toml"


def remark(values: dict[str, object], option: str | None = None, settings: tuple[str, ...] = ()) -> list[str]:
    source = Source()
    source.merge({"contact": values}, "set in mine.toml")
    if option:
        source.select_file("contact", "body", option)
    apply_overrides(source, settings)
    fill_from_body(source, EXPERIMENTS)
    return source.remarks


def test_a_body_without_a_height_reports_the_height_of_its_file():
    text = "surface at z = -101.0 mm, height_mm of back.toml (assumed: as high as the paper's scale (Sec. III.A.1))"
    assert remark({"body": "back"}) == remark({}, "back") == remark({"body": "calf"}, "back") == [text]


def test_a_body_chosen_apart_from_the_height_reports_the_height_of_the_experiment():
    kept = {"height_mm": {"value": -141.0, "source": "measured"}, "friction": 0.1}
    assert remark(kept, "back") == ["surface at z = -141.0 mm, height_mm of the experiment (measured)"]
    assert remark({"height_mm": -141.0}, "back") == [
        "surface at z = -141.0 mm, height_mm of the experiment (set in mine.toml)"
    ]


def test_a_height_set_together_with_the_body_is_not_reported():
    assert remark({"body": "back", "height_mm": -99.0}) == []
    assert remark({"body": "back"}, "calf", ("contact.height_mm=-99",)) == []


def test_without_a_body_nothing_is_filled_in():
    source = read_source(EXPERIMENTS / "fig4_force_position.toml")
    before = dict(source.values["contact"])
    fill_from_body(source, EXPERIMENTS)
    assert source.values["contact"] == before


def test_a_body_may_be_a_file_of_its_own(tmp_path: Path):
    (tmp_path / "mine.toml").write_text("[contact]\nfriction = 0.3\n")
    source = Source(values={"contact": {"body": "mine.toml"}})
    fill_from_body(source, tmp_path)
    assert source.values["contact"]["friction"] == 0.3


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("bak", "[contact] body = \"bak\": no such body; did you mean 'back'?"),
        ("xyz", 'body = "xyz": no such body; known are back, belly, calf, forearm, scale, shoulder, thigh, upper_arm'),
        (3, "[contact] body = 3: expected the name of a body in quotes"),
    ],
)
def test_a_body_that_is_not_there_is_refused(name, told):
    with pytest.raises(InputRefused) as refusal:
        fill_from_body(Source(values={"contact": {"body": name}}), EXPERIMENTS)
    assert told in str(refusal.value)


@pytest.mark.parametrize("text", ["title = 'no table'\n", "[contact]\nbody = 'back'\n", "contact = 3\n", ""])
def test_a_body_file_is_one_contact_table(tmp_path: Path, text: str):
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(InputRefused, match=r"mine\.toml: expected one table \[contact\], without 'body'"):
        fill_from_body(Source(values={"contact": {"body": "mine.toml"}}), tmp_path)
