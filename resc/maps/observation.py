"""What all observations of the map share: the keys they read and the truncation of distances."""

from typing import Annotated, Unpack

from jaxtyping import Float, Int
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.maps.constants import INFLATION_M, LONGEST_RAY_M, TRUNCATION_M
from resc.maps.distance_field import DistanceField, select
from resc.quantities import Within
from resc.term import Context, Observation, ObservationOptions

MAP_KEYS = (keys.SCENE_INDEX, keys.ESDF, keys.MAP_ORIGIN_W, keys.MAP_SIZE)
"""The last keys that every observation of the map reads; `field` takes their tensors."""
RayLength = Annotated[float, Within(0, LONGEST_RAY_M, above=True)]
"""A configured range of rays [m]."""


class MapOptions(ObservationOptions, total=False):
    """The arguments of `MapObservation`, which an observation with its own takes as `**options`."""

    truncation_m: float


class MapObservation(Observation):
    """An observation of the distance field around the vehicle.

    Args:
        truncation_m: Distances of the map are cut to this one. Less than the published 3.0 m keeps
            from the policy what a camera would not see (2024 paper, V-B.3); rays then jump less far
            at a time, which moves their ends by up to 0.1 m and lets them come nearer to the
            border.
        **options: Of every observation.
    """

    def __init__(
        self, *, truncation_m: float = TRUNCATION_M, **options: Unpack[ObservationOptions]
    ) -> None:
        super().__init__(**options)
        if not INFLATION_M < truncation_m <= TRUNCATION_M:
            raise ConfigError(
                f"truncation_m is {truncation_m}; expected more than {INFLATION_M} and at most "
                f"{TRUNCATION_M}, where the maps end."
            )
        self.truncation_m = truncation_m

    def bind(self, context: Context) -> None:
        """Takes the size of a map cell."""
        self.resolution_m = context.resolution_m

    def field(
        self,
        index: Int[Tensor, "n 1"],
        esdf: Float[Tensor, "p h w"],
        origin: Float[Tensor, "p 2"],
        size: Float[Tensor, "p 2"],
    ) -> DistanceField:
        """The truncated distance field of each environment, from the tensors of `MAP_KEYS`."""
        return select(esdf, index, origin, size, self.resolution_m, self.truncation_m)
