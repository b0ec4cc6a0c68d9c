"""The processes of one training, which torchrun starts together: who they are, what they share.

Each is a *rank*. Whatever they do together they do in the same order. In a process on its own every
function here does nothing, and is not felt.
"""

import functools
import hashlib
import io
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from typing import Any, cast

import torch
import torch.distributed as dist
from jaxtyping import Float, Shaped
from torch import Tensor, nn
from torch.distributed.rendezvous import rendezvous

from resc.cuda_graph import copy_each
from resc.errors import ConfigError, LostRankError
from resc.shared_means import PLACE, SharedMeans

PATIENCE = timedelta(minutes=10)
"""How long a rank waits for the others: one may still compile, or lay out its scenes."""
_WHY = "why"
"""In the store: the first sentence that a rank ended with."""
_store: Any = None


def join() -> None:
    """Meets the other processes that torchrun has started, if it has."""
    global _store
    if int(os.environ.get("WORLD_SIZE", "1")) < 2 or "MASTER_ADDR" not in os.environ:
        return
    with _together():
        _store, rank, count = next(iter(rendezvous("env://", timeout=PATIENCE)))
        dist.init_process_group("gloo", store=_store, rank=rank, world_size=count, timeout=PATIENCE)


def leave() -> None:
    """Lets go of the others, so that they notice at once."""
    if count() > 1:
        with suppress(RuntimeError):  # they have left already
            dist.destroy_process_group()
        _group.cache_clear()
        _shared_means.cache_clear()


def count() -> int:
    """How many ranks there are; 1 for a process on its own."""
    return dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1


def rank() -> int:
    """The number of this one, counted from 0."""
    return dist.get_rank() if count() > 1 else 0


def is_first() -> bool:
    """Whether this is the rank that speaks, evaluates and writes what is written once."""
    return rank() == 0


def may_say(error: Exception) -> bool:
    """Whether this rank tells of an error: each sentence is said by one of them.

    That another rank has ended is only said where it matters, or where nobody has said why.
    """
    if count() == 1 or _store is None:
        return True
    text = str(error)
    with suppress(RuntimeError):  # the rank that kept the store is gone
        if isinstance(error, LostRankError):
            if not getattr(error, "__notes__", []) and _store.check([_WHY]):
                return False
        else:
            _store.set(_WHY, text)
        key, own = hashlib.sha256(text.encode()).hexdigest(), str(rank())
        return _store.compare_set(key, "", own).decode() == own
    return True


def leave_word(error: Exception, text: str) -> None:
    """Leaves what ends this process where torchrun looks for it: its report, the last said, has it.

    Of a rank that ends because another has, it is what that one said, if it did.
    """
    path = os.environ.get("TORCHELASTIC_ERROR_FILE")
    if not path:
        return
    with suppress(RuntimeError):  # the rank that kept the store is gone
        if isinstance(error, LostRankError) and _store is not None and _store.check([_WHY]):
            text = _store.get(_WHY).decode()
    told = {"message": text, "extraInfo": {"timestamp": str(int(time.time()))}}
    with suppress(OSError):
        Path(path).write_text(json.dumps({"message": told}))


def share(number: int, name: str) -> int:
    """What one rank has of a whole number that all have together.

    Raises:
        ConfigError: It does not divide.
    """
    if number % count():
        raise ConfigError(
            f"{name} is {number}, which {count()} processes cannot share equally; take a multiple "
            f"of {count()}."
        )
    return number // count()


def own_seed(seed: int) -> int:
    """The seed of what each rank draws for itself: the first has the run's, others their own."""
    if is_first():
        return seed
    return int.from_bytes(hashlib.sha256(f"{seed}/rank {rank()}".encode()).digest()[:8]) >> 1


def any_of(said: bool) -> bool:
    """Whether any rank says so."""
    return said if count() == 1 else bool(total(torch.tensor(int(said))))


def gather(value: Any) -> list[Any]:  # noqa: ANN401 - whatever can be pickled
    """The values of all ranks, in their order."""
    if count() == 1:
        return [value]
    found: list[Any] = [None] * count()
    with _together():
        dist.all_gather_object(found, value)
    return found


def from_first(make: Callable[[], Any]) -> Any:  # noqa: ANN401 - whatever can be pickled
    """What `make` gives the first rank, which alone calls it."""
    if count() == 1:
        return make()
    found = [make() if is_first() else None]
    with _together():
        dist.broadcast_object_list(found)
    return found[0]


def wait() -> None:
    """Until all ranks are here."""
    if count() > 1:
        with _together():
            dist.barrier()


def to_first(state: dict[str, Any]) -> list[dict[str, Any]]:
    """The states of all ranks for the first one, tensors on the CPU; none for the others."""
    if count() == 1:
        return [state]
    packed = io.BytesIO()
    torch.save(state, packed)
    found: list[Any] | None = [None] * count() if is_first() else None
    with _together():
        dist.gather_object(packed.getvalue(), found)
    return [
        torch.load(io.BytesIO(part), map_location="cpu", weights_only=True) for part in found or ()
    ]


def copy_first(module: nn.Module) -> None:
    """Gives all ranks the weights and statistics of the first: other machines may round."""
    if count() > 1:
        for value in module.state_dict().values():
            with _together():
                dist.broadcast(value, 0, _group(value.is_cuda))


def total(tensor: Shaped[Tensor, "..."]) -> Shaped[Tensor, "..."]:
    """The sum over the ranks, the same bits for all."""
    if count() == 1:
        return tensor
    result = tensor.clone()
    with _together():
        dist.all_reduce(result, group=_group(tensor.is_cuda))
    return result


def mean(tensor: Shaped[Tensor, "..."]) -> Shaped[Tensor, "..."]:
    """The mean over the ranks, the same bits for all."""
    return total(tensor) / count() if count() > 1 else tensor


def moments(
    samples: Float[Tensor, "n d"],
) -> tuple[Float[Tensor, " d"], Float[Tensor, " d"]]:
    """Mean and sum of squared deviations of each column, over as many samples of every rank."""
    centre = mean(samples.mean(0))
    return centre, total((samples - centre).square().sum(0))


def average_(tensors: Sequence[Shaped[Tensor, "..."]]) -> None:
    """Puts the means over the ranks into float tensors, all with one message."""
    if count() == 1:
        return
    flat = torch.cat([tensor.reshape(-1) for tensor in tensors])
    fits = flat.is_cpu and flat.dtype is torch.float32
    shared = _shared_means(len(flat)) if fits else None
    with _together():
        if shared:
            shared.take_(flat)
        else:
            dist.all_reduce(flat, group=_group(flat.is_cuda))
            flat.div_(count())
    parts = flat.split([tensor.numel() for tensor in tensors])
    views = [part.view_as(tensor) for tensor, part in zip(tensors, parts, strict=True)]
    copy_each(views, tensors)


def take_card(device: str) -> None:
    """Makes `cuda` mean the card of this rank: the first of a machine gets its first.

    Raises:
        ConfigError: There is none for every rank.
    """
    if count() == 1 or device == "cpu":
        return
    here, cards = int(os.environ.get("LOCAL_WORLD_SIZE", count())), torch.cuda.device_count()
    if device != "cuda":
        raise ConfigError(
            f"device is '{device}', which {count()} processes would share; device=cuda gives each "
            "a card of its own."
        )
    if here > cards:
        raise ConfigError(
            f"torchrun has started {here} processes on a machine with {cards} GPU(s); start as "
            "many as there are, or take device=cpu."
        )
    torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", rank())))


def started_by(command: str, processes: int | None = None) -> str:
    """The command that starts so many processes, or as many as this training has, from that of one.

    Args:
        command: That of one.
        processes: How many, if not as many as there are.
    """
    processes = processes or count()
    if processes == 1:
        return command
    here = int(os.environ.get("LOCAL_WORLD_SIZE", processes))
    here = here if processes == count() else processes
    nodes = f"--nnodes={processes // here} " if here < processes else ""
    script = command.removeprefix("python ")
    script = script if script != command else f"--no-python {command}"
    return f"torchrun {nodes}--nproc-per-node={here} {script}"


@functools.cache
def _group(on_gpu: bool) -> dist.ProcessGroup | None:
    """What carries tensors of the CPU (None, the default), or of cards."""
    if not on_gpu:
        return None
    return cast(dist.ProcessGroup, dist.new_group(backend="nccl", timeout=PATIENCE))


@functools.cache
def _shared_means(length: int) -> SharedMeans | None:
    """Memory for vectors of this length, where all ranks are on this machine and have some."""
    if int(os.environ.get("LOCAL_WORLD_SIZE", "0")) != count():
        return None
    place = str(PLACE) if PLACE.is_dir() else None
    folder = Path(from_first(lambda: tempfile.mkdtemp(prefix="resc-", dir=place)))
    made = None
    with suppress(OSError):
        made = SharedMeans(rank(), count(), length, folder, wait, PATIENCE.total_seconds())
    if is_first():
        shutil.rmtree(folder, ignore_errors=True)
    return None if any_of(made is None) else made


@contextmanager
def _together() -> Iterator[None]:
    """Says in a sentence that another rank is gone."""
    try:
        yield
    except RuntimeError as error:
        raise LostRankError(
            "Another process of this training has ended or does not answer, so this one stops."
        ) from error
