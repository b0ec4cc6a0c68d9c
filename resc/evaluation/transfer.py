"""The robustness report: how a policy flies under other conditions than it was trained for.

python -m resc.evaluation.transfer policy=latest                   every file of conf/condition
python -m resc.evaluation.transfer 'suite=[paper,forest]' maps=30  on these suites
python -m resc.evaluation.transfer conditions=mujoco,delay_20_ms   some conditions
python -m resc.evaluation.transfer --config-dir mine               those of mine/condition, too

A condition is a file that names overrides of evaluate.py, such as simulator=rotorpy. All are flown
from the same starts, and compared with the nominal one flight by flight. Any override of
evaluate.py is taken but pilot, replay and what a condition gives.
"""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from resc import schema
from resc.console import logged
from resc.errors import ConfigError, RescError, nearest
from resc.evaluation.campaign import Evaluation
from resc.evaluation.suites import scenes_to_fly
from resc.evaluation.transfer_report import Flown, read_flown, write_transfer
from resc.policies.stored import load_policy, policy_folder
from resc.process import prepare_process
from resc.run_folder import finish_run, provenance
from resc.settings import check_settings, listed
from resc.starting.answers import answering
from resc.starting.composed import compose_scenes, composed_with, files_of, given
from resc.starting.launch import SHOWING, launch_here

GROUP, NOMINAL = "condition", "nominal"
OWN = ("pilot", "replay", "conditions")
"""Settings of an evaluation that are not the user's here."""
ASKED = "conditions="


@dataclass(frozen=True)
class Condition:
    """What is different.

    Args:
        name: Of its file.
        title: For the report.
        overrides: Of evaluate.py.
    """

    name: str
    title: str
    overrides: Sequence[str]


@dataclass(frozen=True)
class Transfer:
    """A policy flown under every condition.

    Args:
        config: Of an evaluation.
        folder: Where the report goes, each condition in a folder of its own.
        asked: Names of the conditions; all of them if empty.
    """

    config: DictConfig
    folder: Path
    asked: Sequence[str] = ()

    def __call__(self) -> None:
        """Flies the nominal condition, then the others; the report grows with each."""
        check_settings(self.config, schema.EvaluateSchema)
        prepare_process(self.config["threads"], self.config["device"])
        planned = [(each, self.evaluation(each)) for each in conditions(self.asked)]
        for condition, evaluation in planned:
            try:
                evaluation.check()
            except RescError as error:
                raise ConfigError(f"{GROUP}/{condition.name}: {error}") from None
        flown: list[Flown] = []
        with logged(self.folder / "transfer.log"):
            for number, (condition, evaluation) in enumerate(planned, start=1):
                print(f"{number} of {len(planned)}: {condition.title}", flush=True)
                evaluation.fly(self.folder / condition.name)
                flown.append(read_flown(self.folder / condition.name, condition.title))
                text = write_transfer(flown, self.folder)
            print(text)
        names = [condition.name for condition, _ in planned]
        finish_run(self.folder, {"conditions": names, **provenance()}, "transfer")

    def evaluation(self, condition: Condition) -> Evaluation:
        """The evaluation under a condition.

        Raises:
            ConfigError: One of its overrides names nothing that there is.
        """
        config = composed_with(condition.overrides)
        names = scenes_to_fly(config["scenes"], config["suite"], given())
        scenes = compose_scenes(names, config["scene"])
        config["policy"] = str(policy_folder(config["policy"], "policy"))
        policy = load_policy(Path(config["policy"]), config["device"], config["allowed_targets"])
        return Evaluation(config, policy, scenes, [*given(), *condition.overrides])


def conditions(asked: Sequence[str]) -> list[Condition]:
    """The conditions of these names, or all there are, the nominal one first.

    Raises:
        ConfigError: One is unknown, or its file is not one of a condition.
    """
    files = files_of(GROUP)
    if unknown := [name for name in asked if name not in files]:
        raise ConfigError(f"{GROUP} has no '{unknown[0]}'.{nearest(unknown[0], files)}")
    names = [NOMINAL, *(name for name in asked or sorted(files) if name != NOMINAL)]
    return [condition_of(name, files[name]) for name in dict.fromkeys(names)]


def condition_of(name: str, file: Mapping[str, Any]) -> Condition:
    """What a file of conf/condition says.

    Raises:
        ConfigError: It lacks the title or the overrides, or holds something else.
    """
    said = {str(key): value for key, value in file.items()}
    overrides = said.get("overrides")
    if set(said) != {"title", "overrides"} or not OmegaConf.is_list(overrides):
        raise ConfigError(
            f"{GROUP}/{name} holds {', '.join(said) or 'nothing'}; expected a title and a list of "
            "overrides, as in conf/condition/mujoco.yaml."
        )
    return Condition(name, str(said["title"]), listed(overrides))


def as_evaluation(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """The arguments of evaluate.py among those of this command, and the conditions named.

    Raises:
        ConfigError: A setting is not the user's.
    """
    if any(text in ("-h", "--help") for text in arguments):
        print(__doc__)
        sys.exit()
    if shown := [text for text in arguments if text in SHOWING]:
        raise ConfigError(
            f"{shown[0]} shows settings, and this flies; leave it out, or give it to evaluate.py."
        )
    if any(text in ("-m", "--multirun") for text in arguments):
        raise ConfigError("All conditions are flown one after the other; leave out -m.")
    named = [text.removeprefix(ASKED) for text in arguments if text.startswith(ASKED)]
    asked = [name for text in named for name in text.strip("[]").split(",") if name]
    rest = [text for text in arguments if not text.startswith(ASKED)]
    if own := [text for text in rest if text.lstrip("+").partition("=")[0] in OWN]:
        raise ConfigError(f"The policy flies, under every condition; leave out {own[0]}.")
    return rest, asked


def main() -> None:
    """Reads the command and starts it."""
    with answering():
        rest, asked = as_evaluation(sys.argv[1:])
    sys.argv[1:] = rest
    schema.register()
    launch_here(lambda config, folder: Transfer(config, folder, asked), "evaluate")


if __name__ == "__main__":
    main()
