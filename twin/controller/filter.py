"""A state-variable filter of second order: low-pass, band-pass and high-pass of one signal at once."""

from twin.compiled.function import njit


@njit(cache=True)
def state_variable(damping, g, fast, slow, x):
    """(low-passed `x`, its derivative over 2 pi f, its second over (2 pi f)^2, the two states after it).

    By the trapezoidal rule, so the derivatives are those of the output itself (Zavalishin 2012, The Art of VA Filter
    Design, Ch. 4).

    Args:
        damping: 1/Q.
        g: tan(pi f h), of the corner f (Hz) and the period h (s).
        fast, slow: states after the call before; at rest 0 and the signal.
    """
    # a factor, which does not wait for x and is one for all stages of a filter
    high = (x - (damping + g) * fast - slow) * (1.0 / (1.0 + g * (damping + g)))
    band = g * high + fast
    low = g * band + slow
    return low, band, high, band + g * high, low + g * band
