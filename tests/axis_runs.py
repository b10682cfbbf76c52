"""Small runs of the axis that several tests share: sane sizes of every parameter, and one recording's worth."""

from __future__ import annotations

import numpy as np

from twin.effects import knots, unknown_gain, varying_inertia, waves
from twin.effects.catalogue import EFFECTS, UNKNOWN
from twin.model.stepper import Structure
from twin.simulation import kernel

#: Sizes that a small geared axis may have (duty in percent, angles in rad).
SANE: dict[str, tuple[float, float]] = {
    "input_gain": (0.15, 0.6),
    "viscous_friction": (0.5, 6.7),
    "fade": (0.1, 0.3),
    "fade_emf": (0.3, 1.0),
    "fade_time": (5.0, 60.0),
    "fade_reference": (50.0, 50.0),
    "supply_sag": (0.002, 0.006),
    "sag_switched": (0.0, 1.0),
    "sag_emf": (0.3, 1.0),
    "sag_reference": (60.0, 100.0),
    "saturation_limit": (30.0, 60.0),
    "dead_band_forward": (3.0, 9.0),
    "dead_band_reverse": (3.0, 9.0),
    "backlash_gap": (0.009, 0.087),
    "motor_share": (0.1, 0.4),
    "friction_share": (0.3, 0.9),
    "dry_share": (0.1, 0.9),
    "shaft_share": (0.1, 0.9),
    "refresh": (0.01, 0.04),
    "own_inertia": (0.008, 0.02),
    "coulomb_friction": (0.6, 4.0),
    "stribeck_friction": (0.3, 2.0),
    "stribeck_velocity": (0.1, 0.6),
    "friction_asymmetry": (-0.3, 0.3),
    "run_in_friction": (0.3, 2.0),
    "run_in_time": (0.3, 5.0),
    "sector_friction": (0.3, 2.0),
    "sector_angle": (-0.3, 0.3),
    "sector_width": (0.1, 0.5),
    "sector_order": (1.0, 1.0),
    "friction_variation": (0.1, 0.3),
    "friction_angle": (-3.0, 3.0),
    "load_friction": (0.05, 0.3),
    "offset": (-2.0, 2.0),
    "viscous_asymmetry": (-0.4, 0.4),
    "quadratic_drag": (0.02, 0.1),
    "gravity_gain": (1.0, 30.0),
    "gravity_angle": (-3.0, 3.0),
    "payload_angle": (-3.0, 3.0),
    "spring_stiffness": (1.0, 40.0),
    "spring_rest": (-0.5, 0.5),
    "ripple_torque": (0.5, 4.0),
    "ripple_order": (4.0, 40.0),
    "ripple_phase": (-3.0, 3.0),
    "detent_torque": (0.5, 4.0),
    "detent_angle": (-0.3, 0.3),
    "detent_width": (0.1, 0.4),
    "detent_order": (1.0, 3.0),
    "stop_stiffness": (2e3, 8e3),
    "stop_damping": (5.0, 50.0),
    "stop_hysteresis": (0.1, 1.0),
    "stop_upper": (0.1, 0.4),
    "stop_lower": (-0.4, -0.1),
    "tooth_frequency": (60.0, 200.0),
    "tooth_damping": (0.1, 0.5),
    "joint_frequency": (4.0, 25.0),
    "joint_damping": (0.05, 0.3),
    "lag_time": (0.004, 0.05),
    "lag_dead_band": (0.1, 0.9),
    "delay": (0.001, 0.02),
    "load_added": (0.2, 2.0),
    "load_time": (0.3, 0.7),
    "eccentricity": (0.01, 0.05),
    "eccentricity_angle": (-3.0, 3.0),
    "disturbance": (0.5, 5.0),
    "disturbance_frequency": (0.5, 20.0),
    "disturbance_phase": (-3.0, 3.0),
    "pulse_torque": (0.5, 4.0),
    "pulse_start": (0.05, 0.1),
    "pulse_length": (0.1, 0.3),
    "pulse_edge": (0.02, 0.02),
    **{p.name: (-1.0, 1.0) for i in UNKNOWN for p in EFFECTS[i].parameters},
    "unknown_position_from": (-1.0, -0.5),
    **dict.fromkeys(knots.widths("unknown_position"), (0.045, 0.27)),
    "unknown_velocity_from": (-3.0, -2.0),
    "presliding_friction": (0.5, 3.0),
    "presliding_travel": (0.02, 0.1),
    "flexible_load_share": (0.1, 1.0),
    "flexible_load_stiffness": (0.0, 400.0),
    "flexible_load_damping": (0.1, 5.0),
    **dict.fromkeys(knots.widths("unknown_velocity"), (0.18, 0.82)),
    "unknown_input_from": (-60.0, -40.0),
    **dict.fromkeys(knots.widths("unknown_input"), (3.6, 16.0)),
    "unknown_time_from": (-0.2, 0.0),
    **dict.fromkeys(knots.widths("unknown_time"), (0.014, 0.14)),
    "unknown_drag_from": (-0.2, 0.0),
    **dict.fromkeys(knots.widths("unknown_drag"), (0.014, 0.14)),
    "unknown_angle_order": (0.5, 4.0),
    **dict.fromkeys(waves.names("unknown_gain", unknown_gain.HARMONICS), (-0.04, 0.04)),
    "unknown_gain_order": (0.5, 4.0),
    "unknown_push_order": (0.5, 4.0),
    **dict.fromkeys(waves.names("unknown_inertia", varying_inertia.HARMONICS), (-0.04, 0.04)),
    "unknown_inertia_order": (0.5, 2.0),
}

PAYLOAD = {"payload": 0.004, "moment": 0.02}


def sane(structure: Structure, rng: np.random.Generator) -> dict[str, float]:
    """Random parameters of a structure, each of a size that one meets."""
    return {p.name: float(rng.uniform(*SANE[p.name])) for p in structure.parameters}


def steps(rng: np.random.Generator, count: int, hold: int = 100, top: float = 60.0) -> np.ndarray:
    """A command that is redrawn every `hold` samples; every third is zero."""
    levels = rng.uniform(-top, top, count // hold + 1)
    levels[rng.random(len(levels)) < 0.3] = 0.0
    return np.repeat(levels, hold)[:count]


def drive(
    time: np.ndarray,
    command: np.ndarray,
    longest: float = 0.002,
    known: dict[str, float] | None = None,
    speed: bool = False,
) -> kernel.Drive:
    return kernel.Drive(
        np.asarray(time, float),
        np.asarray(command, float),
        np.full(len(time), np.nan),
        speed,
        kernel.known_vector(PAYLOAD if known is None else known),
        np.zeros(5),
        longest,
    )


def run(
    structure: Structure,
    values: dict[str, float],
    time: np.ndarray,
    command: np.ndarray,
    start: np.ndarray | None = None,
    longest: float | None = None,
    known: dict[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Reading (N,) and states (N, states) of a free run; at rest in mid-gap unless `start` says otherwise."""
    step = 0.002 / structure.substeps if longest is None else longest
    x = kernel.start_state(0.0, 0.0, 0.0) if start is None else start
    recording = drive(time, command, step, known)
    run = kernel.predict(recording, kernel.vector(structure, values), x, keep_states=True)
    return run.reading, run.states
