"""Arms by chance."""

from random import Random

from plant.parameters import ArmParameters


def arm_by_chance(draw: Random, joints: int) -> ArmParameters:
    def column(low: float, high: float) -> tuple[float, ...]:
        return tuple(draw.uniform(low, high) for _ in range(joints))

    return ArmParameters(
        length_m=column(0.1, 0.5),
        mass_kg=column(0.3, 4.0),
        rotor_inertia_kgm2=column(0.0, 1.0),
        viscosity_Nms=column(0.0, 2.0),
        coulomb_Nm=column(0.0, 4.0),
        torque_constant_Nm_A=column(1.0, 10.0),
        brake_torque_Nm=column(10.0, 60.0),
    )
