"""The explicit list of effects. Adding one is a file beside this one and its name here."""

from __future__ import annotations

from collections.abc import Mapping

from twin.effects import (
    backlash,
    constant_offset,
    coulomb_friction,
    dead_band,
    detent,
    disturbance_pulse,
    drive_saturation,
    encoder_eccentricity,
    end_stop,
    flexible_load,
    friction_asymmetry,
    friction_run_in,
    gravity,
    inertia,
    input_delay,
    joint_elasticity,
    load_change,
    load_dependent_friction,
    motor_lag,
    motor_sensor,
    payload,
    payload_gravity,
    periodic_disturbance,
    position_dependent_friction,
    presliding_friction,
    quadratic_drag,
    sensor_hold,
    spring,
    sticky_sector,
    stribeck_friction,
    supply_sag,
    thermal_fade,
    tooth_compliance,
    torque_ripple,
    unknown_angle,
    unknown_drag,
    unknown_gain,
    unknown_inertia,
    unknown_input,
    unknown_position,
    unknown_push,
    unknown_time,
    unknown_velocity,
    varying_inertia,
    viscous_asymmetry,
    viscous_friction,
)
from twin.effects.effect import Effect

#: Every effect by id. Drive laws apply in this order: supply sag, saturation, bend of the command, dead-band. Then
#: follows the motor's gain, at its temperature and angle.
EFFECTS: Mapping[str, Effect] = {
    page.EFFECT.id: page.EFFECT
    for page in (
        inertia,
        viscous_friction,
        supply_sag,
        drive_saturation,
        unknown_input,
        dead_band,
        thermal_fade,
        unknown_gain,
        unknown_push,
        backlash,
        tooth_compliance,
        payload,
        coulomb_friction,
        stribeck_friction,
        friction_asymmetry,
        friction_run_in,
        sticky_sector,
        position_dependent_friction,
        load_dependent_friction,
        presliding_friction,
        constant_offset,
        viscous_asymmetry,
        quadratic_drag,
        gravity,
        payload_gravity,
        spring,
        torque_ripple,
        detent,
        end_stop,
        joint_elasticity,
        motor_lag,
        input_delay,
        load_change,
        flexible_load,
        motor_sensor,
        sensor_hold,
        encoder_eccentricity,
        periodic_disturbance,
        disturbance_pulse,
        unknown_position,
        unknown_angle,
        unknown_velocity,
        unknown_drag,
        unknown_time,
        varying_inertia,
        unknown_inertia,
    )
}

#: What every model contains from the start.
BASE: tuple[str, ...] = ("inertia", "viscous_friction", "dead_band", "backlash")

#: What may be found missing.
CANDIDATES: tuple[str, ...] = tuple(e.id for e in EFFECTS.values() if e.screen is not None)

#: What happens at a moment of one recording: a twin that starts afresh starts after it.
ONCE: tuple[str, ...] = ("load_change", "disturbance_pulse", "unknown_time", "unknown_drag")

#: Shapes without a name, for what no candidate describes. Never among the candidates: they would fit anything.
UNKNOWN: tuple[str, ...] = tuple(i for i in EFFECTS if i.startswith("unknown_"))


def pages(effect: str) -> tuple[Effect, ...]:
    """The effect's page and those of what it cannot be without."""
    return (EFFECTS[effect], *(EFFECTS[i] for i in EFFECTS[effect].includes))
