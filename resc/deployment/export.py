"""Exports a policy: files that other programs fly it with, and a card that says what they mean.

python -m resc.deployment.export policy=policies/obstacles
python -m resc.deployment.export policy=latest hydra.run.dir=robot/policy
python -m resc.deployment.export policy=latest 'files=[pt2,h]'      without ONNX

Writes policy.onnx, policy.pt2 (torch.export), policy.h (plain C) and policy.json (the card), each
compared with the policy on 10,000 observations first: docs/export.md. ONNX needs its packages: pip
install -e '.[export]'.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omegaconf import DictConfig, OmegaConf

from resc import schema
from resc.deployment.c_header import header
from resc.deployment.card import card_of
from resc.deployment.export_check import GREATEST, ROWS, STEPS, deviations, require_equal, steps_of
from resc.deployment.exported import (
    CARD,
    HEADER,
    ONNX,
    TORCH,
    PlainPolicy,
    onnx_packages,
    traced,
    write_onnx,
    write_torch,
)
from resc.errors import ConfigError, NumericalError, nearest
from resc.policies.stored import StoredPolicy, load_policy, policy_folder
from resc.process import prepare_process
from resc.run_folder import link_latest, provenance
from resc.settings import check_settings
from resc.setup import build_stages
from resc.starting.launch import launch_here

FILES = {"onnx": ONNX, "pt2": TORCH, "h": HEADER}
"""What may be asked for."""


@dataclass(frozen=True)
class Export:
    """One export.

    Args:
        config: Of export.yaml.
        folder: Where the files go.
    """

    config: DictConfig
    folder: Path

    def __call__(self) -> None:
        """Writes the files, says what they are and how exact.

        Raises:
            ConfigError: A setting is wrong, a package is missing, or a part of the policy cannot be
                exported.
            NumericalError: A file does not do what the policy does.
        """
        check_settings(self.config, schema.ExportSchema)
        OmegaConf.resolve(self.config)
        prepare_process(1, "cpu")
        wanted = wanted_files(self.config["files"])
        stored_in = policy_folder(self.config["policy"], "policy")
        policy = load_policy(stored_in, allowed=self.config["allowed_targets"])
        found = export(policy, stored_in, self.folder, wanted, self.config["seed"])
        link_latest(self.folder, "export")
        for name, deviation in found.items():
            print(f"{name:<12} deviates by {deviation:.1e} at most")
        print(f"{ROWS * STEPS} observations each; up to {GREATEST:.0e} is allowed")
        print(f"files and card {self.folder}")


def wanted_files(names: Sequence[str]) -> list[str]:
    """The files asked for.

    Raises:
        ConfigError: A name is none of those that there are, or a package is missing.
    """
    for name in names:
        if name not in FILES:
            raise ConfigError(f"files has '{name}'.{nearest(str(name), FILES)}")
    if not names:
        raise ConfigError(f"files is empty; give some of {', '.join(FILES)}.")
    if "onnx" in names:
        onnx_packages()
    return [FILES[name] for name in names]


def export(
    policy: StoredPolicy, stored_in: Path, folder: Path, wanted: Sequence[str], seed: int = 0
) -> dict[str, float]:
    """Writes the files and the card into a folder; returns by how much each file deviates.

    Args:
        policy: The policy.
        stored_in: Its folder.
        folder: Of the export.
        wanted: Names of the files.
        seed: Of the observations that they are compared on.

    Raises:
        ConfigError: A part of the policy cannot be exported.
        NumericalError: A file does not do what the policy does; nothing is written then.
    """
    stages = build_stages(policy.config)
    policy.require_layout(stages)
    card = card_of(policy, stages, stored_in)
    plain = PlainPolicy(policy.policy).eval()
    _require_finite(plain, stored_in)
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder, prefix=".export") as unfinished:
        made = Path(unfinished)
        write_files(plain, made, card, wanted)
        found = deviations(policy.policy, steps_of(made, plain), seed)
        require_equal(found)
        card["files"] = {name: {"largest_deviation": value} for name, value in found.items()}
        card["exported_with"] = provenance()
        (made / CARD).write_text(json.dumps(card, indent=2, allow_nan=False) + "\n")
        for name in (*wanted, CARD):
            (made / name).replace(folder / name)
    return found


def _require_finite(plain: PlainPolicy, stored_in: Path) -> None:
    if not all(value.isfinite().all() for value in plain.state_dict().values()):
        raise NumericalError(
            f"The policy of {stored_in} holds numbers that are not finite; export one whose "
            "training succeeded."
        )


def write_files(
    plain: PlainPolicy, folder: Path, card: Mapping[str, Any], wanted: Sequence[str]
) -> None:
    """Writes those of the files that are wanted."""
    if HEADER in wanted:
        (folder / HEADER).write_text(header(plain, card))
    if ONNX in wanted or TORCH in wanted:
        program = traced(plain)
        if TORCH in wanted:
            write_torch(program, folder / TORCH, card)
        if ONNX in wanted:
            write_onnx(program, plain, folder / ONNX, card)


if __name__ == "__main__":
    schema.register()
    launch_here(Export, "export")
