"""Flies a vehicle behind a MAVLink connection through a scene, with a policy.

python -m resc.deployment.fly 'scenes=[paper4_map15]' connection=udp:0.0.0.0:14540
python -m resc.deployment.fly policy=latest 'scenes=[mine]' connection=udpout:192.168.0.2:14580

Streams body rates and thrust at the policy's rate, and records the flight. Read docs/deployment.md
first: what has to be set up on the vehicle, and what stops a flight. It needs pymavlink: pip
install -e '.[link]'.
"""

import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from resc import schema
from resc.build import build
from resc.console import logged
from resc.deployment.flight import ARRIVED, Prepared, fly_linked, linked, prepare
from resc.deployment.link import COMPONENT, SYSTEM, Link
from resc.deployment.setpoint import SetPoints
from resc.deployment.settings import LinkSettings
from resc.deployment.wire import Wire, mavlink, parsed
from resc.errors import LinkError
from resc.evaluation.campaign import Evaluation
from resc.evaluation.suites import scenes_to_fly
from resc.policies.stored import load_policy, policy_folder
from resc.process import prepare_process
from resc.run_folder import finish_run, provenance
from resc.settings import check_settings
from resc.starting.composed import compose_scenes, given
from resc.starting.launch import launch_here

ROLLOUTS = "rollouts"
SIGNALS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}


@dataclass(frozen=True)
class Fly:
    """One flight.

    Args:
        config: Of fly.yaml.
        folder: Where its recording and its summary go.
    """

    config: DictConfig
    folder: Path

    def __call__(self) -> None:
        """Flies it, and leaves a recording.

        Raises:
            LinkError: The flight controller does not answer, or the flight was stopped.
        """
        check_settings(self.config, schema.FlySchema)
        OmegaConf.resolve(self.config)
        prepare_process(self.config["threads"], self.config["device"])
        mavlink()
        parsed(self.config["connection"])
        settings: LinkSettings = build(self.config["link"], "link", kind=LinkSettings)
        evaluation = evaluation_of(self.config)
        prepared = prepare(replace(evaluation, config=linked(evaluation.config)))
        with (
            logged(self.folder / "fly.log"),
            closing(link_of(self.config, settings, prepared)) as link,
            interrupting(link),
        ):
            link.wait(prepared.start_w)
            directory = self.folder / ROLLOUTS
            result = fly_linked(prepared, link, directory, arm=self.config["arm"])
            self._report(result, link)

    def _report(self, result: Mapping[str, Any], link: Link) -> None:
        reason = {"stopped": link.reason} if link.reason else {}
        figures = {**result, **reason, **link.schedule.figures(), **provenance()}
        finish_run(self.folder, figures, "flight")
        print(f"{result['outcome']} after {result['flown_s']:.2f} s")
        print(link.schedule)
        print(f"recording {self.folder / ROLLOUTS}")
        if result["outcome"] != ARRIVED:
            raise LinkError(link.reason or f"The flight ended by {result['outcome']}.")


def evaluation_of(config: DictConfig, **changes: object) -> Evaluation:
    """The evaluation that a flight is prepared as; `changes` are settings."""
    names = scenes_to_fly(config["scenes"], config["suite"], given())
    scenes = compose_scenes(names, config["scene"])
    folder = str(policy_folder(config["policy"], "policy"))
    policy = load_policy(Path(folder), config["device"], config["allowed_targets"])
    plain = {str(name): config[name] for name in config if name not in ("link", "peer")}
    return Evaluation({**plain, "policy": folder, **changes}, policy, scenes, given())


def link_of(config: Mapping[str, Any], settings: LinkSettings, prepared: Prepared) -> Link:
    """A link for a flight, its port open."""
    context = prepared.env.stages.context
    set_points = SetPoints(
        context.vehicle,
        rate_limit_radps=settings.rate_limit_radps,
        thrust_limits=settings.thrust_limits,
    )
    wire = Wire(config["connection"], system=SYSTEM, component=COMPONENT)
    link = Link(wire, settings, set_points, context.dt_s)
    low, high = settings.height_m
    link.geofence = prepared.geofence((low, high))
    return link


@contextmanager
def closing(link: Link) -> Iterator[Link]:
    """Hands over at the end, whatever happens."""
    try:
        yield link
    finally:
        link.close()


@contextmanager
def interrupting(link: Link) -> Iterator[None]:
    """Lets Ctrl-C and SIGTERM stop the flight in order, so that it is handed over and recorded."""
    before = {
        number: signal.signal(number, lambda *_, name=name: link.interrupt(name))
        for number, name in SIGNALS.items()
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


if __name__ == "__main__":
    schema.register()
    launch_here(Fly, "fly")
