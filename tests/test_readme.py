"""The README shows what is there: its table of parts is conf/, its example is a reward."""

import re
from pathlib import Path

import torch
from torch.testing import assert_close

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
NO_PARTS = {"env", "experiment", "hydra"}


def test_table_of_parts_lists_every_file_of_conf():
    rows = re.findall(r"^\| `(\w+)`(?: \*)? \|[^|]*\|([^|]*)\|$", README, re.MULTILINE)
    listed = {group: set(re.findall(r"`(\w+)`", choices)) for group, choices in rows}
    folders = {path for path in (ROOT / "conf").iterdir() if path.is_dir()}
    there = {folder.name: {path.stem for path in folder.glob("*.yaml")} for folder in folders}
    assert listed == {group: files for group, files in there.items() if group not in NO_PARTS}


def test_example_reward_falls_with_the_difference_in_height():
    namespace = {}
    exec(re.search(r"```python\n(.*?)```", README, re.DOTALL).group(1), namespace)
    position = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]])
    target = torch.tensor([[5.0, 5.0, 1.0], [5.0, 5.0, 1.0]])
    assert_close(
        namespace["Height"](weight=1.0).compute(position, target), torch.tensor([[0.0], [-2.0]])
    )
