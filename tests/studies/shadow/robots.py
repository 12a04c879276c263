"""Robots for the shadow: runs of the twin, robots that wander as the filter says; and the filter written anew."""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.stats import chi2

from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import OUTWARD, Geometry
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.plant.equations import PlantEquations
from twin.robot.run.trace import Trace, run_in_memory
from twin.studies.converge.monolith import ComponentStepper
from twin.studies.replay.samples import RobotSamples, samples_of
from twin.studies.shadow.filter_steps import Columns, filter_outputs, shadow_of
from twin.studies.shadow.fleet import SCALE_SETTINGS, Fleet, read_fleet
from twin.studies.shadow.layout import Noises, ShadowDrive

EXPERIMENTS = Path(__file__).resolve().parents[3] / "experiments"
FLEET = EXPERIMENTS / "sweeps" / "healthy_fleet.toml"
FIG4 = EXPERIMENTS / "fig4_force_position.toml"
NOISE = ("plant.motor_noise_deg=0.05", "plant.joint_noise_deg=0.02")
"""More than half a count: rounding is white then (B. Widrow, IRE Trans. Circuit Theory 3 (1956) 266)."""
STATE = ("p_B", "v_B", "theta_m", "omega_m", "F_ee_B")


def shipped_fleet(experiment: Path, settings: tuple[str, ...] = ()) -> Fleet:
    """The shipped healthy robots around an experiment."""
    return read_fleet(FLEET, experiment, settings=settings)


class Run(NamedTuple):
    """A run of the twin and its shadow.

    Attributes:
        y: of the shadow. truth: (n, 15), as its state. touching: (n,). static: what the controller's estimate of the
        force is off by (n, 3), N.
    """

    experiment: Experiment
    samples: RobotSamples
    y: Columns
    truth: NDArray[np.float64]
    touching: NDArray[np.bool_]
    static: NDArray[np.float64]

    @property
    def error(self) -> NDArray[np.float64]:
        """(n, 15)."""
        return np.column_stack([self.y[name] for name in STATE]) - self.truth


@cache
def ran(name: str, *settings: str) -> Run:
    """experiments/NAME.toml, its shadow believing the same."""
    experiment = load_experiment(EXPERIMENTS / f"{name}.toml", settings)
    run = run_in_memory(experiment, experiment.controller_ticks)
    samples = samples_of(run)
    y = filter_outputs(shadow_of(experiment), samples)
    force = run.held("plant.F_ee_B")
    return Run(experiment, samples, y, true_state(run), run.held("plant.F_n") > 0.05, run["estimator.F_ee_B"] - force)


def true_state(run: Trace) -> NDArray[np.float64]:
    """(n, 15)."""
    shafts = [run.of_drives(name) for name in ("theta_m", "omega_m")]
    return np.column_stack([run.held("plant.p_B"), run.held("plant.v_B"), *shafts, run.held("plant.F_ee_B")])


@cache
def experiment(*settings: str) -> Experiment:
    return load_experiment(FIG4, [*SCALE_SETTINGS, *settings])


class Wandering(NamedTuple):
    """A robot that wanders as the filter says.

    Attributes:
        samples: of it. x: its state at each (n, 15).
    """

    samples: RobotSamples
    x: NDArray[np.float64]


PERIOD = 2e-3


def wandering(seed: int, F_z: float, seconds: float = 8.0) -> Wandering:
    """A robot whose motors follow slow commands, on which a force wanders from `F_z` (N, down) on.

    Its platform and drives move by the filter's own prediction, which `Reference` checks; what is drawn is drawn here.
    """
    model, random, n = experiment(*NOISE), np.random.default_rng(seed), round(seconds / PERIOD)
    shadow, noises = shadow_of(model), Noises()
    step, unknown = ComponentStepper(shadow), np.full(13, np.nan)
    rest = ran("fig4_force_position").samples.u[0]
    step(np.concatenate([rest[:6], np.zeros(3), unknown[9:]]), 0.0, np.inf)
    x = shadow.memory["x"][0]
    x[14] = -F_z
    # in balance: the springs carry it
    x[6:9] += np.linalg.solve(jacobian(geometry(model), x[:3]).T, [0.0, 0.0, -F_z]) / (
        model.plant.k_s * model.plant.N * model.plant.eta
    )
    phase, t = random.uniform(0.0, 2 * np.pi, 3), np.arange(n, dtype=float) * PERIOD
    omega_ref = 0.6 * np.cos(2 * np.pi * np.outer(t, [0.31, 0.37, 0.43]) + phase)
    states = np.empty((n, 15))
    for k in range(n):
        states[k] = x
        u = np.concatenate([unknown[:6], omega_ref[k], unknown[9:]])
        # the command of this sample holds from now on
        shadow.memory["omega_ref"][0] = omega_ref[k]
        # white noise of a step, half of it before and half of it after, as the filter has it
        x += np.sqrt(PERIOD / 2) * intensity(x, noises) * random.standard_normal(15)
        step(u, t[k], PERIOD)
        x += np.sqrt(PERIOD / 2) * intensity(x, noises) * random.standard_normal(15)
    noise = np.repeat([model.plant.motor_noise, model.plant.joint_noise], 3)
    angles = np.hstack([states[:, 6:9], joint_angles(geometry(model), states[:, :3])])
    counts = np.floor((angles + noise * random.standard_normal((n, 6))) / turns(model) + 0.5)
    return Wandering(RobotSamples(np.asarray(t), np.hstack([counts, omega_ref, np.full((n, 4), np.nan)])), states)


SKIN = 1250.0
"""N/m, of Fig. 4."""


def intensity(x: NDArray[np.float64], noises: Noises) -> NDArray[np.float64]:
    """Of what a state `x` (15,) wanders by, per square root of time (15,)."""
    touching = abs(x[14]) > 0.3
    own, rate = (
        (noises.F if touching else noises.air) ** 2,
        noises.touch * (SKIN * (noises.unsure if touching else 1)) ** 2,
    )
    across = x[3] ** 2 + x[4] ** 2 if touching else 0.0
    sideways = np.sqrt(own + rate * noises.mu**2 * (x[5] ** 2 + across))
    down = np.sqrt(own + rate * x[5] ** 2)
    return np.array([0.0] * 3 + [noises.v] * 3 + [0.0] * 3 + [DRIVE.wander] * 3 + [sideways] * 2 + [down])


DRIVE = ShadowDrive(0.02, 0.6, 1e-4, 0.1)


def geometry(model: Experiment) -> Geometry:
    return Geometry(model.plant.a, model.plant.b, model.plant.l_a, model.plant.l_b)


def effective(series: NDArray[np.float64]) -> float:
    """Independent samples that a mean of `series` (runs, n) is worth: n / (1 + 2 sum of autocorrelations), until they
    are none (A. Sokal, Monte Carlo Methods in Statistical Mechanics (1996), sec. 3)."""
    centred, n = series - np.mean(series), series.shape[1]
    rho, total = 1.0, 0.0
    for lag in range(1, n // 2):
        rho = float(np.mean(centred[:, lag:] * centred[:, :-lag]) / np.mean(centred**2))
        if rho < 0.0:
            break
        total += rho
    return series.size / (1.0 + 2.0 * total)


def bounds(freedom: float, samples: float) -> tuple[float, float]:
    """99 % of means of `samples` independent chi-square numbers lie between these."""
    low, high = chi2.ppf([0.005, 0.995], freedom * samples) / samples
    return float(low), float(high)


class Reference:
    """The filter once more, from its equations, in numpy: matrices whole, all counts at once, Joseph's form.

    Platform: M of (P5) from its printed form, and the plant's own dv/dt without contact. Integrated by scipy.
    """

    def __init__(self, model: Experiment, noises: Noises = Noises()):  # noqa: B008
        free = plant_parameters(model.plant, model.contact)._replace(z_s=-10.0)
        self.p, self.model, self.noises = free, model, noises
        self.equations, self.geometry = PlantEquations(free), geometry(model)
        self.x, self.P = np.zeros(15), np.diag(np.repeat([1e-3, 0.05, 1e-3, 0.5, 1.0], 3) ** 2)
        self.slow, self.turning, self.K = np.zeros(2), 0.0, 0.0

    def rate(self, x: NDArray[np.float64], omega_ref: NDArray[np.float64]) -> NDArray[np.float64]:
        """dx/dt."""
        p = self.p
        free = self.equations.derivative(np.concatenate([x[:6], np.zeros(2)]), x[6:9])[3:6]
        theta_l, J = joint_angles(self.geometry, x[:3]), jacobian(self.geometry, x[:3])
        I_a = (p.m_a + p.m_b) * p.l_a**2 / 3 + p.I_r
        down = np.array([0.0, 0.0, -1.0])
        d = p.l_a * (-np.sin(theta_l)[:, None] * OUTWARD + np.cos(theta_l)[:, None] * down)
        M = (p.m_p + p.m_b) * np.eye(3) + I_a * J.T @ J + p.m_b / 6 * (d.T @ J + J.T @ d)
        deflection = x[6:9] - p.N * theta_l
        tau_load = p.k_s * np.sign(deflection) * np.maximum(np.abs(deflection) - p.backlash, 0.0)
        alpha = (omega_ref - DRIVE.droop * tau_load - x[9:12]) / DRIVE.lag
        touched = np.array([-self.turning * x[13], self.turning * x[12], self.K * x[5]])
        return np.concatenate([x[3:6], free - np.linalg.solve(M, x[12:]), x[9:12], alpha, touched])

    def predict(self, h: float, omega_ref: NDArray[np.float64]) -> None:
        touching, by = self.x[14] < -0.3, (self.x[3:5] - self.slow) / 0.1
        across = self.slow[0] * by[1] - self.slow[1] * by[0]
        # friction turns as a slow mean of the way does, the skin gives way
        self.turning, self.K = touching * across / (self.slow @ self.slow + 5e-3**2), touching * SKIN
        self.slow = self.slow + h * by
        steps = np.repeat([1e-5, 1e-3, 3e-4, 1e-3, 1.0], 3)
        A = np.array(
            [
                (self.rate(self.x + e, omega_ref) - self.rate(self.x - e, omega_ref)) / (2 * e.sum())
                for e in np.diag(steps)
            ]
        ).T
        before = np.diag(intensity(self.x, self.noises) ** 2) * h / 2
        phi = expm(A * h)
        # the filter takes what it is before for both halves
        self.P = phi @ (self.P + before) @ phi.T + before
        self.x = solve_ivp(lambda _, x: self.rate(x, omega_ref), (0.0, h), self.x, rtol=1e-9, atol=1e-12).y[:, -1]

    def correct(self, angles: NDArray[np.float64], R: NDArray[np.float64]) -> float:
        """Take six angles in; the squared residuals by their variances."""
        H = np.zeros((6, 15))
        H[:3, 6:9], H[3:, :3] = np.eye(3), jacobian(self.geometry, self.x[:3])
        nu = angles - np.concatenate([self.x[6:9], joint_angles(self.geometry, self.x[:3])])
        S = H @ self.P @ H.T + np.diag(R)
        K = np.linalg.solve(S, H @ self.P).T
        rest = np.eye(15) - K @ H
        self.x = self.x + K @ nu
        self.P = rest @ self.P @ rest.T + K @ np.diag(R) @ K.T
        return float(nu @ np.linalg.solve(S, nu))


def variances(model: Experiment) -> NDArray[np.float64]:
    """Of six counts whose rounding is white (rad^2)."""
    noise = np.repeat([model.plant.motor_noise, model.plant.joint_noise], 3)
    variance: NDArray[np.float64] = turns(model) ** 2 / 12 + noise**2
    return variance


def turns(model: Experiment) -> NDArray[np.float64]:
    """A count of each of the six encoders (rad)."""
    plant = model.plant
    return 2 * np.pi / np.repeat([plant.motor_counts_per_turn, plant.joint_counts_per_turn], 3)


def with_inputs(samples: RobotSamples, **inputs: NDArray[np.float64]) -> RobotSamples:
    """The samples with other values of some of `layout.INPUTS`."""
    changed = RobotSamples(samples.t, samples.u.copy())
    for name, values in inputs.items():
        changed.only(name)[:] = values
    return changed


@cache
def identified_fleet() -> Path:
    """The file of robots whose springs and dead zones are identified: those do not vary."""
    text = FLEET.read_text().replace("../massage.toml", str(EXPERIMENTS / "massage.toml"))
    head, *varied = text.split("[[vary]]\n")
    kept = [one for one in varied if "plant.k_s_" not in one and "plant.backlash_" not in one]
    assert len(kept) == len(varied) - 2
    file = Path(mkdtemp()) / "identified_fleet.toml"
    file.write_text("[[vary]]\n".join([head, *kept]))
    return file
