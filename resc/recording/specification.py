"""What every file of a recording says about itself: the metadata record `resc.spec`."""

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields

from resc.errors import ConfigError, RecordingError, nearest
from resc.recording.schema import ACTION, SAMPLED_ACTION, Column, column_tree

FORMAT = "4"
"""Version of the file layout that is written."""
OLDER = "3"
"""The one before, which is read, too: `action` was the sample, and no file named earlier ones."""
_SINCE_FORMAT_4 = ("earlier", "first_step")
_SEAL = "crc32"


def require(fine: bool, name: str, value: object, expected: str) -> None:
    """Refuse a recorder argument unless `fine`."""
    if not fine:
        raise ConfigError(f"recorder.{name} is {value!r}; expected {expected}.")


@dataclass(frozen=True)
class Specification:
    """Everything a reader must know to decode a file.

    The files of one recorder share `session`. `earlier` are the sessions recorded in the same
    folder before, oldest first; what this one records takes their place from its `first_step` on.
    In the first file of a session that is None: it is the first step found there. `earlier` is None
    where the file does not say. `columns` are those that are read; `stored` lie in the file.
    """

    columns: tuple[Column, ...]
    num_envs: int
    dt_s: float
    outcomes: tuple[str, ...]
    round_bits: int | None
    every_n_batches: int
    session: str
    earlier: tuple[str, ...] | None = ()
    first_step: int | None = None
    format: str = FORMAT

    def __post_init__(self) -> None:
        bits, period = self.round_bits, self.every_n_batches
        require(len(self.columns) > 0, "columns", self.columns, "at least one")
        column_tree(self.columns)  # refuses names that clash
        require(bits is None or 1 <= bits <= 22, "round_bits", bits, "1 to 22, or null")
        require(period >= 1, "every_n_batches", period, "1 or more")
        # Times stay unique as long as the environment numbers fit into one control step.
        limit = f"1 to the nanoseconds in dt_s ({self.dt_ns})"
        require(1 <= self.num_envs <= self.dt_ns, "num_envs", self.num_envs, limit)

    @property
    def dt_ns(self) -> int:
        """Control step [ns]; log_time = start_step * dt_ns + env_id."""
        return round(self.dt_s * 1e9)

    @property
    def stored(self) -> tuple[Column, ...]:
        """The columns as they lie in the file."""
        if self.format == FORMAT:
            return self.columns
        return tuple(column for column in self.columns if column != SAMPLED_ACTION)

    def to_metadata(self) -> dict[str, str]:
        """The flat strings of an MCAP metadata record; all but `format` and `crc32` are JSON."""
        values = {name: getattr(self, name) for name in _entries()}
        values["columns"] = [_entry(column) for column in self.columns]
        texts = {name: json.dumps(value) for name, value in values.items()}
        return sealed({"format": FORMAT} | texts)

    @classmethod
    def from_metadata(cls, metadata: dict[str, str], origin: str) -> "Specification":
        """The specification in a metadata record of the file `origin`."""
        written = metadata.get("format")
        if written not in (FORMAT, OLDER):
            raise RecordingError(
                f"{origin} has recording format {written}, and this RESC reads formats {OLDER} and "
                f"{FORMAT}. Read it with the version that wrote it (metadata 'resc.run')."
            )
        metadata = unsealed(metadata, "resc.spec", origin)
        names = [name for name in _entries() if written == FORMAT or name not in _SINCE_FORMAT_4]
        values = {name: json.loads(metadata[name]) for name in names}
        values["columns"] = tuple(_column(**entry) for entry in values["columns"])
        values["outcomes"] = tuple(values["outcomes"])
        if written == OLDER:
            return cls(
                **values | {"earlier": None, "columns": _sampled(values["columns"])}, format=written
            )
        earlier = values["earlier"]
        values["earlier"] = None if earlier is None else tuple(earlier)
        return cls(**values)


def _entries() -> list[str]:
    """Names of what is JSON in the metadata record."""
    return [field.name for field in fields(Specification) if field.name != "format"]


def _entry(column: Column) -> dict[str, object]:
    entry = asdict(column)
    return {"key": entry["key"], "components": entry["components"], "dtype": column.dtype_name} | {
        name: entry[name] for name in ("unit", "frame", "shape")
    }


def _column(
    key: list[str], components: list[str], dtype: str, shape: list[int], **rest: str
) -> Column:
    return Column(tuple(key), tuple(components), dtype, shape=tuple(shape), **rest)


def _sampled(columns: Sequence[Column]) -> tuple[Column, ...]:
    """The columns of an older file as they are read: what was sampled follows what was flown."""
    found: list[Column] = []
    for column in columns:
        found += [column, SAMPLED_ACTION] if column == ACTION else [column]
    return tuple(found)


def chosen_columns(columns: Sequence[Column], fields: object) -> tuple[Column, ...]:
    """The columns whose dotted key is one of `fields`, or begins with one of them.

    Raises:
        ConfigError: A field is no column, or this is no list of names.
    """
    entries = fields if isinstance(fields, Sequence) and not isinstance(fields, str) else ()
    wanted = [name for name in entries if isinstance(name, str)]
    expected = "a non-empty list of names such as [state, action], or null for all"
    require(0 < len(wanted) == len(entries), "fields", fields, expected)
    names = [".".join(column.key) for column in columns]
    known = {".".join(c.key[: depth + 1]) for c in columns for depth in range(len(c.key))}
    for name in wanted:
        if name not in known:
            raise ConfigError(f"recorder.fields has no '{name}'.{nearest(name, known)}")
    chosen = tuple(f"{name}." for name in wanted)
    return tuple(c for c, name in zip(columns, names, strict=True) if f"{name}.".startswith(chosen))


def sealed(metadata: Mapping[str, str]) -> dict[str, str]:
    """Entries of a metadata record and their checksum, for which MCAP has no place."""
    return {**metadata, _SEAL: _checksum(metadata)}


def unsealed(metadata: Mapping[str, str], name: str, origin: str) -> dict[str, str]:
    """The entries without their checksum, which must be right, of the record `name` of a file."""
    entries = {key: value for key, value in metadata.items() if key != _SEAL}
    if metadata.get(_SEAL) != _checksum(entries):
        raise RecordingError(f"{origin}: the metadata '{name}' is damaged; copy the file again.")
    return entries


def _checksum(metadata: Mapping[str, str]) -> str:
    return f"{zlib.crc32(json.dumps(sorted(metadata.items())).encode()):08x}"
