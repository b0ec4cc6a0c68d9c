"""Every ablation compares what its variants make of one and the same task."""

import itertools
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from resc.learning.training_run import TrainingRun
from resc.studies.study import task_of

ABLATIONS = sorted((Path(__file__).parents[2] / "conf" / "experiment").glob("ablate_*.yaml"))


def variants(path):
    """The overrides of each variant of an ablation."""
    params = OmegaConf.load(path).hydra.sweeper.params
    lines = [f"{name}={' '.join(str(value).split())}" for name, value in params.items()]
    parsed = OverridesParser.create().parse_overrides(lines)
    choices = [
        [f"{one.get_key_element()}={value}" for value in one.sweep_string_iterator()]
        if one.is_sweep_override()
        else [one.input_line]
        for one in parsed
    ]
    return list(itertools.product(*choices))


@pytest.mark.slow
@pytest.mark.parametrize("path", ABLATIONS, ids=lambda path: path.stem)
def test_all_variants_of_an_ablation_fly_the_same_held_out_episodes(path, compose):
    runs = [TrainingRun(compose(f"+experiment={path.stem}", *own)) for own in variants(path)]
    tasks = [task_of(run) for run in runs]
    assert len(tasks) > 1
    for task in tasks[1:]:
        assert task == tasks[0]
