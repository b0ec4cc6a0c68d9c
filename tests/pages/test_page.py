"""The page of a folder: whole in one file, right in its numbers, and it never fails a run."""

import base64
import io
import json
import re
from html.parser import HTMLParser
from urllib.parse import unquote

import numpy as np
import polars as pl
import pytest
from made_up_sweep import make_run
from PIL import Image

from resc.errors import ConfigError
from resc.learning.learning_curve import own_scale
from resc.pages.curves import POINTS, thinned
from resc.pages.evaluation import from_report
from resc.pages.page import PICTURES_B, Page, escaped, table
from resc.pages.worst import ranked, read_flights
from resc.pages.write import leave_page, write_page
from resc.studies.ablation import write_report

NASTY = "a<b>&\"c'</script>"
SMALL_B = 5_000_000


class Seen(HTMLParser):
    """What a page holds: attributes of its tags, and its text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.data = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.data.append(data)

    def all(self, tag, name):
        return [attrs[name] for found, attrs in self.tags if found == tag and name in attrs]


def require_whole(path):
    """Everything is in the file but what it links, which is there; returns what it holds."""
    text = path.read_text()
    seen = Seen(text)
    assert len(text.encode()) < SMALL_B
    for place in seen.all("img", "src"):
        kind, _, data = place.partition(",")
        assert kind == "data:image/webp;base64"
        Image.open(io.BytesIO(base64.b64decode(data))).verify()
    for target in seen.all("a", "href"):
        if target.startswith("#"):
            assert f'id="{target[1:]}"' in text
        else:
            assert (path.parent / unquote(target)).exists(), target
    assert not [attrs for tag, attrs in seen.tags if tag in ("link", "iframe", "object", "base")]
    assert not seen.all("script", "src")
    assert not re.search(r"url\(|@import|https?://", text.replace("http://www.w3.org/2000/svg", ""))
    assert "default-src 'none'" in text
    return seen


def data_of(path):
    """What the script of a page draws."""
    held = re.search(r'<script type="application/json" id="data">(.*?)</script>', path.read_text())
    return json.loads(held[1])


@pytest.fixture
def run(tmp_path):
    """A finished training run, its numbers made up."""
    folder = make_run(tmp_path / "2026-01-01" / "10-00-00_train", success=[1, 1, 0, 1])
    (folder / "job.json").unlink()
    rows = [
        {"frames": 1e6 * i, "outcome/success": i / 4, "reward/time": -1.0, "reward/crash": -9.0 / i}
        for i in (1, 2, 3)
    ]
    names = list(rows[0])
    lines = [",".join(names), *(",".join(str(row[name]) for name in names) for row in rows)]
    (folder / "progress.csv").write_text("\n".join(lines) + "\n")
    Image.new("RGB", (40, 30), "red").save(folder / "learning_curve.png")
    origin = {"command": f"python train.py name={NASTY}", "commit": "abc"}
    (folder / "origin.json").write_text(json.dumps(origin))
    terms = {
        "reward": [["time", "10", "-1 per step"]],
        "observation": [["velocity", "0", "2", "x"]],
    }
    (folder / "terms.json").write_text(json.dumps(terms))
    return folder


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    """Two variants with two seeds, with the report of their sweep."""
    folder = tmp_path_factory.mktemp("runs") / "sweep"
    variants = (("kgp_esdf", [1, 1, 1, 1]), (NASTY, [1, 0, 0, 1]))
    for number in range(4):
        name, success = variants[number % 2]
        overrides = (f"seed={number // 2}", f"obstacle_observation={name}")
        make_run(folder / str(number), *overrides, success=success)
    (folder / "origin.json").write_text(json.dumps({"command": "python train.py -m"}))
    write_report(folder)
    return folder


def test_page_of_a_run_is_whole_and_tells_its_results(run):
    path = write_page(run)
    assert path == run / "report.html"
    seen = require_whole(path)
    text = " ".join(seen.data)
    for told in ("75.0%", "of 4 held-out flights succeed", "30.1 to 95.4 %", "-1 per step", NASTY):
        assert told in text
    assert len(seen.all("img", "src")) == 1
    assert {"progress.csv", "learning_curve.png"} <= set(seen.all("a", "href"))


def test_page_of_a_run_says_how_many_processes_trained_it(run):
    assert "processes" not in " ".join(require_whole(write_page(run)).data)
    summary = json.loads((run / "summary.json").read_text())
    (run / "summary.json").write_text(json.dumps({**summary, "processes": 2}))
    data = require_whole(write_page(run)).data
    assert data[data.index("processes train together") - 1] == "2"


def test_page_of_a_run_shows_every_command_in_order(run):
    origin = json.loads((run / "origin.json").read_text())
    again = [
        {"command": f"python train.py resume=x total_frames={n}", "commit": str(n), "begun": day}
        for n, day in ((2, "Monday"), (3, "Friday"))
    ]
    (run / "origin.json").write_text(json.dumps({**origin, "resumed": again}))
    text = " ".join(require_whole(write_page(run)).data)
    told = (
        NASTY,
        "# resumed Monday, commit 2\npython train.py resume=x total_frames=2",
        "# resumed Friday, commit 3\npython train.py resume=x total_frames=3",
    )
    places = [text.index(one) for one in told]
    assert places == sorted(places)


def test_crash_has_a_chart_of_its_own(run):
    charts = data_of(write_page(run))["charts"]
    drawn = {chart["title"]: [(s["name"], s["y"]) for s in chart["series"]] for chart in charts}
    assert drawn == {
        "How episodes end [share]": [("outcome/success", [0.25, 0.5, 0.75])],
        "Weighted reward terms per step": [("reward/time", [-1.0, -1.0, -1.0])],
        "crash per step": [("reward/crash", [-9.0, -4.5, -3.0])],
    }
    assert charts[0]["x"] == [1.0, 2.0, 3.0]
    assert own_scale(["time", "crash"]) == ["crash"]


def test_a_run_that_was_interrupted_has_a_page_of_its_curves(run):
    for name in ("summary.json", "evaluation.csv", "terms.json", "learning_curve.png"):
        (run / name).unlink()
    seen = require_whole(write_page(run))
    assert [target for target in seen.all("a", "href") if target[0] == "#"] == ["#curves", "#files"]


def test_page_of_a_sweep_compares_with_intervals_and_can_be_filtered(sweep):
    path = write_page(sweep)
    seen = require_whole(path)
    assert "100.0 (100.0 to 100.0)" in seen.data
    assert seen.all("tr", "data-variant") == ["kgp_esdf", NASTY]
    assert seen.all("tr", "data-run") == ["0", "1", "2", "3"]
    data = data_of(path)
    chosen = {"number": 3, "variant": NASTY}
    assert data["runs"][3] == chosen | {"overrides": {"seed": "1", "obstacle_observation": NASTY}}
    bars = next(chart for chart in data["charts"] if chart["title"] == "Held-out success")
    assert [(row["name"], row["value"]) for row in bars["rows"]] == [("kgp_esdf", 1), (NASTY, 0.5)]
    assert len(seen.all("img", "src")) == 6


def test_run_of_a_sweep_is_linked_by_its_page_where_it_has_one(sweep):
    write_page(sweep / "1")
    targets = require_whole(write_page(sweep)).all("a", "href")
    assert {"0/", "1/report.html"} <= set(targets)


def test_held_out_flights_that_touch_something_come_first():
    flights = pl.DataFrame(
        {"success": [False, True, False], "collided": [0, 0, 1], "time_s": [9.0, 3.0, 1.0]}
    )
    assert ranked(flights) == [2, 0, 1]


def test_page_of_an_evaluation_shows_its_table_and_the_worst_flights_first(tmp_path):
    (tmp_path / "report.md").write_text("# x\n\n| | map |\n| - | -: |\n| SPL | 0.9 |\n\nSPL: .\n")
    (tmp_path / "summary.json").write_text('{"seed": 7, "policy": "policies/obstacles"}')
    (tmp_path / "flights.csv").write_text(
        "scene,flight,outcome,success,counted_steps,planned_length,bound,least_clearance\n"
        "map,0,success,True,100,10.0,,0.5\n"
        "map,1,contact,False,50,10.0,,0.0\n"
        "map,2,success,True,90,10.0,,0.2\n"
        "map,3,success,True,300,10.0,,0.9\n"
    )
    Image.new("RGB", (40, 30), "red").save(tmp_path / "flight_map.png")
    assert ranked(read_flights(tmp_path / "flights.csv")) == [1, 2, 3, 0]
    seen = require_whole(write_page(tmp_path))
    assert len(seen.all("img", "src")) == 1
    told = "".join(seen.data)
    assert "seed 7" in told
    assert "SPL: ." in told


def test_pictures_beyond_the_budget_are_linked(tmp_path):
    Image.new("RGB", (40, 30), "red").save(tmp_path / "a.png")
    page = Page(tmp_path, pictures_b=PICTURES_B)
    assert page.picture(tmp_path / "a.png", "A") == '<p>A <a href="a.png">a.png</a></p>'


def test_long_curves_are_means_of_neighbours():
    values = np.arange(2.0 * POINTS)
    values[:3] = np.nan
    short = thinned(values)
    assert len(short) == POINTS
    assert np.isnan(short[0])
    assert short[1:4].tolist() == [3.0, 4.5, 6.5]


def test_text_is_escaped_and_numbers_are_set_to_the_right():
    assert escaped(NASTY) == "a&lt;b&gt;&amp;&quot;c&#x27;&lt;/script&gt;"
    assert '<td class="number">0.5 (0.1 to 0.9)</td>' in table(["n"], [["0.5 (0.1 to 0.9)"]])
    assert "<td>kgp_esdf</td>" in table(["n"], [["kgp_esdf"], ["1"]])
    assert from_report("no table") == ("", "no table")


def test_other_folders_are_refused_in_a_sentence(tmp_path):
    with pytest.raises(ConfigError, match=r"holds no run, evaluation or sweep; give a folder"):
        write_page(tmp_path)


@pytest.mark.parametrize("content", [b"\xff", b"frames\nx\n"])
def test_a_page_that_cannot_be_made_costs_a_sentence(run, capsys, content):
    (run / "progress.csv").write_bytes(content)
    leave_page(run)
    told = capsys.readouterr().out
    assert told.startswith("No report.html: ")
    assert told.count("\n") == 1
    assert not (run / "report.html").exists()
