"""Trackers of experiments beside progress.csv: Weights & Biases, MLflow and Trackio.

All of them work offline: what they keep is below the folder `runs`. A run that is resumed goes on
under the same name; `figures`, configuration, pictures and tables of a run reach them all.
"""

import importlib
import json
import os
import time
import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from omegaconf import OmegaConf

from resc.errors import ConfigError
from resc.run_folder import CONFIG, EPISODES, ORIGIN, PAGE, PROGRESS, RUNS, SUMMARY

TRACKED = "tracker.json"
"""What the run is called at the tracker, in the run's folder."""
LEFT = (PAGE, CONFIG, ORIGIN, SUMMARY, EPISODES, PROGRESS)
"""What a tracker is given of a finished run, beside its pictures."""
FRAMES = "frames"


class Tracker(ABC):
    """What trackers share.

    `connected` is opened at the first figure, so that a run that fails before leaves none.

    Args:
        folder: Of the run.
    """

    package = ""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.library = _library(self.package)

    @cached_property
    @abstractmethod
    def connected(self) -> Any:  # noqa: ANN401 - of a package that may be missing
        """The run at the tracker."""

    @property
    def opened(self) -> bool:
        """Whether it has been written to."""
        return "connected" in vars(self)

    @property
    def place(self) -> Path:
        """Where trackers keep the runs of all folders together: `runs`, if the run is below it."""
        whole = self.folder.resolve()
        return next((parent for parent in whole.parents if parent.name == RUNS), whole)

    @property
    def title(self) -> str:
        """The run as a tracker lists it."""
        return str(self.folder.resolve().relative_to(self.place)).strip(".") or self.folder.name

    @property
    def settings(self) -> dict[str, Any]:
        """The configuration of the run; empty where none is stored yet."""
        path = self.folder / CONFIG
        if not path.exists():
            return {}
        return cast(dict[str, Any], OmegaConf.to_container(OmegaConf.load(path), resolve=True))

    def identity(self, new: str) -> str:
        """What the run has been called before, or a new name, which is kept."""
        path = self.folder / TRACKED
        if path.exists():
            return str(json.loads(path.read_text())[self.package])
        path.write_text(json.dumps({self.package: new}) + "\n")
        return new

    def left(self) -> list[Path]:
        """What there is of a run: its tables, then its pictures."""
        tables = [self.folder / name for name in LEFT if (self.folder / name).exists()]
        return [*tables, *self.pictures()]

    def pictures(self) -> list[Path]:
        """The pictures of a run."""
        return sorted(self.folder.glob("*.png"))


class WandbLogger(Tracker):
    """Weights & Biases.

    Args:
        folder: Of the run.
        project: Project of the run.
        mode: offline keeps the run in its folder, for `wandb sync`; online also sends it, with the
            key of `wandb login`. Without a key it stays offline, and says so.
    """

    package = "wandb"

    def __init__(self, *, folder: Path, project: str = "resc", mode: str = "offline") -> None:
        if mode not in ("offline", "online"):
            raise ConfigError(f"mode is '{mode}'; expected offline or online.")
        super().__init__(folder)
        self.project = project
        self.mode = mode
        if mode == "online" and not self.library.login(prompt=False):
            kept = folder / "wandb"
            _say(f"no key of wandb is set, so the run is kept in {kept}; `wandb sync` sends it.")
            self.mode = "offline"

    @cached_property
    def connected(self) -> Any:  # noqa: ANN401
        """The run, continued if it was begun before."""
        run = self.library.init(
            project=self.project,
            name=self.title,
            id=self.identity(uuid.uuid4().hex[:12]),
            resume="allow",
            dir=str(self.folder),
            mode=self.mode,
            config=self.settings,
            settings=self.library.Settings(silent=True, console="off", save_code=False),
        )
        run.define_metric("*", step_metric=FRAMES)
        return run

    def log(self, figures: Mapping[str, float], frames: int) -> None:
        """Every figure, against frames: a resumed run goes back some."""
        self.connected.log({FRAMES: frames, **figures})

    def attach(self, summary: Mapping[str, float | int]) -> None:
        """The results, and an artifact of files."""
        run = self.connected
        run.summary.update(dict(summary))
        run.log({path.stem: self.library.Image(str(path)) for path in self.pictures()})
        files = self.library.Artifact(f"run-{run.id}", type="run")
        for path in self.left():
            files.add_file(str(path), policy="immutable")
        run.log_artifact(files)

    def close(self) -> None:
        """Waits until all is written, or sent."""
        if self.opened:
            self.connected.finish()


class MlflowLogger(Tracker):
    """MLflow.

    Args:
        folder: Of the run.
        experiment: Experiment of the run.
        uri: Of the tracking server, such as http://localhost:5000; null is the SQLite file
            runs/mlflow.db. A server that refuses, or does not answer, is replaced by it, in words.
    """

    package = "mlflow"

    def __init__(self, *, folder: Path, experiment: str = "resc", uri: str | None = None) -> None:
        super().__init__(folder)
        self.experiment = experiment
        self.uri = uri
        self.lost = False
        os.environ.setdefault("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "2")  # or it waits for minutes

    @cached_property
    def connected(self) -> tuple[Any, str]:
        """The client, and the run's identity."""
        local = f"sqlite:///{self.place / 'mlflow.db'}"
        try:
            return self._begun(self.uri or local)
        except self.library.exceptions.MlflowException as error:
            if not self.uri:
                raise ConfigError(
                    f"logger: {local} cannot be used ({_line(error)}); move it away."
                ) from None
            _say(f"{self.uri} refuses ({_line(error)}), so the run is kept in {local}.")
            return self._begun(local)

    def _begun(self, uri: str) -> tuple[Any, str]:
        client = self.library.MlflowClient(uri)
        found = client.get_experiment_by_name(self.experiment)
        where = None if uri == self.uri else (self.place / "mlflow").as_uri()
        number = found.experiment_id if found else client.create_experiment(self.experiment, where)
        if (self.folder / TRACKED).exists():
            return client, self.identity("")
        identity = self.identity(client.create_run(number, run_name=self.title).info.run_id)
        for name, value in _flat(self.settings):
            client.log_param(identity, name, str(value)[:500])
        return client, identity

    def log(self, figures: Mapping[str, float], frames: int) -> None:
        """Every figure, against frames."""
        client, identity = self.connected
        now_ms = int(time.time() * 1000)
        kind = self.library.entities.Metric
        metrics = [kind(name, float(value), now_ms, frames) for name, value in figures.items()]
        with self._sending():
            client.log_batch(identity, metrics=metrics)

    def attach(self, summary: Mapping[str, float | int]) -> None:
        """The results, and files."""
        client, identity = self.connected
        with self._sending():
            for name, value in summary.items():
                client.log_metric(identity, name, float(value))
            for path in self.left():
                client.log_artifact(identity, str(path))

    def close(self) -> None:
        """Says that the run is over."""
        if self.opened:
            client, identity = self.connected
            with self._sending():
                client.set_terminated(identity)

    @contextmanager
    def _sending(self) -> Iterator[None]:
        """Says once that a server has stopped taking anything: no reason to stop training."""
        try:
            yield
        except self.library.exceptions.MlflowException as error:
            if not self.lost:
                _say(f"MLflow takes no more ({_line(error)}); the run's folder holds everything.")
            self.lost = True


class TrackioLogger(Tracker):
    """Trackio.

    Args:
        folder: Of the run.
        project: Project of the run.
        space: Space of Hugging Face to send it to, with the token of `hf auth login`; null is the
            SQLite file runs/trackio/<project>.db. Without a token it stays there, and says so.
    """

    package = "trackio"

    def __init__(self, *, folder: Path, project: str = "resc", space: str | None = None) -> None:
        self.folder = folder
        os.environ.setdefault("TRACKIO_DIR", str(self.place / "trackio"))  # read when imported
        super().__init__(folder)
        self.project = project
        self.space = space
        if space and not _library("huggingface_hub").get_token():
            _say(f"no token of Hugging Face is set; `trackio sync` sends the run to {space} later.")
            self.space = None

    @cached_property
    def connected(self) -> Any:  # noqa: ANN401
        """The run, continued if it was begun before."""
        return self.library.init(
            project=self.project,
            name=self.identity(self.title),
            resume="allow",
            space_id=self.space,
            config=self.settings,
            embed=False,
            auto_log_gpu=False,
            auto_log_cpu=False,
        )

    def log(self, figures: Mapping[str, float], frames: int) -> None:
        """Every figure, against frames."""
        self.connected.log(dict(figures), step=frames)

    def attach(self, summary: Mapping[str, float | int]) -> None:
        """The results, pictures, and an artifact of files."""
        run = self.connected
        pictures = {path.stem: self.library.Image(str(path)) for path in self.pictures()}
        run.log({**summary, **pictures})
        files = self.library.Artifact(f"run-{self.title.replace('/', '-')}", type="run")
        for path in self.left():
            files.add_file(str(path))
        run.log_artifact(files)

    def close(self) -> None:
        """Waits until all is written, or sent."""
        if self.opened:
            self.connected.finish()


def _library(package: str) -> Any:  # noqa: ANN401
    try:
        return importlib.import_module(package)
    except ImportError:
        raise ConfigError(
            f"logger needs {package}, which is not installed; install it: pip install "
            f"-e '.[{package}]', or use logger=csv."
        ) from None


def _say(sentence: str) -> None:
    print(f"logger: {sentence}", flush=True)


def _line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


def _flat(node: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Every setting by its path: reward.progress.weight."""
    for name, value in node.items():
        path = f"{before}{name}"
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{path}.")
        else:
            yield path, value
