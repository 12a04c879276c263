import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.errors import InputRefused
from twin.studies.analyse.linear.loops import DriveModel, fit_drive

TICK = 1e-3
FREQUENCIES = np.concatenate([[0.0], np.geomspace(1.0, 200.0, 32)])
Z = np.exp(2j * np.pi * TICK * FREQUENCIES)
CERTAIN = np.zeros((len(Z), 2))


@st.composite
def drives(draw: st.DrawFn) -> DriveModel:
    """One lag between 2 and 60 Hz, and a swing between 5 and 80 Hz."""
    lag, swing = draw(st.floats(2.0, 60.0)), draw(st.floats(5.0, 80.0))
    zeta, share = draw(st.floats(0.1, 1.0)), draw(st.floats(0.1, 1.0))
    s = 2.0 * np.pi * np.array([-lag, swing * (-zeta + 1j * np.sqrt(1.0 - zeta**2))])
    z, rotated = np.exp(s * TICK), np.exp(s[1] * TICK)
    A = np.zeros((3, 3))
    A[0, 0] = z[0].real
    A[1:, 1:] = [[rotated.real, rotated.imag], [-rotated.imag, rotated.real]]
    B = np.array([[1.0 - A[0, 0], -0.6 * (1.0 - A[0, 0])], [1.0, 0.0], [0.0, -1.0]])
    return DriveModel(A, B, TICK * np.array([[1.0, share, share]]), np.zeros((1, 2)))


@given(drives())
def test_the_fit_finds_the_drive_that_made_the_response(drive):
    response = drive.response(Z)
    fitted = fit_drive(FREQUENCIES, response, CERTAIN, TICK, "drive")
    # the fit stops adding states at a residual of 0.003
    assert fitted.residual < 0.003
    between = np.exp(2j * np.pi * TICK * np.array([1.7, 13.0, 47.0]))
    scale = np.abs(response).max(axis=0)
    # between the lines a model of three states cannot be much further off than on them
    np.testing.assert_array_less(np.abs(fitted.response(between) - drive.response(between)) / scale, 0.02)


@given(drives())
def test_steady_gain_is_the_response_at_rest(drive):
    # both solve the same equations, at condition numbers below 1e5
    np.testing.assert_allclose(drive.steady_gain, drive.response(np.array([1.0]))[0].real, rtol=1e-9, atol=1e-15)


def test_a_drive_that_no_load_moves_has_a_model_without_states():
    response = np.zeros((len(Z), 2), dtype=complex)
    response[:, 0] = TICK
    fitted = fit_drive(FREQUENCIES, response, CERTAIN, TICK, "drive")
    assert len(fitted.A) == 0
    # a fit by least squares, exact but for rounding
    np.testing.assert_allclose(fitted.steady_gain, [TICK, 0.0], atol=1e-15)


@pytest.mark.slow
@given(st.floats(0.1, 1.0))
def test_a_steady_command_that_alone_is_answered_is_no_proportion(gain):
    frequencies = np.unique(np.round(FREQUENCIES))
    response = np.zeros((len(frequencies), 2), dtype=complex)
    response[0, 0] = gain * TICK
    certain = np.zeros((len(frequencies), 2))
    # a sticking drive: the best model is that of a shaft that stands, which misses one line of n: 1/sqrt(n) = 0.19
    model = fit_drive(frequencies, response, certain, TICK, "acme")
    assert model.residual > 0.15


def test_noise_is_no_drive():
    random = np.random.default_rng(0)
    noise = random.normal(size=(len(Z), 2)) + 1j * random.normal(size=(len(Z), 2))
    with pytest.raises(InputRefused, match=r"^acme: no linear model describes it: .* simulate instead"):
        fit_drive(FREQUENCIES, noise, CERTAIN, TICK, "acme")


@pytest.mark.parametrize("gain", [0.0, 1e-300])
def test_a_shaft_that_stands_still_is_no_drive(gain: float):
    response = np.full((len(Z), 2), gain * TICK, dtype=complex)
    with pytest.raises(InputRefused, match=r"^acme: .* does not respond to small commands; see `twin drive check`"):
        fit_drive(FREQUENCIES, response, CERTAIN, TICK, "acme")
