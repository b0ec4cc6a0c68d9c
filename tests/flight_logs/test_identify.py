"""What identification finds of a loop and of rotors that are known."""

import numpy as np
import pytest
from synthetic import QUADROTOR, answers, doublets, flight, loop_flight, ulog, wandering

from resc.flight_logs.models import MODELS, loop_model
from resc.flight_logs.rate_response import rate_responses
from resc.flight_logs.thrust_curve import thrust_curve
from resc.flight_logs.trace import trace_of_log, trace_of_recording
from resc.recording import RolloutLog

pytest.importorskip("pyulog")
MODEL = loop_model("imp250").respond


def truth():
    """The response of the synthetic loop: t10, t63, t90 [s] and overshoot."""
    set_points = np.zeros((1000, 3))
    set_points[1:] = 1
    values = answers(set_points, 0.001)[1:, 0]
    return [np.argmax(values >= level) * 0.001 for level in (0.1, 0.63, 0.9)], values.max() - 1


def assert_true(response, tolerance_s):
    times, overshoot = truth()
    found = [response.reach_s(level) for level in (0.1, 0.63, 0.9)]
    np.testing.assert_allclose(found, times, atol=tolerance_s)
    assert response.overshoot == pytest.approx(overshoot, abs=0.03)


@pytest.fixture
def trace(tmp_path):
    def traced(set_points, **settings):
        (tmp_path / "flight.ulg").write_bytes(ulog(loop_flight(set_points, **settings), QUADROTOR))
        return trace_of_log(tmp_path / "flight.ulg")

    return traced


def test_clean_steps_give_the_response_of_a_known_loop(trace):
    for result in rate_responses(trace(doublets()), MODEL):
        assert (result.measured.method, result.modelled.method) == ("steps", "steps")
        assert result.measured.count >= 15
        assert_true(result.measured, 0.006)


@pytest.mark.slow
@pytest.mark.parametrize("dt_s", [0.001, 0.02])
def test_rates_of_other_logging_rates_give_it_too(trace, dt_s):
    for result in rate_responses(trace(doublets(dt_s), dt_s=dt_s), MODEL):
        times = [result.measured.reach_s(level) for level in (0.63, 0.9)]
        np.testing.assert_allclose(times, truth()[0][1:], atol=0.03 if dt_s > 0.01 else 0.006)


@pytest.mark.slow
def test_without_steps_deconvolution_gives_it(trace):
    for result in rate_responses(trace(wandering()), MODEL):
        assert result.measured.method == "deconvolution"
        assert result.measured.explained > 0.9
        assert_true(result.measured, 0.008)


def test_a_recording_of_the_log_gives_the_same(trace, call):
    trace(doublets())
    assert call("from-ulog", "flight.ulg")[0] == 0
    found = rate_responses(trace_of_recording(RolloutLog("flight.mcap")), MODEL)
    for result in found:
        assert_true(result.measured, 0.012)


def test_the_thrust_curve_is_that_of_the_rotors(trace):
    curve = thrust_curve(trace(doublets()))
    assert curve.full_mps2 == pytest.approx(25.0, rel=0.03)
    assert curve.curvature == pytest.approx(0.3, abs=0.06)
    assert curve.at(np.array([curve.hover])) == pytest.approx(9.80665)


def test_rates_that_do_not_answer_are_no_response(trace):
    still = trace(wandering(), constant_s=1e3)
    assert all("explain" in result.reason for result in rate_responses(still, MODEL))


@pytest.mark.parametrize("name", MODELS)
def test_every_model_settles_on_its_set_points(name):
    set_points = np.zeros((2, 300, 3))
    set_points[0, 50:, 0], set_points[1, 50:, 2] = 0.5, -0.5
    rates = loop_model(name).respond(set_points, 0.002)
    assert rates.shape == set_points.shape
    np.testing.assert_allclose(rates[:, :50], 0, atol=1e-6)
    assert abs(rates[0, -1, 0] - 0.5) < 0.1
    assert abs(rates[0, -1, 2]) < 0.01


def test_the_command_prints_and_draws(trace, call, tmp_path):
    trace(doublets(repeats=2))
    code, out, _ = call("identify", "flight.ulg", "--out", "found.png")
    assert code == 0
    assert "roll   log, steps" in out
    assert "yaw    imp250, steps" in out
    assert "THR_MDL_FAC 0.3" in out
    assert (tmp_path / "found.png").stat().st_size > 20_000


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (ulog(flight(armed=()), QUADROTOR), "never armed"),
        (ulog(flight(), {"MAV_TYPE": 10}), "rover"),
        (b"", "empty"),
    ],
)
def test_logs_that_tell_nothing_are_refused_in_a_sentence(call, tmp_path, content, words):
    (tmp_path / "flight.ulg").write_bytes(content)
    code, out, errors = call("identify", "flight.ulg")
    assert (code, out) == (1, "")
    assert words in errors
    assert [path.name for path in tmp_path.iterdir()] == ["flight.ulg"]


def test_a_log_without_set_points_and_an_unknown_model_are_refused(call, tmp_path):
    topics = flight()
    del topics["vehicle_rates_setpoint", 0]
    (tmp_path / "flight.ulg").write_bytes(ulog(topics, QUADROTOR))
    assert "tells no rate set-point" in call("identify", "flight.ulg")[2]
    assert "Did you mean 'imp250'?" in call("identify", "flight.ulg", "--model", "imp25")[2]
