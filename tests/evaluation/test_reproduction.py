"""A run of the default training is compared with the stored ones by a prediction interval."""

import json

import pytest

from resc.errors import ConfigError
from resc.evaluation.reproduction import STORED, compare, prediction_interval

RATES = {"0": 0.96, "1": 0.97, "2": 0.95, "3": 0.96, "4": 0.96}
STORED_RUNS = {"frames": 1000, "success_rate": RATES}


def finished(folder, rate, frames=1000):
    (folder / "summary.json").write_text(json.dumps({"success_rate": rate, "frames": frames}))
    return folder


def test_interval_of_five_rates_equals_the_one_by_hand():
    # s = sqrt((0.01^2 + 0.01^2) / 4) = 0.0070711; t_4 = 2.776445; sqrt(1.2) = 1.0954451
    low, high = prediction_interval(list(RATES.values()))
    assert low == pytest.approx(0.96 - 0.0215066, abs=1e-6)
    assert high == pytest.approx(0.96 + 0.0215066, abs=1e-6)


def test_interval_ends_at_certainty():
    assert prediction_interval([1.0, 1.0, 0.9])[1] == 1.0


def test_a_run_like_the_others_is_inside(tmp_path):
    inside, sentence = compare(finished(tmp_path, 0.955), STORED_RUNS)
    assert inside
    assert sentence.startswith("95.5% success, inside 93.8% to 98.2%")


@pytest.mark.parametrize("rate", [0.93, 0.99])
def test_a_run_far_below_or_above_is_outside(tmp_path, rate):
    assert not compare(finished(tmp_path, rate), STORED_RUNS)[0]


def test_a_shorter_run_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="took 500 frames, the stored ones 1000"):
        compare(finished(tmp_path, 0.96, frames=500), STORED_RUNS)


@pytest.mark.parametrize("content", ["{", "{}", "[]", '{"success_rate": null, "frames": 1}'])
def test_a_damaged_summary_is_one_sentence(tmp_path, content):
    (tmp_path / "summary.json").write_text(content)
    with pytest.raises(ConfigError, match="not the summary of a finished training run"):
        compare(tmp_path, STORED_RUNS)


def test_an_unfinished_run_is_one_sentence(tmp_path):
    with pytest.raises(ConfigError, match="does not exist"):
        compare(tmp_path, STORED_RUNS)


def test_one_run_gives_no_interval():
    with pytest.raises(ConfigError, match="at least two runs"):
        prediction_interval([0.9])


def test_stored_runs_give_an_interval():
    rates = list(json.loads(STORED.read_text())["success_rate"].values())
    low, high = prediction_interval(rates)
    assert 0 < low < high <= 1
