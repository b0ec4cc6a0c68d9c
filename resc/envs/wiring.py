"""Whether terms fit together: what one reads, another has written, and what is drawn is read."""

from collections.abc import Collection, Sequence, Set

from resc import keys
from resc.envs.terms import Terms
from resc.errors import ConfigError
from resc.keys import DECLARED, NestedKey
from resc.term import Replanning, Reward, Sensor, Term


def check_wiring(terms: Terms, *, at_begin: Set[NestedKey], functions: Collection[Sensor]) -> None:
    """Every key a term reads must be there before it runs, for observations at a reset too.

    Args:
        terms: In the order in which they run.
        at_begin: What the world holds where an episode begins.
        functions: Sensors that are computed at a reset, too.

    Raises:
        ConfigError: It names the term and the key.
    """
    if keys.FINISHED not in terms.task.outputs:
        raise ConfigError(
            f"{terms.task.path} does not write {'.'.join(keys.FINISHED)}, by which "
            "episodes succeed; let it write whether the task is done."
        )
    _require_use(terms)
    if terms.replanning and not terms.sensing:
        raise ConfigError(
            f"{terms.replanning.path} goes by the map that a vehicle knows, but without a "
            "sensing the whole map is known from the beginning; choose sensing=local, "
            "predicted, depth or lidar2d, or replanning=none."
        )
    shared = {key for key, declared in DECLARED.items() if declared.shared}
    of_scene = {keys.START_W, keys.START_MOTION, keys.ROUTE_CLEARANCE}
    of_scene |= {keys.ROUTE_W, keys.ROUTE_LENGTH}
    at_reset = shared | at_begin | of_scene | {keys.CLOCK}
    known = at_reset | {keys.ACTION}
    for term in terms:
        if isinstance(term, Reward | Replanning):
            known |= {keys.TERMINATED, keys.TRUNCATED, keys.DONE}
        _require(term, known, "which nothing before it writes")
        known |= set(term.outputs)
    for term in functions:
        at_reset |= set(term.outputs) if at_reset.issuperset(term.reads) else set()
    for term in terms.observed:
        _require(term, at_reset, "which an episode does not begin with")


def _require(term: Term, known: Set[NestedKey], fact: str) -> None:
    for key in term.reads:
        if not isinstance(key, tuple):
            raise ConfigError(
                f"{term.path} reads {key!r}, which is not a key; reads is a tuple of keys such as "
                "(keys.POSITION_W,) with its comma."
            )
        if key not in known:
            add = "choose sensing=local, predicted, depth or lidar2d"
            add = add if key in keys.KNOWN_MAP else "add a term that writes it"
            raise ConfigError(
                f"{term.path} reads {'.'.join(key)}, {fact}; {add}, or drop this one."
            )


def _require_use(terms: Terms) -> None:
    """What is drawn for an episode must change something."""
    loop, own_loop = terms.rate_loop, terms.dynamics.own_loop
    drawn = {key for term in terms.randomizations for key in term.outputs}
    by_loop = {*loop.reads, *({keys.GYRO_STREAM} & drawn)}
    read = {key for term in terms if term is not loop for key in term.reads}
    read |= set() if own_loop else by_loop
    idle = [term for term in terms.randomizations if not read & set(term.outputs)]
    if not idle:
        return
    facts = " and ".join(f"{term.path} draws {'.'.join(term.outputs[0])}" for term in idle)
    unheard = (own_loop if by_loop & set(term.outputs) else term.readers for term in idle)
    add = _choices([setting for setting in unheard if setting])
    raise ConfigError(
        f"{facts}, which nothing reads, so it would change nothing; {add}, or leave it out."
    )


def _choices(settings: Sequence[str]) -> str:
    """What to choose, for a message: one file of a group, or settings of that which is chosen."""
    last = {setting.split("=")[0]: setting for setting in settings}
    files = {name for name in last if "." not in name}
    chosen = [last[name] for name in last if name in files or name.split(".")[0] not in files]
    return f"choose {' '.join(chosen)}" if chosen else "add what reads it"
