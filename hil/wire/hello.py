"""How a client introduces itself, and what it may change later: validated, since anybody can connect."""

from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from hil.wire.identifier import OWN, refusal
from hil.wire.protocol import FAR_NS, ProtocolError

Identifier = Annotated[int, Field(ge=0, lt=OWN)]
LONGEST_LIST = 4096


class _Strict(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid")


class Filter(_Strict):
    """One acceptance filter of python-can."""

    can_id: Annotated[int, Field(ge=0, le=0xFFFFFFFF)]
    can_mask: Annotated[int, Field(ge=0, le=0xFFFFFFFF)]
    extended: bool | None = None


class Hello(_Strict):
    """name: of the client; role: whether time waits for it, or it controls the clock.

    start_ns: the instant at which its time begins (None: the bus's). wakes_on: identifiers that wake it (None: what
    filters and fd let pass). errors: whose error frames it gets. page: whether it wants a status page. bit_ns,
    data_bit_ns: what it takes the bus for (None: anything). depth, fifo, one_shot, discards: of its controller.
    """

    name: Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]*$")]
    role: Literal["timed", "observer", "control"]
    start_ns: Annotated[int, Field(ge=-FAR_NS, le=FAR_NS)] | None = None
    wakes_on: Annotated[list[Identifier], Field(max_length=LONGEST_LIST)] | None = None
    stores: Annotated[list[Identifier], Field(max_length=LONGEST_LIST)] = []
    filters: Annotated[list[Filter], Field(max_length=LONGEST_LIST)] | None = None
    fd: bool = False
    own: bool = False
    errors: Literal["none", "own", "all"] = "none"
    page: bool = False
    listen_only: bool = False
    bit_ns: Annotated[int, Field(gt=0)] | None = None
    data_bit_ns: Annotated[int, Field(gt=0)] | None = None
    depth: Annotated[int, Field(ge=1, le=LONGEST_LIST)] = 10
    fifo: bool = False
    one_shot: bool = False
    discards: bool = False


class Frame(_Strict):
    """A frame of a periodic task: identifier with flags, data in hexadecimal."""

    identifier: Identifier
    data: Annotated[str, Field(pattern=r"^([0-9A-Fa-f]{2}){0,64}$")]

    def checked(self, fd: bool) -> tuple[int, bytes]:
        """Return (identifier, data); ProtocolError for what is no frame."""
        data = bytes.fromhex(self.data)
        reason = refusal(self.identifier, len(data), fd)
        if reason:
            raise ProtocolError(reason)
        return self.identifier, data


class Periodic(_Strict):
    """A periodic task, by the client's own number for it."""

    task: int
    frames: Annotated[list[Frame], Field(min_length=1, max_length=LONGEST_LIST)]
    period_ns: Annotated[int, Field(ge=1_000, le=FAR_NS)]
    duration_ns: Annotated[int, Field(ge=0, le=FAR_NS)] | None = None


class Modified(_Strict):
    """New contents of a periodic task."""

    task: int
    frames: Annotated[list[Frame], Field(min_length=1, max_length=LONGEST_LIST)]


class Change(_Strict):
    """What a client changes of its controller; what is left out stays."""

    filters: Annotated[list[Filter], Field(max_length=LONGEST_LIST)] | None = None
    set_filters: bool = False
    listen_only: bool | None = None
    flush: bool = False
    periodic: Periodic | None = None
    modify: Modified | None = None
    stop: int | None = None


class Command(_Strict):
    """What a controlling client wants of the clock."""

    command: Literal["pause", "continue", "step", "pace", "status"]
    step_ns: Annotated[int, Field(gt=0, le=FAR_NS)] | None = None
    pace: Annotated[float, Field(gt=0, le=1e6)] | None = None


Model = TypeVar("Model", bound=BaseModel)


def check(model: type[Model], body: bytes) -> Model:
    """Return a message's JSON as a model; raise ProtocolError that names what is wrong in it."""
    try:
        return model.model_validate_json(body)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "body"
        given = "" if first["type"] in ("missing", "json_invalid") else f" = {str(first['input'])[:60]!r}"
        raise ProtocolError(f"{model.__name__}: {where}{given}: {first['msg']}") from None
