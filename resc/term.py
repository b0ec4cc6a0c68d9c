"""The protocol of every swappable part: keys in, tensors through `compute`, keys out."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypedDict, cast

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from resc import keys
from resc.errors import ConfigError
from resc.keys import NestedKey
from resc.math.sampling import gaussian
from resc.quantities import Count, NotNegative, Number, Positive, Within
from resc.sights import Pose, Shape

FRAMES = ("world", "heading")
CellSize = Annotated[float, Within(0.001, 1)]
"""A greater cell has room for a vehicle beside each obstacle in it."""


@dataclass(frozen=True)
class Context:
    """What a term may know about its surroundings: constants only, never the environment.

    Args:
        dt_s: Control period.
        resolution_m: Edge of a map cell.
        vehicle: Nominal parameters (see `resc.simulation.vehicle.Vehicle`).
        observation_frame: What horizontal vectors of the observation are aligned with: the axes of
            the world, or the vehicle's heading.
        history: Steps that an observation shows when it does not say itself.
        longest_delay_steps: What the action's queue holds; None where it is not known.
        clearance_m: Least and greatest distance that the routes of the scenes keep; None where they
            do not say.
        latency_s: Greatest age of a device's reading when it arrives.
        runs: Times per control step that a term is called, `dt_s` being the time between two calls.
    """

    dt_s: Annotated[float, Within(1e-4, 0.5)]
    resolution_m: CellSize
    vehicle: Any
    observation_frame: str = "world"
    history: Count = 1
    longest_delay_steps: int | None = None
    clearance_m: Sequence[float] | None = None
    latency_s: float = 0.0
    runs: int = 1

    def __post_init__(self) -> None:
        for name in ("dt_s", "resolution_m"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} is {getattr(self, name)}; expected a number above zero.")
        if self.observation_frame not in FRAMES:
            raise ConfigError(
                f"observation_frame is '{self.observation_frame}'; expected world or heading."
            )
        if self.history < 1:
            raise ConfigError(f"history is {self.history}; expected a whole number from 1 on.")


class Term(TensorDictModuleBase):
    """A pure function from the tensors under `reads` to the tensors under `writes`.

    `writes = ()` means one key named by the configuration, `(group, name)`. Terms hold constants
    only; what must survive a step is written under a key with an `initial` value, or under one that
    it `keeps` and gives a value in `begin`. Its keys stand under `group`, its configuration under
    `section` where that is another. A term whose number may be the episode's own, where it is
    configured as null, adds its key to `reads`. `dims` are the lengths of declared axes that have
    names.

    Uniform numbers in [0, 1) per environment reach `compute` as its last argument: `draws` of them
    for terms of the reset, `step_draws`, at every step and reset, for all others.

    What a term `varies` with, it reads after everything else where that is drawn for every episode,
    or kept by what plans routes again.

    A term that calls other code than torch says so, `compiles = False`, and flies uncompiled. One
    whose outputs come from outside, so that no replay gives them again, says `replays = False`.

    A rate loop may run several times in a control step, as many `runs` as it says once it is bound;
    each is followed by dynamics of a part of the step. Dynamics that fly by a rate loop of
    their own name, as `own_loop`, the setting with which they fly by the given one instead.

    A term that `eases` can be made easier: with `difficulty: name` in its configuration, the
    difficulty of that name, [n, 1] in [0, 1], follows all other arguments of `compute`.
    """

    reads: tuple[NestedKey, ...] = ()
    writes: tuple[NestedKey, ...] = ()
    varies: tuple[NestedKey, ...] = ()
    initial: Mapping[NestedKey, float] = {}
    keeps: tuple[NestedKey, ...] = ()
    dims: Mapping[str, int] = {}
    group: ClassVar[str] = ""
    section: ClassVar[str] = ""
    draws: int = 0
    step_draws: int = 0
    name: str = ""
    eases: ClassVar[bool] = False
    compiles: ClassVar[bool] = True
    replays: ClassVar[bool] = True
    runs: int = 1
    own_loop: str = ""
    difficulty: str | None = None

    def bind(self, context: Context) -> None:
        """Takes the constants of its surroundings, once, before the first `compute`."""

    def vary(self, drawn: Collection[NestedKey]) -> None:
        """Reads what it varies with, too, as far as it is `drawn` or kept."""
        if self.varies:
            own = [key for key in self.reads if key not in self.varies]
            self.reads = (*own, *(key for key in self.varies if key in drawn))

    def further(self, values: Sequence[Tensor]) -> dict[NestedKey, Tensor]:
        """By their keys, the last arguments of `compute`: what not every such term reads."""
        return dict(zip(self.reads[len(self.reads) - len(values) :], values, strict=True))

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """What it keeps at the beginning of an episode, beside `initial`, from what is there."""
        del tensors
        return {}

    def compute(self, *tensors: Tensor) -> Tensor | tuple[Tensor, ...]:
        """The maths, on batched tensors in the order of `reads`."""
        raise ConfigError(
            f"{type(self).__name__} has no compute(); add one that takes {len(self.reads)} tensors."
        )

    def named(self, name: str) -> "Term":
        """Gives the term its configured name and, with it, its keys."""
        self.name = name
        # tensordict annotates its keys as tuples of exactly one string, but takes any length.
        self.in_keys = list(self.reads)  # pyright: ignore[reportAttributeAccessIssue]
        self.out_keys = list(self.outputs)  # pyright: ignore[reportAttributeAccessIssue]
        return self

    @property
    def path(self) -> str:
        """Where it stands in the configuration, for messages."""
        return ".".join(part for part in (self.section or self.group, self.name) if part)

    @property
    def outputs(self) -> tuple[NestedKey, ...]:
        """The keys it writes, the name filled in."""
        return self.writes or ((self.group, self.name),)

    @property
    def blocks(self) -> dict[str, int]:
        """Widths of the uniform blocks that `run` takes at every step, by generator."""
        return {self.path: self.step_draws} if self.step_draws else {}

    def run(self, tensors: dict[NestedKey, Tensor], *drawn: Tensor) -> None:
        """Reads from and writes to a flat dict: what the compiled step is made of."""
        result = self.compute(*self.given(tensors, *drawn))
        values = result if isinstance(result, tuple) else (result,)
        for key, value in zip(self.outputs, values, strict=True):
            tensors[key] = value

    def given(self, tensors: dict[NestedKey, Tensor], *drawn: Tensor) -> tuple[Tensor, ...]:
        """The arguments of `compute`."""
        return (*(tensors[key] for key in self.reads), *drawn, *self.easing(tensors))

    def easing(self, tensors: dict[NestedKey, Tensor]) -> tuple[Tensor, ...]:
        """The difficulty that `compute` takes as its last argument, if one is configured."""
        return (tensors[keys.difficulty(self.difficulty)],) if self.difficulty else ()

    def forward(self, tensordict: TensorDictBase, *drawn: Tensor) -> TensorDictBase:
        """TensorDict in, TensorDict out: the same as `run`, for tests and notebooks."""
        there = tensordict.keys(include_nested=True, leaves_only=True)
        tensors = {
            key if isinstance(key, tuple) else (key,): cast(Tensor, tensordict[key])
            for key in there
        }
        self.run(tensors, *drawn)
        for key in self.outputs:
            tensordict[key] = tensors[key]
        return tensordict


@dataclass(frozen=True)
class Channel:
    """What one number a of an action in [-1, 1] commands: offset + slope a.

    Args:
        name: What it commands.
        unit: Of offset and slope.
        frame: What it is seen in: `body`, `world`.
        offset: Command at a = 0.
        slope: Change of the command from a = 0 to a = 1.
    """

    name: str
    unit: str
    frame: str
    offset: float
    slope: float


class Action(Term):
    """Turns the policy's output into a command.

    `width` is the number of actions; a command waits for at most `longest_delay_steps`. `channels`
    say what each number commands, for policies that are exported.
    """

    width: ClassVar[int]
    longest_delay_steps: int = 0

    @property
    def channels(self) -> Sequence[Channel]:
        """One for each number; none where nobody has said."""
        return ()


class Sensor(Term):
    """Something measured from the state and the map; several observations may share it.

    What a sensor that `judges` gives, metrics and terminations read: in an evaluation it has the
    numbers of the evaluation, whatever the policy was trained with.
    """

    group = "sensor"
    judges: ClassVar[bool] = False


class Device(Sensor):
    """A device on the vehicle or beside it: its readings of the true state, noise and all.

    What it reads now stays in the world until its next reading, and estimators make the best of it.
    In an evaluation, devices are the evaluation's. Other sensors are functions of the state:
    observations read those of the estimated one.
    """

    judges = True
    latency_s: float = 0.0

    @property
    def keeps(self) -> tuple[NestedKey, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Its readings."""
        return self.outputs


class Estimator(Term):
    """Estimates the state, for the policy to see: what it writes begins with `keys.ESTIMATES`.

    Rewards, terminations, metrics and what the value function alone sees read the true state.
    An episode begins with the `compute` of its step 0, in which no time has passed.
    """

    writes: tuple[NestedKey, ...] = tuple(keys.ESTIMATES.values())

    @property
    def keeps(self) -> tuple[NestedKey, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The estimate, and whatever else it writes."""
        return self.outputs

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """The estimate before its first `compute`: the truth."""
        return {estimate: tensors[truth] for truth, estimate in keys.ESTIMATES.items()}


class Sensing(Term):
    """What a vehicle sees of the map: it keeps the map that the vehicle knows.

    The policy's observations read the known map; rewards, terminations, metrics and what the value
    function alone sees read the true one. Maps are large, so it alone changes what it reads in
    place: `writes`, its last `reads`.
    """

    writes: tuple[NestedKey, ...] = keys.KNOWN_MAP

    @property
    def keeps(self) -> tuple[NestedKey, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The known map."""
        return self.outputs


class Replanning(Term):
    """Renews the route in flight, by the map that the vehicle knows.

    It runs once the step is judged, so that the new control points are the first to be observed; an
    episode begins with its `compute` of step 0. It reads the estimated state, if there is one.
    """


class ObservationOptions(TypedDict, total=False):
    """The arguments of `Observation`, which an observation with its own takes as `**options`."""

    scale: Number
    noise: NotNegative
    clip: Positive | None
    history: Count | None


class Observation(Term):
    """A block of the observation vector, [n, width].

    `compute` gives the raw SI values, world-aligned. What follows is the same for every block, in
    this order: turning to the heading (where the run asks for it), scale, noise, clip, history.

    y_t = clip(scale * (x_t + noise * z_t)), z_t standard normal; block = [y_t, y_t-1, ...].

    The past is kept as it was seen: with its noise, clipped, aligned with the heading of its time.
    At a reset there is none; the first observation then stands in every step, because zeros would
    read as a real state (at rest, on the control point) and as a jump one step later.

    The noise has a generator of its own, so that it leaves the draws of `compute` alone.

    `units` are those of the raw values, one for all columns or one for each; `frame` is that of
    columns which no run turns, such as `body`.

    Args:
        scale: Factor applied to the raw SI value.
        noise: Standard deviation of Gaussian noise, in the unit of the raw value.
        clip: Bound on the magnitude of the scaled, noisy value; null for none.
        history: Steps shown, newest first; null for what `env.history` says.
    """

    group = "observation"
    columns: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    frame: str = ""
    compute: Callable[..., Tensor]

    def __init__(
        self,
        *,
        scale: Number = 1.0,
        noise: NotNegative = 0.0,
        clip: Positive | None = None,
        history: Count | None = None,
    ) -> None:
        super().__init__()
        if noise < 0:
            raise ConfigError(f"noise is {noise}; expected a number from 0 on.")
        if clip is not None and clip <= 0:
            raise ConfigError(f"clip is {clip}; expected a number above zero, or null for none.")
        if history is not None and history < 1:
            raise ConfigError(
                f"history is {history}; expected at least 1, or null for what env.history says."
            )
        self.scale = scale
        self.noise = noise
        self.clip = clip
        self.history = history

    def sights(self, numbers: Tensor, pose: Pose) -> list[Shape]:
        """What it sees, for pictures and 3-D scenes: nothing, unless it says how it is drawn.

        Args:
            numbers: Those of `compute` [t, c], before heading, scale, noise, clip and history.
            pose: What they were seen from [t].
        """
        del numbers, pose
        return []

    @property
    def keeps(self) -> tuple[NestedKey, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Its block, if that has a past."""
        return self.outputs if self.width > len(self.columns) else ()

    @property
    def blocks(self) -> dict[str, int]:
        """Its own draws, and those of its noise."""
        # Not by super(): torch.compile cannot follow it to a property.
        own = {self.path: self.step_draws} if self.step_draws else {}
        noise = {f"{self.path}.noise": len(self.columns)} if self.noise else {}
        return own | noise

    def run(self, tensors: dict[NestedKey, Tensor], *drawn: Tensor) -> None:
        """Writes the block [n, width]: computed, turned, shaped, and with its past.

        What it wrote before is its past; where there is none, an episode begins.
        """
        (key,) = self.outputs
        own, noise = drawn[: bool(self.step_draws)], drawn[bool(self.step_draws) :]
        value = self.compute(*self.given(tensors, *own))
        if keys.AHEAD in tensors:
            value = self.turned(value, tensors[keys.AHEAD])
        tensors[key] = self.lengthened(self.shaped(value, *noise), tensors.get(key))

    @property
    def width(self) -> int:
        """Number of columns, those of earlier steps included."""
        return len(self.columns) * (self.history or 1)

    @property
    def column_names(self) -> list[str]:
        """A name for each of the `width` columns; those of earlier steps end in `_1_ago` etc."""
        ages = range(self.history or 1)
        return [f"{name}_{age}_ago" if age else name for age in ages for name in self.columns]

    @property
    def vectors(self) -> tuple[tuple[int, int], ...]:
        """Pairs of columns that are x and y of a horizontal vector: those named `_x` and `_y`."""
        at = {name: number for number, name in enumerate(self.columns)}
        pairs = ((name, f"{name[:-1]}y") for name in self.columns if f"_{name}".endswith("_x"))
        return tuple((at[x], at[y]) for x, y in pairs if y in at)

    def frames(self, observation_frame: str) -> list[str]:
        """What each column is seen in: horizontal vectors, and their heights, as the run asks."""
        turned = {self.columns[column][:-1] for pair in self.vectors for column in pair}
        follows = ("x", "y", "z")
        return [
            observation_frame if name[:-1] in turned and name[-1:] in follows else self.frame
            for name in self.columns
        ]

    def turned(self, raw: Tensor, heading: Tensor) -> Tensor:
        """The raw values [n, c] with their vectors turned by minus the yaw.

        (x, y) -> (c x + s y, c y - s x), `heading` being the yaw's cosine and sine [n, 2].
        """
        cosine, sine = heading.unbind(-1)
        columns = list(raw.unbind(-1))
        for i, j in self.vectors:
            x, y = columns[i], columns[j]
            columns[i], columns[j] = cosine * x + sine * y, cosine * y - sine * x
        return torch.stack(columns, -1)

    def shaped(self, raw: Tensor, unit: Tensor | None = None) -> Tensor:
        """Scale, noise from uniform numbers `unit` [n, c], clip."""
        value = raw * self.scale
        if unit is not None:
            value = value + self.scale * self.noise * gaussian(unit)
        return value if self.clip is None else value.clamp(-self.clip, self.clip)

    def lengthened(self, value: Tensor, past: Tensor | None) -> Tensor:
        """The newest values [n, c] before those of the past [n, width], the oldest left out."""
        ages = self.width // len(self.columns)
        if ages == 1:
            return value
        rest = value.repeat(1, ages - 1) if past is None else past[:, : -len(self.columns)]
        return torch.cat((value, rest), -1)


class Reward(Term):
    """An unweighted reward, [n, 1]; the environment adds `weight` times it to the reward.

    With `difficulty: name` in its configuration, that difficulty scales the weight.
    """

    group = "reward"
    eases = True

    def __init__(self, *, weight: Number) -> None:
        super().__init__()
        self.weight = weight

    def easing(self, tensors: dict[NestedKey, Tensor]) -> tuple[Tensor, ...]:
        """Nothing: the difficulty is the weight's."""
        return ()

    def weighted(self, tensors: dict[NestedKey, Tensor]) -> Tensor:
        """Its summand of the reward, [n, 1]."""
        value = tensors[self.outputs[0]] * self.weight
        return value * tensors[keys.difficulty(self.difficulty)] if self.difficulty else value


class Termination(Term):
    """A reason to end an episode, [n, 1] bool.

    `truncates`: the clock's doing, so the value function bootstraps. `collision`: an obstacle's, so
    that it counts among the collisions.
    """

    group = "termination"
    truncates: ClassVar[bool] = False
    success: ClassVar[bool] = False
    collision: ClassVar[bool] = False


class Randomization(Term):
    """Draws numbers at every reset: reads nominal values, if there are any, writes drawn ones.

    Where nothing reads them, the run is refused; `readers` are the settings of one that does.
    """

    group = "params"
    section = "randomization"
    readers: ClassVar[str] = ""


class Metric(Term):
    """A running number per episode, [n, 1]: `compute(so_far, *reads)` gives its next value.

    `start` is its value at the reset; it stands still once the route is finished, unless it says
    otherwise.
    """

    group = "metric"
    unit: ClassVar[str] = "-"
    start: ClassVar[float] = 0.0
    freezes_at_finish: ClassVar[bool] = True
    compute: Callable[..., Tensor]

    @property
    def keeps(self) -> tuple[NestedKey, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Its number."""
        return self.outputs

    def begin(self, tensors: Mapping[NestedKey, Tensor]) -> Mapping[NestedKey, Tensor]:
        """Its number at the reset."""
        (key,) = self.outputs
        return {key: torch.zeros_like(tensors[keys.CLOCK]) + self.start}

    def run(self, tensors: dict[NestedKey, Tensor], *drawn: Tensor) -> None:
        """Moves its number on by a step."""
        (key,) = self.outputs
        before = tensors[key]
        value = self.compute(before, *self.given(tensors, *drawn))
        if self.freezes_at_finish:
            value = torch.where(tensors[keys.previous(keys.FINISHED)], before, value)
        tensors[key] = value


class Curriculum(Term):
    """Gives one named difficulty in [0, 1], [1, 1], after every batch of training.

    Parts name the difficulty that eases them in their configuration and meet its new value at their
    next reset. What a curriculum remembers stands under the keys of `initial`. Scenes are laid out
    in advance at its `levels`, in ascending order; a difficulty between two of them draws episodes
    from both.

    With `optional: true` in its configuration, it rests where nothing reads its difficulty: that of
    a reward that a study leaves out.
    """

    group = "difficulty"
    section = "curriculum"
    writes = (keys.CURRICULUM_DIFFICULTY,)
    levels: Sequence[float]
    optional: bool = False


def uniform_between(unit: Tensor, low: float | Tensor, high: float | Tensor) -> Tensor:
    """Maps uniform numbers in [0, 1) to [low, high)."""
    return low + (high - low) * unit


def least_and_greatest(name: str, ends: Sequence[float]) -> tuple[float, float]:
    """The two ends of a range of positive numbers.

    Raises:
        ConfigError: They are not two, not above zero or not in order.
    """
    if len(ends) != 2 or not 0 < ends[0] <= ends[1]:
        raise ConfigError(f"{name} is {list(ends)}; expected [least, greatest], both above zero.")
    return float(ends[0]), float(ends[1])


def as_column(values: float, like: Tensor) -> Tensor:
    """A [n, 1] column holding one constant, on the device and of the dtype of `like`."""
    return torch.full((like.shape[0], 1), values, dtype=like.dtype, device=like.device)
