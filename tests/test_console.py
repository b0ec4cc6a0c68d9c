"""How far something is: a bar on a terminal, a line now and then in a log."""

import io
import sys
from pathlib import Path

import pytest
from tqdm import tqdm

from resc import console
from resc.console import progress

ROOT = Path(__file__).parents[1]


@pytest.fixture
def clock(monkeypatch):
    """Seconds since the beginning, to be set."""
    passed = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: passed[0])
    return passed


def fly(clock, **settings):
    """Eight units, one every ten seconds."""
    with progress(8, unit="flight", **settings) as bar:
        for i in range(1, 9):
            clock[0] = 10.0 * i
            bar.set_postfix_str(f"{i} m", refresh=False)
            bar.update()


def test_log_gets_a_line_every_half_minute(clock, capsys):
    fly(clock, desc="flying")
    assert capsys.readouterr().err.splitlines() == [
        "flying:  38% 3/8 [00:30<00:50, 10.00s/flight, 3 m]",
        "flying:  75% 6/8 [01:00<00:20, 10.00s/flight, 6 m]",
    ]


def test_what_has_no_known_end_is_counted(clock, capsys):
    with progress(unit="row", unit_scale=True) as bar:
        clock[0] = 30.0
        bar.update(6000)
    assert capsys.readouterr().err == "6.00krow [00:30, 200row/s]\n"


def test_what_lasts_tells_its_end_and_what_is_silent_nothing(clock, capsys):
    fly(clock, lasts=True)
    assert capsys.readouterr().err.splitlines()[-1] == "100% 8/8 [01:20<00:00, 10.00s/flight, 8 m]"
    fly(clock, lasts=True, silent=True)
    assert capsys.readouterr().err == ""


def test_terminal_gets_a_bar(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stderr", Terminal())
    with progress(2, unit="flight") as bar:
        bar.update()
    assert isinstance(bar, tqdm)
    assert "0/2" in sys.stderr.getvalue()


def test_all_bars_are_made_in_one_place():
    files = [*(ROOT / "resc").rglob("*.py"), *(ROOT / "examples").glob("*.py")]
    found = [path.name for path in files if "tqdm(" in path.read_text()]
    assert found == ["console.py"]
