"""The site has an entry for every file of conf/, class and key, and names every page."""

import ast
from pathlib import Path

import pytest
import yaml
from source_trees import parsed

pytest.importorskip("griffe", reason="the extra 'docs' is not installed")

from docs.tools import api, build, keys, parts, runs
from resc.keys import DECLARED

ROOT = Path(__file__).parents[1]
SITE = yaml.unsafe_load((ROOT / "docs" / "tools" / "mkdocs.yml").read_text())


@pytest.fixture(scope="module")
def pages():
    return build.pages()


def named(nav):
    """The pages that a navigation names."""
    for entry in nav:
        value = next(iter(entry.values())) if isinstance(entry, dict) else entry
        yield from named(value) if isinstance(value, list) else [value]


def test_every_page_is_named_once(pages):
    assert sorted(named(SITE["nav"])) == sorted(pages)


def test_every_file_of_conf_has_an_entry(pages):
    for path in (ROOT / "conf").rglob("*.yaml"):
        name = path.relative_to(ROOT)
        page = "runs" if len(name.parts) == 2 else name.parts[1]
        assert f"\n## {path.stem}\n" in pages[f"parts/{page}.md"]
        assert f"\n`{name}`" in pages[f"parts/{page}.md"], name


def test_every_public_class_and_function_has_an_entry(pages):
    shown = {line for text in pages.values() for line in text.splitlines() if line[:4] == "::: "}
    found = [*(ROOT / "resc").rglob("*.py"), *(ROOT / "hydra_plugins").glob("*.py")]
    with_something = {f"::: {api.module(path)}" for path in found if api.public(path)}
    assert shown == with_something
    for path in found:  # what has no docstring is not shown
        for node in parsed(path).body:
            if isinstance(node, ast.ClassDef) and node.name[0] != "_":
                assert ast.get_docstring(node), f"{path}: {node.name}"


def test_every_key_has_an_entry():
    page = keys.page()
    assert all(f'<span id="{"-".join(key)}"></span>' in page for key in DECLARED)


def test_an_entry_says_what_a_part_reads_and_writes_and_its_numbers():
    entry = parts.entry(ROOT / "conf" / "reward" / "body_rate.yaml")
    assert (
        "| reads | [`state.body_rate_b`](../keys.md#state-body_rate_b) | n x 3 | rad/s |" in entry
    )
    assert "| writes | `reward.body_rate` |  |  |" in entry
    assert "| `weight` | `0.01` |  | Factor of the term in the sum. |" in entry


def test_a_part_that_builds_on_another_has_the_numbers_of_both():
    entry = parts.entry(ROOT / "conf" / "sensing" / "predicted.yaml")
    assert "`conf/sensing/predicted.yaml`, on top of `local`" in entry
    assert "| `rate_hz` | `25.0` | Hz |" in entry
    assert "| `predict_s` | `2.0` | s |" in entry
    assert "| `radius_m` | " in entry


def test_settings_of_a_run_are_those_of_its_schema():
    assert "| `num_envs` | `1024` |  | Environments flown in parallel. |" in runs.settings()


@pytest.mark.parametrize(
    ("page", "link", "led"),
    [
        ("index.md", "[x](docs/px4.md#a)", "[x](px4.md#a)"),
        ("px4.md", "[x](../README.md)", "[x](index.md)"),
        ("px4.md", "[x](../policies/README.md)", "[x](policies.md)"),
        ("px4.md", "[x](../conf/reward/jerk.yaml)", "[x](parts/reward.md#jerk)"),
        ("px4.md", "[x](../resc/keys.py)", "[x](api/resc.md#resc.keys)"),
        ("px4.md", "[x](../examples/sac.py)", "[x](examples.md#sacpy)"),
        ("results/baselines/gaps/report.md", "[x](../../../px4.md)", "[x](../../../px4.md)"),
        ("px4.md", "[x](../tests/data/README.md)", "x"),
        ("px4.md", "![x](px4.png)", "![x](px4.png)"),
        ("px4.md", "[x](https://example.org/a.md)", "[x](https://example.org/a.md)"),
    ],
)
def test_links_of_the_repository_lead_to_pages_of_the_site(page, link, led):
    there = {"index.md", "px4.md", "policies.md", "parts/reward.md", "api/resc.md", "examples.md"}
    assert build.led(link, page, there) == led
