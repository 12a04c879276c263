"""Estimation of tissue stiffness while pressing: recursive least squares with exponential forgetting.

While pressing, force and height obey F = k (p_0 - z) - c dz/dt, with the unknown height p_0 of a surface that breathes.
Both pass the same band-pass, which removes p_0, as breathing is slow. The rest obeys

    F_f = -k z_f - c v_f,                                                                                        (K1)

linear in k and c. The force of statics lacks the platform's inertia, which is added before: F = F_est + m d2z/dt2. The
normal equations of (K1) are accumulated with forgetting (Ljung 1999, System Identification, Sec. 11.2), the information
form of recursive least squares. They are not updated while the height moves by no more than the encoders' rounding.
Without other motion the reference is dithered: a sine in the middle of the band, until k is known well enough.

Tissue may stiffen under the head without a new touch. Therefore the residual of (K1) over the last half swing is
compared with the standard error of the estimate (a test of the innovation; Bar-Shalom, Li and Kirubarajan 2001,
Estimation with Applications to Tracking and Navigation, Sec. 5.4). A larger residual invalidates the estimate at once,
and learning restarts.
"""

import math

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record, record_of, states
from twin.kernel.settings import FieldSource, Settings, Values, fields_of_form, setting, setting_fields
from twin.robot.controller.pid import state_variable

BAND_DAMPING = 0.5
"""1/Q of each of the two stages of the band-pass. Less would settle more slowly, more would pass breathing."""
BAND_STAGES = 2
SETTLING_TIME_CONSTANTS = 3.0
"""Time constants of a stage, Q/(pi f), until the filters' transient at the start of contact has decayed."""
EXCITATION_RATIO = 10.0
"""Minimum ratio of the band-passed height's rms to the rms of its rounding noise, for motion to count."""
DRIFT_RATE = 0.03
"""Assumed relative change of stiffness per second (1/s) while the height moves without learning."""
MISFIT_RATIO = 3.0
"""Minimum ratio of the residual force to the standard error's effect that invalidates the estimate."""
COUNT_NOISE_RATIO = math.sqrt(12.0)
"""One count divided by the rms of its rounding, as occasional changes of less than one count are not a misfit."""
DITHER_GROWTH = 2.0
"""Growth of the dither's amplitude per swing, from one that produces the requested force on rigid ground: if the tissue
has become stiff unnoticed, the first swings reveal it at small forces."""
STIFFENING_SHARE = 0.7
"""Relative change of stiffness per relative change of force that is assumed possible; 1 would be proportional."""
MIN_STIFFNESS, MAX_STIFFNESS = 50.0, 20000.0
"""Bounds of k_hat (N/m): softer than any body, and stiffer than these springs can distinguish from rigid."""
DITHER_END_SHARE, DITHER_START_SHARE = 0.4, 0.7
"""Shares of the tolerance that end and restart the dither, before the estimate becomes untrusted."""
STAGE_RECORD = record(fast="f8", slow="f8")
PRODUCTS_RECORD = record(zz="f8", zv="f8", vv="f8", zF="f8", vF="f8", FF="f8")


class Tissue(Settings):
    """[controller.tissue]: estimation of the tissue's stiffness while pressing."""

    frequency: float = setting(
        "Hz", default=5.0, ge=0.5, help="dither frequency and band centre; at most 1/20 of the controller's rate"
    )
    window: float = setting("s", default=0.5, gt=0, le=100, help="time constant of forgetting")
    dither: float = setting(
        "N", default=0.15, ge=0, le=2, help="force amplitude of the dither while the tissue is unknown; 0: no dither"
    )
    tolerance: float = setting(
        default=0.3, gt=0, le=1, help="maximum standard error over stiffness of a trusted estimate"
    )


class Sensing(
    Values,
    parts=(
        setting_fields(Tissue, "frequency", "window", "dither"),
        {
            "enough": FieldSource(Tissue, "tolerance", times=DITHER_END_SHARE),
            "doubtful": FieldSource(Tissue, "tolerance", times=DITHER_START_SHARE),
            "contact": setting("N", help="minimum pressing force for learning"),
            "mass": setting("kg", help="mass of the platform"),
            "inertia": setting("kg m2", help="inertia that turns with a joint"),
            "joint_spring": setting("N m/rad", help="torque on a joint per joint angle with the motors held"),
            "angle_rounding": setting("rad", help="rms of the rounding error of a joint's angle"),
            "torque_rounding": setting("N m", help="rms of the rounding error of a joint's torque"),
        },
    ),
):
    """Parameters of the tissue stiffness estimate, SI.

    `enough` and `doubtful` are standard errors over k_hat: the dither ends below the first and restarts above the
    second.
    """


TISSUE_RECORD = record_of(
    Sensing,
    **states(
        **fields_of_form("f8", "g omega turn_sine turn_cosine keep in_band settling averaging growth smoothing"),
        **fields_of_form("f8", "squares moving spring noise least F_noise"),
        z=(STAGE_RECORD, (BAND_STAGES,)),
        F=(STAGE_RECORD, (BAND_STAGES,)),
        **fields_of_form("f8", "z_0 F_0 z_1 z_2 F_1 F_late since"),
        pressing="i8",
        recent=PRODUCTS_RECORD,
        **fields_of_form("f8", "n zzz zzF zzF_late zz zv vv zF vF FF"),
        known="i8",
        **fields_of_form("f8", "k c error z_k F_k F_k_late age std std_late"),
        excited="i8",
        F_ref="f8",
        **fields_of_form("i8", "leading falling"),
        off="f8",
        notch=STAGE_RECORD,
        off_squared="f8",
        dithering="i8",
        **fields_of_form("f8", "phase amplitude sine cosine"),
    ),
)
"""Settings and state.

g .. growth, computed at the first call: tan(pi f h), 2 pi f (rad/s), sine and cosine of the dither's angle per call,
forgetting factor per call, calls per independent value in the band (also its delay in calls), settling time of the
band-pass (s), share of a call in `recent`, growth of the dither per call, share of a call in `off`.
squares .. F_noise, for the pose at the start of contact: sum of the squares of the Jacobian's z column (rad^2/m^2),
moving mass (kg), stiffness of the robot's own springs in z (N/m), rms of rounding in the band of height (m) and force
(N); `least` is the minimum power of a motion that counts.
z, F: the band-passes. z_0, F_0: their initial values. z_1, z_2, F_1: values of previous calls. F_late: force delayed
like the band-pass. since: time in contact (s). recent: means over the last half swing. n, zzz, zzF, zzF_late, zz .. FF:
the normal equations.
known: whether an estimate exists. k, c: the estimate (N/m, N s/m). error: its standard error when it was made. z_k,
F_k, F_k_late, age: its mean height, its force, the same force with the band-pass's delay, and its age. std: its present
standard error, used for decisions; std_late: the same with the band-pass's delay, which is recorded.
F_ref: reference of the previous call (N). leading, falling: whether it changes, and falls. off, notch, off_squared:
low-passed force error (N) without the dither, and its mean square (N^2). phase, amplitude, sine, cosine: state of the
dither (rad, m, 1, 1).
"""


@njit(cache=True)
def _prepare(m, h):
    m.g = math.tan(math.pi * m.frequency * h)
    m.keep = math.exp(-h / m.window)
    # noise bandwidth of two equal stages: pi/4 f/Q
    m.in_band = 1.0 / (0.5 * math.pi * m.frequency * BAND_DAMPING * h)
    m.omega = 2.0 * math.pi * m.frequency
    m.turn_sine, m.turn_cosine = math.sin(m.omega * h), math.cos(m.omega * h)
    m.settling = SETTLING_TIME_CONSTANTS / (math.pi * m.frequency * BAND_DAMPING)
    m.smoothing = m.omega * h / (1.0 + m.omega * h)
    m.growth = DITHER_GROWTH ** (m.frequency * h)
    # over half a swing
    m.averaging = 2.0 * m.frequency * h


@njit(cache=True)
def squares_of(J):
    """Return the sum of squares of the z column of the Jacobian `J` (9,), rad^2/m^2."""
    return J[2] * J[2] + J[5] * J[5] + J[8] * J[8]


@njit(cache=True)
def moving_mass(m, J):
    """Return the mass (kg) of the robot that moves up and down in the pose of the Jacobian `J` (9,)."""
    return m.mass + m.inertia * squares_of(J)


@njit(cache=True, error_model="numpy")
def update_pose(m, J):
    """Update the robot's pose-dependent mass, spring and noise in the tissue estimate from the Jacobian `J` (9,)."""
    m.squares = squares_of(J)
    m.moving = moving_mass(m, J)
    m.spring = m.joint_spring * m.squares
    m.noise = m.angle_rounding / math.sqrt(m.squares * m.in_band)
    m.least = (EXCITATION_RATIO * m.noise) ** 2
    m.F_noise = m.torque_rounding * math.sqrt(m.squares / m.in_band)


@njit(cache=True)
def band_pass(stages, g, x):
    """Filter `x` by a band-pass of two stages with gain 1 in the middle; return (output, derivative over 2 pi f)."""
    high = x
    for i in range(BAND_STAGES):
        stage = stages[i]
        _, band, high, stage.fast, stage.slow = state_variable(BAND_DAMPING, g, stage.fast, stage.slow, x)
        x = BAND_DAMPING * band
    return x, BAND_DAMPING * high


@njit(cache=True)
def _start_filters(m, z, F):
    """Reset the filters of the tissue estimate to rest at the present height and force, at the start of contact."""
    for i in range(BAND_STAGES):
        m.z[i].fast, m.z[i].slow, m.F[i].fast, m.F[i].slow = 0.0, 0.0, 0.0, 0.0
    m.z_0, m.F_0, m.z_1, m.z_2, m.F_1 = z, F, z, z, F
    m.F_late, recent = F, m.recent
    recent.zz, recent.zv, recent.vv, recent.zF, recent.vF, recent.FF = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@njit(cache=True)
def reset_estimate(m):
    """Clear the normal equations of the tissue estimate; the last estimate stays valid until the next one."""
    m.n, m.zzz, m.zzF, m.zzF_late = 0.0, 0.0, 0.0, 0.0
    m.zz, m.zv, m.vv, m.zF, m.vF, m.FF = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@njit(cache=True)
def invalidate_estimate(m):
    """Discard the tissue estimate, because it belongs to another place of the body."""
    reset_estimate(m)
    m.known, m.dithering, m.phase, m.age = 0, 0, 0.0, 0.0


@njit(cache=True, error_model="numpy")
def _stiffness_variance(m, error, k, F_k, age, F):
    """Return the present variance of the estimated stiffness k, including possible changes of the tissue since.

    Tissue stiffens with force, at most in proportion, and differs between places. Time alone causes no doubt: tissue
    softer or stiffer by dk yields by F dk/k^2 more or less under the same force, so if the height has moved only as far
    as the force explains, the stiffness is unchanged.
    """
    changed = STIFFENING_SHARE * abs(F - F_k) / max(F, F_k) if m.since > 0.0 else 0.0
    moved = abs(m.z_1 - m.z_k + (F - F_k) / k)
    older = min(DRIFT_RATE * age, k * moved / max(F, F_k)) if age > 0.0 else 0.0
    return error * error + k * k * (changed * changed + older * older)


@njit(cache=True, error_model="numpy")
def _solve_normal_equations(m, F):
    """Compute tissue stiffness k, damping c and the standard error of k from the accumulated normal equations.

    A result that is less certain than the present one and consistent with it is ignored.
    """
    det = m.zz * m.vv - m.zv * m.zv
    # z and v are a quarter swing apart; if they are not, a swing has only begun
    if det < 0.1 * m.zz * m.vv or m.n * m.keep < m.in_band:
        return
    k = -(m.zF * m.vv - m.vF * m.zv) / det
    c = -(m.vF * m.zz - m.zF * m.zv) / det
    left = max(m.FF + k * m.zF + c * m.vF, 0.0) / m.n
    scatter = max(left, m.F_noise * m.F_noise) * m.in_band * m.vv / det
    # rounding of the joints moves height and force together, like a spring
    rounding = (abs(k) + m.spring) * m.noise * m.noise * m.n / m.zz
    error = math.sqrt(scatter + rounding * rounding) + max(k - MAX_STIFFNESS, 0.0)
    F_k = m.zzF / m.zz
    # a result less certain than the present one and consistent with it is ignored
    if (
        m.known
        and _stiffness_variance(m, error, k, F_k, 0.0, F) > m.std * m.std
        and abs(k - m.k) < 2.0 * (error + m.std)
    ):
        return
    if k < MIN_STIFFNESS:
        # impossible for tissue: another cause moves height and force, such as a surface that jumps
        m.error = max(m.error, m.k)
        reset_estimate(m)
        return
    m.k, m.c, m.error = min(k, MAX_STIFFNESS), c / m.omega, error
    m.z_k = m.zzz / m.zz
    m.known, m.F_k, m.F_k_late, m.age = 1, F_k, m.zzF_late / m.zz, 0.0


@njit(cache=True)
def _update_means(recent, share, z_f, v_f, F_f):
    """Update the running means over the last half swing, with which the tissue estimate is tested, by one sample."""
    recent.zz += share * (z_f * z_f - recent.zz)
    recent.zv += share * (z_f * v_f - recent.zv)
    recent.vv += share * (v_f * v_f - recent.vv)
    recent.zF += share * (z_f * F_f - recent.zF)
    recent.vF += share * (v_f * F_f - recent.vF)
    recent.FF += share * (F_f * F_f - recent.FF)


@njit(cache=True)
def _is_consistent(m):
    """Whether the residual F_f + k z_f + c v_f of the tissue estimate is within its uncertainty."""
    recent, k, c = m.recent, m.k, m.c * m.omega
    crossed = k * recent.zF + c * recent.vF + k * c * recent.zv
    left = recent.FF + 2.0 * crossed + k * k * recent.zz + c * c * recent.vv
    explained = MISFIT_RATIO * m.std
    # with little motion, rounding is not noise but a single count now and then, of broad spectrum
    rounding = COUNT_NOISE_RATIO * COUNT_NOISE_RATIO * m.in_band
    if m.falling and m.off > math.sqrt(rounding) * m.F_noise and -recent.zF > 2.0 * k * recent.zz:
        # the force falls through many counts, so rounding is noise, and by more than one count too fast: it is fed
        # forward with less than half of the true stiffness, which is worse than none
        explained, rounding = max(explained, k), m.in_band
    return left <= explained * explained * (recent.zz + recent.vv) + rounding * m.F_noise * m.F_noise


@njit(cache=True)
def _is_learning(m):
    """Whether the tissue estimate may use the present motion.

    It may use motion caused by the robot, and any motion while k is in doubt. A surface bumpy enough to move in the
    band looks like soft tissue: force and height rise together.
    """
    return m.dithering or m.leading or m.dither == 0.0 or m.std > m.doubtful * m.k


@njit(cache=True)
def _drop_estimate(m, z, F):
    """Discard a tissue estimate that contradicts the measured force, and restart learning at once.

    The filters start from rest at the present values, so (K1) holds from here on, and the change itself is learned
    from.
    """
    reset_estimate(m)
    _start_filters(m, z, F)
    m.error = MAX_STIFFNESS


@njit(cache=True, error_model="numpy")
def update_tissue(m, h, z, F, J, pressing):
    """Update the estimate of tissue stiffness and damping by one sample; `pressing` while the force loop acts.

    `z`, `F` and `J` are the estimated height (m), pressing force (N) and Jacobian (9,), unfiltered.
    """
    if m.g == 0.0:
        _prepare(m, h)
    if pressing and not m.pressing:
        invalidate_estimate(m)
    m.pressing, m.excited = pressing, 0
    if not pressing or F < m.contact:
        m.since, m.dithering = 0.0, 0
    else:
        if m.since == 0.0:
            _start_filters(m, z, F)
            update_pose(m, J)
        m.since += h
        # the second difference belongs to the previous call
        inertia = m.moving * (z - 2.0 * m.z_1 + m.z_2) / (h * h)
        z_f, v_f = band_pass(m.z, m.g, m.z_1 - m.z_0)
        F_f, _ = band_pass(m.F, m.g, m.F_1 + inertia - m.F_0)
        m.z_2, m.z_1, m.F_1 = m.z_1, z, F
        m.F_late += (F - m.F_late) / m.in_band
        _update_means(m.recent, m.averaging, z_f, v_f, F_f)
        if m.known and m.error < MAX_STIFFNESS and not _is_consistent(m):
            _drop_estimate(m, z, F)
        elif m.since > m.settling and m.recent.zz > m.least and _is_learning(m):
            m.excited = 1
            m.n = m.keep * m.n + 1.0
            # weighted by the motion, as is the force at that time
            m.zzF = m.keep * m.zzF + z_f * z_f * F
            m.zzz = m.keep * m.zzz + z_f * z_f * z
            m.zzF_late = m.keep * m.zzF_late + z_f * z_f * m.F_late
            m.zz, m.zv = m.keep * m.zz + z_f * z_f, m.keep * m.zv + z_f * v_f
            m.vv, m.zF = m.keep * m.vv + v_f * v_f, m.keep * m.zF + z_f * F_f
            m.vF, m.FF = m.keep * m.vF + v_f * F_f, m.keep * m.FF + F_f * F_f
            _solve_normal_equations(m, F)
    _update_error(m, h, F)


@njit(cache=True, error_model="numpy")
def _update_error(m, h, F):
    if not m.known:
        m.std = m.std_late = MAX_STIFFNESS
        return
    m.age += h
    m.std = min(math.sqrt(_stiffness_variance(m, m.error, m.k, m.F_k, m.age, F)), MAX_STIFFNESS)
    m.std_late = max(m.std, min(math.sqrt(_stiffness_variance(m, m.error, m.k, m.F_k_late, m.age, F)), MAX_STIFFNESS))
