"""Names that stored configurations use, and what they are today."""

MOVED = {
    "resc.learning.networks.build_networks": "resc.policies.networks.Mlp",
    "resc.policies.networks.build_networks": "resc.policies.networks.Mlp",
    "resc.learning.ppo.PpoSettings": "resc.learning.ppo.Ppo",
    "resc.sweeps.Joblib": "resc.sweeps.launchers.Local",
    "resc.sweeps.Ray": "resc.sweeps.launchers.Ray",
    "resc.sweeps.Serial": "resc.sweeps.launchers.Local",
    "resc.sweeps.Slurm": "resc.sweeps.launchers.Slurm",
    "resc.sweeps.sweep.Joblib": "resc.sweeps.launchers.Local",
    "resc.sweeps.sweep.Ray": "resc.sweeps.launchers.Ray",
    "resc.sweeps.sweep.Serial": "resc.sweeps.launchers.Local",
    "resc.sweeps.sweep.Slurm": "resc.sweeps.launchers.Slurm",
}
"""Targets of stored configurations, by how they begin, and where they are today."""


def today(target: str) -> str:
    """The name that a target of a stored configuration has now."""
    for begins, now in MOVED.items():
        if target.startswith(begins):
            return now + target.removeprefix(begins)
    return target
