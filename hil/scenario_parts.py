"""What scenarios are made of: numbers with their ranges, times, and tables that refuse what they do not know."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0, le=1e6)]
NonNegative = Annotated[float, Field(ge=0, le=1e4)]
Angle = Annotated[float, Field(ge=-100, le=100)]
Way = Annotated[float, Field(ge=-100, le=100)]
Share = Annotated[float, Field(ge=0, lt=1)]


def to_ns(seconds: float) -> int:
    """Return seconds as the nearest whole nanosecond."""
    return round(seconds * 1e9)


def _whole_ns(seconds: float) -> float:
    if abs(seconds * 1e9 - to_ns(seconds)) > 1e-3:
        raise ValueError("is not a whole number of nanoseconds")
    return seconds


Time = Annotated[float, Field(ge=0, le=3600), AfterValidator(_whole_ns)]
ShortTime = Annotated[float, Field(ge=0, le=1), AfterValidator(_whole_ns)]
MoveTime = Annotated[float, Field(ge=1e-3, le=3600)]
Duration = Annotated[float, Field(gt=0, le=3600), AfterValidator(_whole_ns)]
Period = Annotated[float, Field(gt=0, le=1), AfterValidator(_whole_ns)]


class Part(BaseModel):
    """Frozen, and refuses keys it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")
