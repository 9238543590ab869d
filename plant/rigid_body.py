"""The arm's rigid-body dynamics as functions, with one arm and one payload bound in.

Units: q rad, w rad/s, q" rad/s^2, torque N m; tuples of n floats. Ref: eq. (1) without c and r.
The texts come from `closed_form` and `rk4`. The torque that goes in is that of motor, Coulomb friction and outside;
viscosity D w is inside.
"""

from collections.abc import Callable
from functools import cache
from math import cos, sin
from typing import Any

from plant.closed_form import acceleration_text, balance_text, constants, inverse_dynamics_text, terms_text, touch_text
from plant.compiled import machine_code
from plant.contact import Surface
from plant.parameters import ArmParameters, Vector
from plant.rk4 import glide_text, step_text

Joints = tuple[int, ...]
"""Joints, numbered from 1, in order."""
Terms = tuple[tuple[Vector, ...], Vector, Vector]
Step = Callable[[float, Vector, Vector, Vector, Vector, Vector, Vector, tuple[int, ...]], tuple[Vector, Vector, bool]]
Glide = Callable[[list[float], Vector, Vector, Vector, tuple[int, ...]], tuple[int, Vector, Vector, Vector]]
Balance = Callable[[Vector, Vector, Vector, Vector], tuple[Vector, Vector]]
Surfaces = tuple[Surface, ...]
TouchingStep = Callable[
    [float, Vector, Vector, Vector, Vector, Vector, Vector, tuple[int, ...], Surfaces], tuple[Vector, Vector, bool]
]
TouchingBalance = Callable[[Vector, Vector, Vector, Vector, Surfaces], tuple[Vector, Vector]]
Touched = Callable[[Vector, Vector, Surfaces], tuple[Vector, tuple[tuple[float, float, float], ...]]]


class RigidBody:
    """Dynamics of an arm that holds the point mass payload_kg at its tip; ValueError if negative or not finite.

    compiled: `glide` is machine code where Numba is installed; the bits are the same.
    """

    terms: Callable[[Vector, Vector], Terms]
    """(q, w) -> M (n x n, rotors included), h, g."""
    inverse_dynamics: Callable[[Vector, Vector, Vector], Vector]
    """(q, w, q") -> M q" + h + g + D w."""

    def __init__(self, parameters: ArmParameters, payload_kg: float = 0.0, compiled: bool = False) -> None:
        self.parameters = parameters
        self.payload_kg = payload_kg
        self._compiled = compiled
        self._n = parameters.joints
        self._values = constants(parameters, payload_kg) | _drive_constants(parameters)
        self._ripple = any(parameters.ripple)
        self._accelerations: dict[Joints, Callable[[Vector, Vector, Vector], Vector]] = {}
        self._balances: dict[Joints, Balance] = {}
        self._steps: dict[tuple[Joints, Joints], Step] = {}
        self._glides: dict[Joints, Glide] = {}
        self._touching: dict[str, Any] = {}
        self.terms = self._bind("terms", terms_text(self._n))
        self.inverse_dynamics = self._bind("inverse_dynamics", inverse_dynamics_text(self._n))
        self.all_joints = tuple(range(1, self._n + 1))

    def acceleration(self, q: Vector, w: Vector, torque: Vector, free: Joints | None = None) -> Vector:
        """Return q" of the free joints (numbered from 1, None: all), 0.0 for those that stand."""
        free = self.all_joints if free is None else free
        if free not in self._accelerations:
            self._accelerations[free] = self._bind("acceleration", acceleration_text(self._n, free))
        return self._accelerations[free](q, w, torque)

    def balance(self, free: Joints) -> Balance:
        """Return (q, w, current, e) -> (q", what holds the joints that are not free), e as in `rk4`."""
        if free not in self._balances:
            self._balances[free] = self._bind("balance", balance_text(self._n, free, self._ripple))
        return self._balances[free]

    def step(self, free: Joints, watched: Joints) -> Step:
        """Return the Runge-Kutta step for these free joints, watching these for standstill: see `rk4.step_text`."""
        key = (free, watched)
        if key not in self._steps:
            self._steps[key] = self._bind("step", step_text(self._n, free, watched, self._ripple))
        return self._steps[key]

    def glide(self, watched: Joints) -> Glide:
        """Return many Runge-Kutta steps in one call, for all joints sliding and constant currents: `rk4.glide_text`."""
        if watched not in self._glides:
            text = glide_text(self._n, watched, self._ripple)
            with_constants = _with_constants(text, tuple(self._values))
            code = machine_code("glide", with_constants, self._values.values()) if self._compiled else None
            self._glides[watched] = self._bind("glide", text) if code is None else code
        return self._glides[watched]

    def touching_step(self, free: Joints, watched: Joints, surfaces: int) -> TouchingStep:
        """Return the Runge-Kutta step with that many surfaces near the tip, a further argument."""
        function: TouchingStep = self._bind_near("step", step_text(self._n, free, watched, self._ripple, surfaces))
        return function

    def touching_balance(self, free: Joints, surfaces: int) -> TouchingBalance:
        """Return `balance` with that many surfaces near the tip, a further argument."""
        function: TouchingBalance = self._bind_near("balance", balance_text(self._n, free, self._ripple, surfaces))
        return function

    def touch(self, surfaces: int) -> Touched:
        """Return (q, w, surfaces) -> (joint torques of the contact, (depth, F_n, F_t) of each): `contact`."""
        function: Touched = self._bind_near("touch", touch_text(self._n, surfaces))
        return function

    def _bind_near(self, name: str, text: str) -> Any:
        """Bind in the links' lengths too, which only contact needs."""
        if text not in self._touching:
            lengths = {f"l{i}": length for i, length in enumerate(self.parameters.length_m, start=1)}
            values = self._values | lengths
            self._touching[text] = _maker(name, text, tuple(values))(*values.values())
        return self._touching[text]

    def _bind(self, name: str, text: str) -> Any:
        return _maker(name, text, tuple(self._values))(*self._values.values())


def _drive_constants(parameters: ArmParameters) -> dict[str, float]:
    columns = {"K": parameters.torque_constant_Nm_A, "E": parameters.ripple, "O": parameters.ripple_order}
    return {f"{name}{i}": value for name, column in columns.items() for i, value in enumerate(column, start=1)}


def _with_constants(text: str, symbols: tuple[str, ...]) -> str:
    """Return the text of the same function with the values of the symbols as a further argument."""
    signature, body = text.split("\n", 1)
    unpacked = "\n".join(f"    {symbol} = constants[{place}]" for place, symbol in enumerate(symbols))
    return f"{signature.removesuffix('):')}, constants):\n{unpacked}\n{body}"


@cache
def _maker(name: str, text: str, symbols: tuple[str, ...]) -> Callable[..., Any]:
    """Compile the text once; what is returned binds the symbols to values (closures are as fast as locals)."""
    body = "\n".join("    " + line for line in [*text.splitlines(), f"return {name}"])
    namespace: dict[str, Any] = {"sin": sin, "cos": cos}
    exec(compile(f"def make({', '.join(symbols)}):\n{body}\n", f"<plant {name}>", "exec"), namespace)
    make: Callable[..., Any] = namespace["make"]
    return make
