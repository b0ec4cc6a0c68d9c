"""How one of several processes of a training records: `rank_files` says how that is read."""

import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from resc import ranks
from resc.errors import ConfigError

_NAME = "rank_{:03d}"


def directory_of_rank(directory: Path) -> Path:
    """Where this rank records, of a run that records to a directory."""
    return directory if ranks.is_first() else directory / _NAME.format(ranks.rank())


def facts_of_rank() -> dict[str, str]:
    """What the files of this rank say of it; nothing where there is one."""
    count = ranks.count()
    return {"rank": str(ranks.rank()), "ranks": str(count)} if count > 1 else {}


def session_of_ranks() -> str:
    """The session that all ranks name; empty where there is one, whose recorder draws its own."""
    return ranks.from_first(lambda: uuid.uuid4().hex) if ranks.count() > 1 else ""


def shared(recorder: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """The settings of a recorder with the share that this rank has of `envs` and `max_gb`.

    Raises:
        ConfigError: They do not divide.
    """
    if not recorder or ranks.count() == 1:
        return dict(recorder) if recorder else None
    found = dict(recorder)
    if (envs := found.get("envs")) is not None:
        if not isinstance(envs, int):
            raise ConfigError(f"recorder.envs is {envs!r}; expected a whole number, or null.")
        found["envs"] = ranks.share(envs, "recorder.envs")
    if isinstance(limit := found.get("max_gb"), int | float):
        found["max_gb"] = limit / ranks.count()
    return found
