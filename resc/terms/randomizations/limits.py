"""The dial: how fast and how near to obstacles an episode may be flown."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import MapDistance
from resc.quantities import NotNegative, Positive
from resc.term import Context, Randomization, least_and_greatest, uniform_between


class SpeedLimit(Randomization):
    """The speed [m/s] that an episode may reach, uniform between two ends; equal ends fix it.

    Terms with `speed_mps: null` keep to it.

    Args:
        speed_mps: Least and greatest.
    """

    writes = (keys.SPEED_LIMIT,)
    reads = (keys.START_W,)
    draws = 1

    def __init__(self, *, speed_mps: Sequence[Positive]) -> None:
        super().__init__()
        self.speed_mps = least_and_greatest("speed_mps", speed_mps)

    def compute(
        self, start: Float[Tensor, "n 3"], unit: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 1"]:
        return uniform_between(unit, *self.speed_mps)


class Margin(Randomization):
    """The distance [m] to obstacles that an episode keeps, as terms with `radius_m: null` read it.

    What the scene's route keeps, less the headroom, within the two ends: a route that the vehicle
    could not follow would teach nothing. Uniform between them where the scene does not say what its
    route keeps; equal ends fix it.

    Args:
        margin_m: Least and greatest.
        headroom_m: By how much a route stays clear of the margin.
    """

    writes = (keys.MARGIN,)
    reads = (keys.ROUTE_CLEARANCE,)
    draws = 1

    def __init__(self, *, margin_m: Sequence[MapDistance], headroom_m: NotNegative = 0.1) -> None:
        super().__init__()
        self.margin_m = least_and_greatest("margin_m", margin_m)
        self.headroom_m = headroom_m

    def bind(self, context: Context) -> None:
        """Margins other than those that the scene's routes allow would be cut, or never met.

        Equal ends fix the margin whatever the routes keep.
        """
        kept = context.clearance_m
        if kept is None or len(set(self.margin_m)) == 1:
            return
        met = [round(end - self.headroom_m, 6) for end in kept]
        if met != [round(end, 6) for end in self.margin_m]:
            wanted = [round(end + self.headroom_m, 6) for end in self.margin_m]
            raise ConfigError(
                f"margin_m is {list(self.margin_m)}, but routes keep scene.clearance_m="
                f"{list(kept)}, less {self.headroom_m:g} m of headroom {met}; set "
                f"scene.clearance_m={wanted}."
            )

    def compute(
        self, clearance: Float[Tensor, "n 1"], unit: Float[Tensor, "n 1"]
    ) -> Float[Tensor, "n 1"]:
        least, greatest = self.margin_m
        of_scene = (clearance - self.headroom_m).clamp(least, greatest)
        return of_scene.where(clearance.isfinite(), uniform_between(unit, least, greatest))
