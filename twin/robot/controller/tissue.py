"""Tissue stiffness estimated while pressing: recursive least squares with exponential forgetting.

Force and height while pressing are F = k (p_0 - z) - c dz/dt, with p_0 the height of a surface that is not known
of and that breathes. Both pass the same band-pass, which leaves nothing of p_0, for breath is slow; what is left obeys

    F_f = -k z_f - c v_f,                                                                                        (K1)

linear in k and c. The force of statics lacks the platform's inertia, which is added before: F = F_est + m d2z/dt2. The
normal equations of (K1) are kept with forgetting (Ljung 1999, System Identification, Sec. 11.2), which is recursive
least squares in its information form. They are left as they are where the height moves by no more than encoders round.

Where nothing moves by itself the reference is moved: a sine in the middle of the band, as long as k is not known well
enough.

Tissue may stiffen under the head without a new touch. So the force that (K1) leaves of the last half swing is compared
with what the standard error of the estimate explains (a test of the innovation; Bar-Shalom, Li and Kirubarajan 2001,
Estimation with Applications to Tracking and Navigation, Sec. 5.4). Where it leaves more, the estimate is not trusted
any more from that call on, all that was learnt is dropped, and learning begins anew.
"""

import math

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record, record_of, states
from twin.kernel.settings import FieldSource, Settings, Values, fields_of_form, setting, setting_fields
from twin.robot.controller.pid import state_variable

BAND_DAMPING = 0.5
"""Of each of the two stages of the band-pass: 1/Q. Less would take longer to settle, more would let breath through."""
BAND_STAGES = 2
SETTLING_TIME_CONSTANTS = 3.0
"""Time constants of a stage, Q/(pi f), after which what the start of contact has left in the filters is gone."""
EXCITATION_RATIO = 10.0
"""Rms of the band-passed height over that of the rounding noise in it, from which on something moves."""
DRIFT_RATE = 0.03
"""Share of k_hat by which the tissue may change in a second in which nothing is learnt and the height moves."""
MISFIT_RATIO = 3.0
"""Force that the estimate leaves, over what its standard error explains, from which on it does not hold any more."""
COUNT_NOISE_RATIO = math.sqrt(12.0)
"""A count over the rms of its rounding. What changes by less than one now and then is no misfit."""
DITHER_GROWTH = 2.0
"""Of the dither's amplitude per swing, from what makes no more than the force asked for on rock: if the tissue has
become stiff unnoticed, the first swings show it before they make much force."""
STIFFENING_SHARE = 0.7
"""Share of a relative change of the force by which the stiffness may change with it; 1 would be in proportion."""
MIN_STIFFNESS, MAX_STIFFNESS = 50.0, 20000.0
"""Bounds of k_hat (N/m): softer than any body, stiffer than what these springs can tell from rigid."""
DITHER_END_SHARE, DITHER_START_SHARE = 0.4, 0.7
"""Shares of the tolerance at which the dither ends, and begins anew: before the estimate is no longer trusted."""
STAGE_RECORD = record(fast="f8", slow="f8")
PRODUCTS_RECORD = record(zz="f8", zv="f8", vv="f8", zF="f8", vF="f8", FF="f8")


class Tissue(Settings):
    """[controller.tissue]: how the controller finds out, while pressing, how stiff the tissue is."""

    frequency: float = setting(
        "Hz", default=5.0, ge=0.5, help="middle of the band that is looked at, and of the dither"
    )
    window: float = setting("s", default=0.5, gt=0, le=100, help="how long what was seen is remembered")
    dither: float = setting(
        "N",
        default=0.15,
        ge=0,
        le=2,
        help="amplitude of the force that moves the tissue where nothing else does; 0: none",
    )
    tolerance: float = setting(
        default=0.3, gt=0, le=1, help="standard error over stiffness from which on it is not trusted"
    )


class Sensing(
    Values,
    parts=(
        setting_fields(Tissue, "frequency", "window", "dither"),
        {
            "enough": FieldSource(Tissue, "tolerance", times=DITHER_END_SHARE),
            "doubtful": FieldSource(Tissue, "tolerance", times=DITHER_START_SHARE),
            "contact": setting("N", help="pressing force below which nothing is learnt"),
            "mass": setting("kg", help="of the platform"),
            "inertia": setting("kg m2", help="of what turns with a joint"),
            "joint_spring": setting("N m/rad", help="torque on a joint per angle of it with the motors held"),
            "angle_rounding": setting("rad", help="rms of what rounding makes of a joint's angle"),
            "torque_rounding": setting("N m", help="rms of what rounding makes of a joint's torque"),
        },
    ),
):
    """How the tissue is looked at, SI; `enough`, `doubtful`: standard errors over k_hat, see ENOUGH and DOUBTFUL."""


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

g .. growth: of the filters, worked out at the first call: tan(pi f h), 2 pi f (rad/s), sine and cosine of what the
dither turns by in a call, what is kept of the past per call, calls per independent value in the band, which are also
those by which the band-pass is late, when it has settled (s), share of a call in `recent`, growth of the dither in a
call, share of a call in `off`. squares .. F_noise: of the pose in which contact began: sum of the squares of the
Jacobian's z column (rad^2/m^2), what moves up and down (kg), stiffness of the robot's own springs in z (N/m), rms of
rounding in the band, of height (m) and force (N), with `least` the power from which on something moves. z, F: the
band-passes. z_0, F_0: what they began from. z_1, z_2, F_1: of the calls before. F_late: force, as late as what has
passed the band. since: time in contact (s). recent: means over the last half swing. n, zzz, zzF, zzF_late, zz .. FF:
the normal equations. known: whether there is an estimate; k, c: it (N/m, N s/m); error: its standard error when it
was made, z_k, F_k, F_k_late, age: at which mean height and force, with that which the band-pass was late by, and how
long ago. std: what may be wrong with it by now, which decides; std_late: the same with the lag of the band-pass,
which is recorded. F_ref: reference in the call before (N); leading, falling: whether it moves, and down. off, notch,
off_squared: force error, low-passed (N), without the dither, and its mean square (N^2). phase, amplitude, sine, cosine:
of the dither (rad, m, 1, 1).
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
    # half a swing
    m.averaging = 2.0 * m.frequency * h


@njit(cache=True)
def squares_of(J):
    """Sum of the squares of the z column of the Jacobian `J` (9,), rad^2/m^2."""
    return J[2] * J[2] + J[5] * J[5] + J[8] * J[8]


@njit(cache=True)
def moving_mass(m, J):
    """What moves up and down (kg) in the pose of the Jacobian `J` (9,)."""
    return m.mass + m.inertia * squares_of(J)


@njit(cache=True, error_model="numpy")
def update_pose(m, J):
    """What of the robot itself depends on its pose, from the Jacobian `J` (9,) there."""
    m.squares = squares_of(J)
    m.moving = moving_mass(m, J)
    m.spring = m.joint_spring * m.squares
    m.noise = m.angle_rounding / math.sqrt(m.squares * m.in_band)
    m.least = (EXCITATION_RATIO * m.noise) ** 2
    m.F_noise = m.torque_rounding * math.sqrt(m.squares / m.in_band)


@njit(cache=True)
def band_pass(stages, g, x):
    """(what is left of `x` in the band, its derivative over 2 pi f), each of gain 1 in the middle: of two filters."""
    high = x
    for i in range(BAND_STAGES):
        stage = stages[i]
        _, band, high, stage.fast, stage.slow = state_variable(BAND_DAMPING, g, stage.fast, stage.slow, x)
        x = BAND_DAMPING * band
    return x, BAND_DAMPING * high


@njit(cache=True)
def _start_filters(m, z, F):
    """Contact begins, or is there again: the filters start from rest."""
    for i in range(BAND_STAGES):
        m.z[i].fast, m.z[i].slow, m.F[i].fast, m.F[i].slow = 0.0, 0.0, 0.0, 0.0
    m.z_0, m.F_0, m.z_1, m.z_2, m.F_1 = z, F, z, z, F
    m.F_late, recent = F, m.recent
    recent.zz, recent.zv, recent.vv, recent.zF, recent.vF, recent.FF = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@njit(cache=True)
def reset_estimate(m):
    """The next estimate is of what comes, the last one stands until then."""
    m.n, m.zzz, m.zzF, m.zzF_late = 0.0, 0.0, 0.0, 0.0
    m.zz, m.zv, m.vv, m.zF, m.vF, m.FF = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@njit(cache=True)
def invalidate_estimate(m):
    """What was learnt is of another place: nothing is known from now on."""
    reset_estimate(m)
    m.known, m.dithering, m.phase, m.age = 0, 0, 0.0, 0.0


@njit(cache=True, error_model="numpy")
def _stiffness_variance(m, error, k, F_k, age, F):
    """Square of what may be wrong with k by now.

    Tissue stiffens with force, at most in proportion, and differs elsewhere. Time alone makes no doubt: what is
    softer or stiffer by dk under the same force gives way by F dk/k^2 more or less, so where the height has not moved
    but as far as the force explains, nothing has changed.
    """
    changed = STIFFENING_SHARE * abs(F - F_k) / max(F, F_k) if m.since > 0.0 else 0.0
    moved = abs(m.z_1 - m.z_k + (F - F_k) / k)
    older = min(DRIFT_RATE * age, k * moved / max(F, F_k)) if age > 0.0 else 0.0
    return error * error + k * k * (changed * changed + older * older)


@njit(cache=True, error_model="numpy")
def _solve_normal_equations(m, F):
    """k, c and the standard error of k from the normal equations, as of the mean force that they remember."""
    det = m.zz * m.vv - m.zv * m.zv
    # z and v of one swing are a quarter apart; where they are not, a swing has only begun
    if det < 0.1 * m.zz * m.vv or m.n * m.keep < m.in_band:
        return
    k = -(m.zF * m.vv - m.vF * m.zv) / det
    c = -(m.vF * m.zz - m.zF * m.zv) / det
    left = max(m.FF + k * m.zF + c * m.vF, 0.0) / m.n
    scatter = max(left, m.F_noise * m.F_noise) * m.in_band * m.vv / det
    # rounding of the joints moves height and force together, as a spring would
    rounding = (abs(k) + m.spring) * m.noise * m.noise * m.n / m.zz
    error = math.sqrt(scatter + rounding * rounding) + max(k - MAX_STIFFNESS, 0.0)
    F_k = m.zzF / m.zz
    # more to be doubted by now than the last one, and no contradiction to it: no news
    if (
        m.known
        and _stiffness_variance(m, error, k, F_k, 0.0, F) > m.std * m.std
        and abs(k - m.k) < 2.0 * (error + m.std)
    ):
        return
    if k < MIN_STIFFNESS:
        # no tissue does that: something else moves height and force, a surface that jumps
        m.error = max(m.error, m.k)
        reset_estimate(m)
        return
    m.k, m.c, m.error = min(k, MAX_STIFFNESS), c / m.omega, error
    m.z_k = m.zzz / m.zz
    m.known, m.F_k, m.F_k_late, m.age = 1, F_k, m.zzF_late / m.zz, 0.0


@njit(cache=True)
def _update_means(recent, share, z_f, v_f, F_f):
    """A call's part of the means over the last half swing."""
    recent.zz += share * (z_f * z_f - recent.zz)
    recent.zv += share * (z_f * v_f - recent.zv)
    recent.vv += share * (v_f * v_f - recent.vv)
    recent.zF += share * (z_f * F_f - recent.zF)
    recent.vF += share * (v_f * F_f - recent.vF)
    recent.FF += share * (F_f * F_f - recent.FF)


@njit(cache=True)
def _is_consistent(m):
    """Whether what the estimate leaves of the force, F_f + k z_f + c v_f, is no more than what may be wrong with it."""
    recent, k, c = m.recent, m.k, m.c * m.omega
    crossed = k * recent.zF + c * recent.vF + k * c * recent.zv
    left = recent.FF + 2.0 * crossed + k * k * recent.zz + c * c * recent.vv
    explained = MISFIT_RATIO * m.std
    # where little moves rounding is no noise, but a count now and then, in all of the spectrum
    rounding = COUNT_NOISE_RATIO * COUNT_NOISE_RATIO * m.in_band
    if m.falling and m.off > math.sqrt(rounding) * m.F_noise and -recent.zF > 2.0 * k * recent.zz:
        # through many counts, which are noise, and by more than one too fast: fed forward with less than half of the
        # stiffness that there is, which is worse than nothing
        explained, rounding = max(explained, k), m.in_band
    return left <= explained * explained * (recent.zz + recent.vv) + rounding * m.F_noise * m.F_noise


@njit(cache=True)
def _is_learning(m):
    """Whether what moves is learnt from: what the robot moves by itself, or else what there is, where k is in doubt.

    A surface that is bumpy enough to move in the band looks like soft tissue: force and height rise together.
    """
    return m.dithering or m.leading or m.dither == 0.0 or m.std > m.doubtful * m.k


@njit(cache=True)
def _drop_estimate(m, z, F):
    """The estimate does not hold any more: nothing is trusted of it, and learning begins at once.

    The filters start from rest, and from the values of now, so (K1) holds from here on: what the change itself moves is
    learnt from.
    """
    reset_estimate(m)
    _start_filters(m, z, F)
    m.error = MAX_STIFFNESS


@njit(cache=True, error_model="numpy")
def update_tissue(m, h, z, F, J, pressing):
    """Learn from a call.

    Args:
        z, F, J: height (m), pressing force (N) and Jacobian (9,) as estimated, unfiltered.
        pressing: whether the force loop acts.
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
        # the second difference is that of a call ago
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
            # what moved most tells most, and of the force that was there then
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
    """Keep what may be wrong with the estimate by now."""
    if not m.known:
        m.std = m.std_late = MAX_STIFFNESS
        return
    m.age += h
    m.std = min(math.sqrt(_stiffness_variance(m, m.error, m.k, m.F_k, m.age, F)), MAX_STIFFNESS)
    m.std_late = max(m.std, min(math.sqrt(_stiffness_variance(m, m.error, m.k, m.F_k_late, m.age, F)), MAX_STIFFNESS))
