"""What a scenario puts around the arm: walls, a box, payloads that lie there.

Units: m, kg, N/m, N s/m, s; x horizontal, y up, the arm's base is the origin.
"""

from typing import Annotated

from pydantic import Field

from hil.scenario_parts import NonNegative, Part, Positive, Time, Way

Size = Annotated[float, Field(ge=1e-3, le=10)]
Friction = Annotated[float, Field(ge=0, le=10)]
Stiffness = Annotated[float, Field(gt=0, le=1e7)]
SlidingSpeed = Annotated[float, Field(ge=1e-5, le=1)]


class Wall(Part):
    """A flat compliant surface without end, solid behind point_m: the normal (of any length) leaves it."""

    point_m: tuple[Way, Way]
    normal: tuple[Way, Way]
    stiffness_N_m: Stiffness
    damping_N_s_m: NonNegative
    friction: Friction = 0.0
    """Against the tip."""
    sliding_speed_m_s: SlidingSpeed = 1e-3
    """Below it the tip's friction is proportional to its slip."""


class Box(Part):
    """A rectangle, upright at the beginning, that the tip can push along a wall."""

    position_m: tuple[Way, Way]
    """Of its centre."""
    size_m: tuple[Size, Size]
    """Width and height."""
    mass_kg: Positive
    friction: Friction
    """Against walls."""
    stiffness_N_m: Stiffness
    damping_N_s_m: NonNegative
    tip_friction: Friction = 0.0
    sliding_speed_m_s: SlidingSpeed = 1e-3
    """As a wall's."""


class Grasp(Part):
    """A square payload that lies in the world until the hand, there at at_s, takes it, and falls when it opens."""

    mass_kg: Positive
    position_m: tuple[Way, Way]
    """Of its centre, where it lies."""
    size_m: Size = 0.04
    friction: Friction = 0.5
    """Against walls."""
    at_s: Time
    until_s: Time
