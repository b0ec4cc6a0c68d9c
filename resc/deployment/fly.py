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
from typing import Any

from resc import schema
from resc.build import build
from resc.console import logged
from resc.deployment.flight import ARRIVED, Command, Prepared, fly_linked, linked, prepare
from resc.deployment.link import COMPONENT, SYSTEM, Link
from resc.deployment.setpoint import SetPoints
from resc.deployment.settings import LinkSettings
from resc.deployment.wire import Wire
from resc.errors import LinkError
from resc.run_folder import finish_run, provenance
from resc.starting.launch import launch_here

ROLLOUTS = "rollouts"
SIGNALS = {signal.SIGINT: "Ctrl-C", signal.SIGTERM: "SIGTERM"}


class Fly(Command):
    """One flight."""

    def __call__(self) -> None:
        """Flies it, and leaves a recording.

        Raises:
            LinkError: The flight controller does not answer, or the flight was stopped.
        """
        self.check()
        numbers: LinkSettings = build(self.config["link"], "link", kind=LinkSettings)
        prepared = prepare(linked(self.evaluation()))
        with (
            logged(self.folder / "fly.log"),
            closing(self.link(numbers, prepared)) as link,
            interrupting(link),
        ):
            link.wait(prepared.start_w)
            directory = self.folder / ROLLOUTS
            result = fly_linked(prepared, link, directory, arm=self.config["arm"])
            self._report(result, link)

    def link(self, numbers: LinkSettings, prepared: Prepared) -> Link:
        """A link for a flight, its port open."""
        context = prepared.env.stages.context
        set_points = SetPoints(
            context.vehicle,
            rate_limit_radps=numbers.rate_limit_radps,
            thrust_limits=numbers.thrust_limits,
        )
        wire = Wire(self.config["connection"], system=SYSTEM, component=COMPONENT)
        link = Link(wire, numbers, set_points, context.dt_s)
        low, high = numbers.height_m
        link.geofence = prepared.geofence((low, high))
        return link

    def _report(self, result: Mapping[str, Any], link: Link) -> None:
        reason = {"stopped": link.reason} if link.reason else {}
        figures = {**result, **reason, **link.schedule.figures(), **provenance()}
        finish_run(self.folder, figures, "flight")
        print(f"{result['outcome']} after {result['flown_s']:.2f} s")
        print(link.schedule)
        print(f"recording {self.folder / ROLLOUTS}")
        if result["outcome"] != ARRIVED:
            raise LinkError(link.reason or f"The flight ended by {result['outcome']}.")


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
