"""A simulator of geared DC drives with concealed effects; it shares nothing with the model in `twin/`.

Winding, bridge, gear train and link in SI units: voltage and back-EMF instead of a gain, teeth that meet in a film of
grease instead of a spring and a damper, dry friction that holds by complementarity. Every 2 ms (or whenever the
stamps say) the drive takes a duty and the encoder on the link is read.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import numpy as np
from concealed import Concealed, Drawing, drawn, log_uniform, together
from numba import njit
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

STEP = 25e-6  # s, the longest internal one: forty to a period of teeth that ring at 1 kHz
NOISE_STEP = 1e-3  # s, each value of the noise is held so long
COPPER = 0.0039  # 1/K, how the winding's resistance rises

VOCABULARY: tuple[str, ...] = (
    "constant_offset", "coulomb_friction", "detent", "disturbance_pulse", "drive_saturation",
    "encoder_eccentricity", "end_stop", "flexible_load", "friction_asymmetry", "friction_run_in", "gravity",
    "input_delay", "joint_elasticity", "load_change", "load_dependent_friction", "motor_lag",
    "periodic_disturbance", "position_dependent_friction", "presliding_friction", "quadratic_drag", "spring",
    "sticky_sector", "stribeck_friction", "supply_sag", "thermal_fade", "torque_ripple", "viscous_asymmetry",
)  # fmt: skip
OUTSIDE: tuple[str, ...] = (
    "other_damaged_tooth",  # the gap is wider at one place of the output wheel
    "other_freewheel",  # the bridge opens within its dead-band, and no back-EMF brakes
    "other_friction_hump",  # friction in a band of speeds, as where a housing resonates
)

COMMAND_LAG, VOLTAGE_LAG, WINDING_LAG = 1.0, 2.0, 3.0  # where a first-order lag sits


class _Plant(NamedTuple):
    """All that the kernel reads. Torques, angles and inertias are seen at the link; 0 is "not there" for effects."""

    # ---- the rig ----
    supply: float  # V
    resistance: float  # ohm
    winding_time: float  # s
    constant: float  # N m/A and V s/rad
    motor_inertia: float
    link_inertia: float
    motor_viscous: float  # N m s/rad, without back-EMF
    link_viscous: float
    dead_band_forward: float  # %
    dead_band_reverse: float
    backlash_gap: float
    gap_start: float  # of the motor within the gap, -0.5 to 0.5
    mesh_stiffness: float
    mesh_damping: float
    mesh_film: float
    mesh_variation: float
    mesh_error: float
    teeth: float
    commutation: float
    commutator_order: float
    pwm_steps: float
    # ---- effects ----
    offset_motor: float = 0.0
    offset_link: float = 0.0
    dry_motor: float = 0.0
    dry_link: float = 0.0
    asymmetry_motor: float = 0.0
    asymmetry_link: float = 0.0
    stribeck_motor: float = 0.0
    stribeck_link: float = 0.0
    stribeck_speed: float = 0.0
    stribeck_exponent: float = 0.0
    turn_motor: float = 0.0
    turn_link: float = 0.0
    turn_phase: float = 0.0
    turn_second: float = 0.0
    efficiency_motor: float = 0.0
    efficiency_link: float = 0.0
    drag_motor: float = 0.0
    drag_link: float = 0.0
    gravity_torque: float = 0.0
    gravity_angle: float = 0.0
    spring_rate: float = 0.0
    spring_angle: float = 0.0
    ripple_motor: float = 0.0
    ripple_link: float = 0.0
    ripple_order: float = 0.0
    ripple_phase: float = 0.0
    ripple_second: float = 0.0
    stop_upper_stiffness: float = 0.0
    stop_upper_angle: float = 0.0
    stop_lower_stiffness: float = 0.0
    stop_lower_angle: float = 0.0
    stop_loss: float = 0.0
    joint_compliance: float = 0.0
    joint_damping: float = 0.0
    joint_hub: float = 0.0
    lag_time: float = 0.0
    lag_place: float = 0.0
    delay: float = 0.0
    clip: float = 0.0
    source_resistance: float = 0.0
    source_time: float = 0.0
    heating: float = 0.0
    cooling: float = 0.0
    heat_resistance: float = 0.0
    heat_flux: float = 0.0
    heat_drive: float = 0.0
    load_added: float = 0.0
    load_time: float = 0.0
    eccentricity: float = 0.0
    eccentricity_phase: float = 0.0
    outside_torque: float = 0.0
    outside_frequency: float = 0.0
    outside_phase: float = 0.0
    tooth_gap: float = 0.0
    tooth_angle: float = 0.0
    tooth_width: float = 0.0
    detent_torque: float = 0.0
    detent_angle: float = 0.0
    detent_width: float = 0.0
    bridge_open: float = 0.0
    hump_torque: float = 0.0
    hump_speed: float = 0.0
    hump_width: float = 0.0
    rider_inertia: float = 0.0
    rider_stiffness: float = 0.0
    rider_damping: float = 0.0
    bristle: float = 0.0
    bristle_travel: float = 1.0
    run_in: float = 0.0
    run_in_time: float = 1.0
    sector: float = 0.0
    sector_angle: float = 0.0
    sector_half: float = 0.0
    pulse: float = 0.0
    pulse_start: float = 0.0
    pulse_length: float = 0.0
    slant: float = 0.0


# What a first model has as a number: the name here, and how often its value it may at most become.
_OWN = {
    "supply": 10.0,
    "motor_constant": 10.0,
    "link_viscous": 50.0,
    "dead_band_forward": 3.0,
    "dead_band_reverse": 3.0,
    "backlash_gap": 5.0,
    "motor_inertia": 10.0,
}


@dataclass(frozen=True)
class Rig:
    """One drive: SI units; the motor's own are seen at its shaft, the mesh's at the link."""

    counts_per_revolution: int  # of the link
    encoder_phase: float  # of a count, where the disc stands at angle zero
    supply: float  # V
    resistance: float  # ohm
    inductance: float  # H
    motor_constant: float  # N m/A and V s/rad
    ratio: float  # motor turns per link turn
    motor_inertia: float  # kg m^2
    link_inertia: float  # kg m^2
    motor_viscous: float  # N m s/rad, without back-EMF
    link_viscous: float  # N m s/rad
    dead_band_forward: float  # %, what of each pulse the bridge's dead time eats
    dead_band_reverse: float  # %
    backlash_gap: float  # rad at the link, whole
    gap_start: float  # of the gap, from its middle: where the motor stands at the start
    mesh_stiffness: float  # N m/rad
    mesh_damping: float  # N m s/rad, once the grease is squeezed out
    mesh_film: float  # rad, over which that damping builds up
    mesh_variation: float  # of the stiffness, with the number of teeth in mesh
    mesh_error: float  # rad, kinematic, once per tooth
    teeth: float  # of the output wheel
    commutation: float  # of the torque: ripple from one commutator bar to the next
    commutator_bars: float
    pwm_steps: float  # that full duty is made of
    noise_density: float  # N m/sqrt(Hz) at the link, two-sided: velocity spreads by density^2 t / inertia^2
    noise_time: float  # s, over which the noise is correlated
    noise_at_motor: float  # of its power

    @property
    def inertia(self) -> float:
        """All of it at the link, kg m^2."""
        return self.ratio**2 * self.motor_inertia + self.link_inertia

    @property
    def _motor_damping(self) -> float:
        """Of the motor with its terminals shorted, at the link, N m s/rad."""
        return self.ratio**2 * (self.motor_viscous + self.motor_constant**2 / self.resistance)

    @property
    def _half_torque(self) -> float:
        """At the link, N m, at 50 % duty with the motor held; the mean of both directions."""
        lost = 0.5 * (self.dead_band_forward + self.dead_band_reverse)
        return self.ratio * self.motor_constant * self.supply / self.resistance * (50.0 - lost) / 100.0

    @property
    def half_torque(self) -> float:
        """Link acceleration (rad/s^2) that the drive gives at 50 % duty with the motor held."""
        return self._half_torque / self.inertia

    @property
    def half_speed(self) -> float:
        """Steady speed (rad/s) of the link at 50 % duty."""
        return self._half_torque / (self._motor_damping + self.link_viscous)

    @property
    def own(self) -> dict[str, tuple[float, float]]:
        """What a first model has as numbers, each with its largest value; `with_` takes them."""
        return {name: (getattr(self, name), most * getattr(self, name)) for name, most in _OWN.items()}

    def with_(self, **values: float) -> Rig:
        """The same rig with other values."""
        return replace(self, **values)  # type: ignore[arg-type]

    def truths(self) -> dict[str, float]:
        """All that was drawn with the rig, and what it amounts to in the first model's terms."""
        return {name: float(value) for name, value in asdict(self).items()} | self.model_values()

    def model_values(self) -> dict[str, float]:
        """The first model's numbers: rad/s^2 per %, 1/s, %, rad, Hz and ratios."""
        damping = self._motor_damping + self.link_viscous
        motor = self.ratio**2 * self.motor_inertia
        reduced = motor * self.link_inertia / self.inertia
        mesh = math.sqrt(self.mesh_stiffness / reduced)
        return {
            "input_gain": self.ratio * self.motor_constant * self.supply / (100.0 * self.resistance * self.inertia),
            "viscous_friction": damping / self.inertia,
            "dead_band_forward": self.dead_band_forward,
            "dead_band_reverse": self.dead_band_reverse,
            "backlash_gap": self.backlash_gap,
            "motor_share": motor / self.inertia,
            "friction_share": self._motor_damping / damping,
            "tooth_frequency": mesh / (2.0 * math.pi),
            "tooth_damping": self.mesh_damping / (2.0 * mesh * reduced),
        }


@dataclass(frozen=True, eq=False)
class Simulated:
    """One run, all (n,) at the stamps.

    `position` and `velocity` are the link's own. Angles in rad, speeds in rad/s, duty in %, current in A.
    """

    time: Array
    duty: Array
    counts: NDArray[np.int64]
    shown: Array  # by the encoder's disc before it is counted, rad
    position: Array
    velocity: Array
    motor_position: Array  # at its shaft
    current: Array
    counts_per_revolution: int


def draw_rig(rng: np.random.Generator) -> Rig:
    """A drive of a population between a small servo and a heavy arm."""
    rate, speed = 1.0 / log_uniform(rng, 0.15, 2.0), log_uniform(rng, 1.0, 15.0)  # 1/s; rad/s at 60 %
    forward, reverse = log_uniform(rng, 3.0, 9.0), log_uniform(rng, 3.0, 9.0)
    at_motor, by_emf = float(rng.uniform(0.4, 0.95)), float(rng.uniform(0.5, 0.95))
    ratio, emf = log_uniform(rng, 10.0, 200.0), at_motor * by_emf
    resistance = 0.0
    while not 0.3 < resistance < 30.0:  # or no such motor is made
        supply, inertia = log_uniform(rng, 6.0, 48.0), log_uniform(rng, 0.002, 1.0)
        damping = rate * inertia
        # The share of the damping that back-EMF makes fixes the motor constant, and the damping then the resistance.
        constant = emf * supply * (60.0 - 0.5 * (forward + reverse)) / 100.0 / (ratio * speed)
        resistance = (ratio * constant) ** 2 / (emf * damping)
    motor = inertia * log_uniform(rng, 0.1, 0.6)
    mesh, reduced = 2.0 * math.pi * log_uniform(rng, 80.0, 250.0), motor * (inertia - motor) / inertia
    half_torque = damping * speed * 50.0 / 60.0
    return Rig(
        counts_per_revolution=int(rng.choice([4096, 8192, 10000, 16384, 20000, 40000])),
        encoder_phase=float(rng.uniform()),
        supply=supply,
        resistance=resistance,
        inductance=resistance * log_uniform(rng, 30e-6, 120e-6),
        motor_constant=constant,
        ratio=ratio,
        motor_inertia=motor / ratio**2,
        link_inertia=inertia - motor,
        motor_viscous=at_motor * (1.0 - by_emf) * damping / ratio**2,
        link_viscous=(1.0 - at_motor) * damping,
        dead_band_forward=forward,
        dead_band_reverse=reverse,
        backlash_gap=math.radians(log_uniform(rng, 0.5, 5.0)),
        gap_start=float(rng.uniform(-0.5, 0.5)),
        mesh_stiffness=mesh**2 * reduced,
        mesh_damping=2.0 * float(rng.uniform(0.1, 0.4)) * mesh * reduced,
        mesh_film=float(rng.uniform(1.0, 5.0)) * half_torque / (mesh**2 * reduced),
        mesh_variation=float(rng.uniform(0.02, 0.15)),
        mesh_error=log_uniform(rng, 2e-6, 2e-5),
        teeth=float(rng.integers(30, 120)),
        commutation=log_uniform(rng, 5e-4, 4e-3),
        commutator_bars=float(rng.choice([5, 7, 9, 11, 13])),
        pwm_steps=float(rng.choice([4000, 4096, 7200, 10000])),
        noise_density=half_torque * log_uniform(rng, 3e-4, 3e-3),
        noise_time=log_uniform(rng, 2e-3, 2e-2),
        noise_at_motor=float(rng.uniform()),
    )


# ---- effects ----

Parameters = dict[str, float]


@dataclass(frozen=True)
class _Drawing(Drawing):
    turn: float  # an angle, rad
    sign: float

    @property
    def most(self) -> float:
        """The drive's torque (N m at the link) at 50 % duty."""
        return float(self.rig._half_torque)

    @property
    def torque(self) -> float:
        """That of the effect, N m at the link."""
        return self.size * self.most


def _sides(d: _Drawing, name: str, torque: float) -> Parameters:
    """A torque (N m at the link) shared at random between motor and link; often all of it acts at one."""
    at_motor = float(np.clip(d.rng.uniform(-0.3, 1.3), 0.0, 1.0))
    return {f"{name}_motor": at_motor * torque, f"{name}_link": (1.0 - at_motor) * torque}


def _in_dry(d: _Drawing, name: str) -> tuple[Parameters, Parameters]:
    """Dry friction that varies by the effect's torque in all, as torques named so, and the plain part of it."""
    # It is 1 to 3.3 times what varies, but no more than the drive can move.
    level = d.torque / d.between(min(max(0.3, d.torque / (0.35 * d.most)), 1.0), 1.0)
    varying = _sides(d, name, d.torque)
    scale = level / d.torque if d.torque > 0.0 else 0.0
    plain = {"dry_motor": scale * varying[f"{name}_motor"], "dry_link": scale * varying[f"{name}_link"]}
    return varying | plain, plain


def _friction_asymmetry(d: _Drawing) -> tuple[Parameters, Parameters]:
    values, plain = _in_dry(d, "asymmetry")
    return values | {name: d.sign * values[name] for name in ("asymmetry_motor", "asymmetry_link")}, plain


def _position_dependent_friction(d: _Drawing) -> tuple[Parameters, Parameters]:
    values, plain = _in_dry(d, "turn")
    return values | {"turn_phase": d.turn, "turn_second": d.between(0.0, 0.2)}, plain


def _stribeck_friction(d: _Drawing) -> tuple[Parameters, Parameters]:
    values, plain = _in_dry(d, "stribeck")
    speed = d.speed * d.log_uniform(0.03, 0.25)
    return values | {"stribeck_speed": speed, "stribeck_exponent": float(d.rng.integers(1, 3))}, plain


def _thermal_fade(d: _Drawing) -> Parameters:
    """Heating, by 200 K times the size until the end of a recording in which the drive works hard."""
    rig, kelvin = d.rig, 200.0 * d.size
    stall = rig.supply * 0.5 / rig.resistance
    emf = rig.motor_constant * rig.ratio * rig.half_speed / rig.resistance
    power = rig.resistance * ((stall - emf) ** 2 + 0.1 * stall**2)  # some reversals on top of steady running
    cooling = 1.0 / (d.duration * d.log_uniform(0.3, 3.0))
    heating = kelvin * cooling / (power * -math.expm1(-cooling * d.duration))
    if d.rng.uniform() < 0.3:  # the bridge folds back
        hot = {"heat_resistance": 0.0, "heat_flux": 0.0, "heat_drive": d.between(0.002, 0.005)}
    else:  # copper resists more, magnets weaken
        hot = {"heat_resistance": COPPER, "heat_flux": d.between(0.0005, 0.002), "heat_drive": 0.0}
    return {"heating": heating, "cooling": cooling} | hot


def _joint_elasticity(d: _Drawing) -> Parameters:
    """A shaft behind the output wheel; its compliance grows with the size: 3 Hz at 0.3."""
    rig = d.rig
    hub = d.between(0.1, 0.25) * rig.link_inertia
    near, far = rig.inertia - rig.link_inertia + hub, rig.link_inertia - hub
    reduced = near * far / (near + far)
    ratio = d.log_uniform(0.02, 0.1)
    softest = 1.0 / (reduced * (2.0 * math.pi * 3.0) ** 2)
    compliance = softest * d.size / 0.3
    damping = 2.0 * ratio * math.sqrt(reduced / compliance) if d.size > 0.0 else 0.0
    return {"joint_compliance": compliance, "joint_damping": damping, "joint_hub": hub}


def _end_stop(d: _Drawing) -> Parameters:
    """A stiff stop, the nearer the larger the size, above, below or both; none at size 0."""
    reach, side = d.speed * (0.3 / max(d.size, 1e-9)) ** 0.25, int(d.rng.integers(5))  # three of five have both
    upper, lower = (d.log_uniform(0.1, 0.8) * reach for _ in range(2))
    stiffness = d.rig.inertia * (2.0 * math.pi * d.log_uniform(5.0, 20.0)) ** 2 if d.size > 0.0 else 0.0
    bounce = d.between(0.2, 0.7)
    return {
        "stop_upper_stiffness": 0.0 if side == 1 else stiffness,
        "stop_upper_angle": upper,
        "stop_lower_stiffness": 0.0 if side == 2 else stiffness,
        "stop_lower_angle": -lower,
        "stop_loss": 1.5 * (1.0 - bounce) / d.speed,
    }


def _flexible_load(d: _Drawing) -> Parameters:
    """A liquid that the walls drag along, or something on a spring."""
    inertia = 2.0 * d.size * d.rig.inertia
    rate = 2.0 * math.pi * d.log_uniform(0.8, 8.0)
    if d.rng.random() < 0.3:
        return {"rider_inertia": inertia, "rider_damping": inertia * d.log_uniform(1.0, 6.0)}
    damping = 2.0 * d.log_uniform(0.03, 0.3) * rate * inertia
    return {"rider_inertia": inertia, "rider_stiffness": inertia * rate**2, "rider_damping": damping}


def _load_change(d: _Drawing) -> Parameters:
    added = d.rig.link_inertia * ((1.0 + 3.0 * d.size) ** d.sign - 1.0)
    return {"load_added": added, "load_time": d.duration * d.between(0.3, 0.7)}


def _load_dependent_friction(d: _Drawing) -> Parameters:
    # The torque that passes the teeth as the drive speeds up is the link's share of it.
    return _sides(d, "efficiency", d.size * d.rig.inertia / d.rig.link_inertia)


def _motor_lag(d: _Drawing) -> Parameters:
    return {"lag_time": 0.2 * d.size, "lag_place": float(d.rng.choice([COMMAND_LAG, VOLTAGE_LAG, WINDING_LAG]))}


def _torque_ripple(d: _Drawing) -> Parameters:
    sides = _sides(d, "ripple", d.torque)
    order, second = float(d.rng.integers(4, 25)), d.between(0.0, 0.3)
    return sides | {"ripple_order": order, "ripple_phase": d.turn, "ripple_second": second}


_EFFECTS: dict[str, Callable[[_Drawing], Parameters]] = {
    "constant_offset": lambda d: _sides(d, "offset", d.sign * d.torque),
    "coulomb_friction": lambda d: _sides(d, "dry", d.torque),
    "detent": lambda d: {
        "detent_torque": d.torque, "detent_angle": d.turn, "detent_width": math.radians(d.log_uniform(5.0, 20.0))},
    "disturbance_pulse": lambda d: {
        "pulse": d.sign * d.torque, "pulse_start": d.duration * d.between(0.1, 0.7),
        "pulse_length": d.duration * d.between(0.05, 0.2)},
    "drive_saturation": lambda d: {"clip": 40.0 * (0.3 / d.size) ** 0.4 if d.size > 0.0 else 0.0},
    "encoder_eccentricity": lambda d: {"eccentricity": 0.1 * d.size, "eccentricity_phase": d.turn},
    "end_stop": _end_stop,
    "flexible_load": _flexible_load,
    "friction_run_in": lambda d: {"run_in": d.torque, "run_in_time": d.duration * d.between(0.05, 0.3)},
    "gravity": lambda d: {"gravity_torque": d.torque, "gravity_angle": d.turn},
    "input_delay": lambda d: {"delay": 0.1 * d.size},
    "joint_elasticity": _joint_elasticity,
    "load_change": _load_change,
    "load_dependent_friction": _load_dependent_friction,
    "motor_lag": _motor_lag,
    "periodic_disturbance": lambda d: {
        "outside_torque": d.torque, "outside_frequency": d.log_uniform(0.3, 6.0), "outside_phase": d.turn},
    "presliding_friction": lambda d: {"bristle": d.torque, "bristle_travel": d.log_uniform(0.02, 0.08)},
    "quadratic_drag": lambda d: _sides(d, "drag", d.torque / d.speed**2),
    "spring": lambda d: {"spring_rate": d.torque / d.speed, "spring_angle": d.between(-0.2, 0.2) * d.speed},
    "sticky_sector": lambda d: {
        "sector": d.torque, "sector_angle": d.reach * d.between(-1.0, 1.0), "sector_half": d.between(0.15, 0.5)},
    "supply_sag": lambda d: {
        "source_resistance": d.size * d.rig.resistance, "source_time": d.log_uniform(1e-3, 5e-2)},
    "thermal_fade": _thermal_fade,
    "torque_ripple": _torque_ripple,
    "viscous_asymmetry": lambda d: {"slant": 1.5 * d.sign * d.torque / d.speed},
    "other_damaged_tooth": lambda d: {
        "tooth_gap": 0.4 * d.size, "tooth_angle": d.turn, "tooth_width": math.radians(d.log_uniform(5.0, 20.0))},
    "other_freewheel": lambda d: {"bridge_open": min(d.size / 0.3, 1.0)},
    "other_friction_hump": lambda d: {
        "hump_torque": d.torque, "hump_speed": d.speed * d.between(0.3, 0.8),
        "hump_width": d.speed * d.between(0.06, 0.15)},
}  # fmt: skip
# Parts of dry friction: their numbers with those of the plain friction, and the latter alone.
_IN_DRY_FRICTION: dict[str, Callable[[_Drawing], tuple[Parameters, Parameters]]] = {
    "friction_asymmetry": _friction_asymmetry,
    "position_dependent_friction": _position_dependent_friction,
    "stribeck_friction": _stribeck_friction,
}


def draw_effect(rng: np.random.Generator, id: str, rig: Rig, size: float, duration: float = 60.0) -> Concealed:
    """An effect of that size, all else about it at random.

    The size is its torque over that of the drive at 50 % duty. For effects without a torque, a size of 0.3 is a lag of
    60 ms, a delay of 30 ms, a coupling of 3 Hz or a clip at 40 % duty. It is 30 mrad of eccentricity, a link's inertia
    times or over 1.9, or 60 K. It is three tenths of the winding's resistance in the source. It is a gap that is 120
    mrad wider at the damaged tooth, or a bridge that opens wholly. A stop comes nearer as the
    size grows. `duration` (s) is of the recording.

    Raises ValueError for an id that is not known.
    """
    turn, sign = float(rng.uniform(-math.pi, math.pi)), float(rng.choice([-1.0, 1.0]))
    drawing = _Drawing(rng, rig, size, duration, turn, sign)
    return drawn(id, drawing, _EFFECTS, _IN_DRY_FRICTION, [*VOCABULARY, *OUTSIDE])


# ---- running it ----


@njit(cache=True)  # type: ignore[untyped-decorator]
def _bridge(duty: float, p: _Plant) -> float:
    """The share of the supply that is left of a duty (%): what dead time eats is lost, shorter pulses altogether."""
    if duty > p.dead_band_forward:
        return 0.01 * (duty - p.dead_band_forward)
    if duty < -p.dead_band_reverse:
        return 0.01 * (duty + p.dead_band_reverse)
    return 0.0


@njit(cache=True)  # type: ignore[untyped-decorator]
def _wrapped(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _mesh(motor: float, wheel: float, motor_speed: float, wheel_speed: float, p: _Plant) -> tuple[float, float]:
    """What the teeth (rad, rad/s) do: torque on the wheel, and what is taken from the motor, N m."""
    half, slope = 0.5 * p.backlash_gap, 0.0
    if p.tooth_gap > 0.0:
        off = _wrapped(wheel - p.tooth_angle) / p.tooth_width
        wider = 0.5 * p.tooth_gap * math.exp(-0.5 * off * off)
        half, slope = half + wider, -wider * off / p.tooth_width
    apart = motor - wheel
    if abs(apart) < half - 2.0 * p.mesh_error:
        return 0.0, 0.0
    phase = p.teeth * wheel
    wave = math.sin(phase)
    apart += p.mesh_error * wave
    side = 1.0 if apart > 0.0 else -1.0
    depth = side * apart - half
    if depth <= 0.0:
        return 0.0, 0.0
    lever = 1.0 - p.mesh_error * p.teeth * math.cos(phase) + side * slope  # virtual work: how the wheel moves the gap
    rate = side * (motor_speed - wheel_speed * lever)
    force = p.mesh_stiffness * (1.0 + p.mesh_variation * wave) * depth
    force += p.mesh_damping * min(depth / p.mesh_film, 1.0) * rate
    force = side * max(force, 0.0)  # teeth do not pull
    return force * lever, force


@njit(cache=True)  # type: ignore[untyped-decorator]
def _held(speed: float, change: float, limit: float) -> float:
    """The speed after a step with that change, where dry friction takes up to `limit` (rad/s): it never turns it."""
    free = speed + change
    if free > limit:
        return free - limit
    if free < -limit:
        return free + limit
    return 0.0


class _Dry(NamedTuple):
    """Dry friction of one body, N m."""

    level: float
    asymmetry: float
    stribeck: float
    turn: float
    efficiency: float  # of what passes the teeth


@njit(cache=True)  # type: ignore[untyped-decorator]
def _dry_torque(dry: _Dry, free: float, speed: float, angle: float, passed: float, p: _Plant) -> float:
    """The most that dry friction takes (N m) of a body that would go on at `free` (rad/s); teeth pass `passed`."""
    torque = dry.level + (dry.asymmetry if free > 0.0 else -dry.asymmetry) + dry.efficiency * abs(passed)
    if dry.stribeck > 0.0:
        torque += dry.stribeck * math.exp(-((abs(speed) / p.stribeck_speed) ** p.stribeck_exponent))
    if dry.turn > 0.0:
        wave = math.sin(angle + p.turn_phase) + p.turn_second * math.sin(2.0 * angle)
        torque += dry.turn * wave / (1.0 + p.turn_second)
    return max(torque, 0.0)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _link_dry(link: float, t: float, p: _Plant) -> _Dry:
    """That of the link at an angle (rad), `t` (s) into the recording."""
    level = p.dry_link + p.run_in * math.exp(-t / p.run_in_time)
    if abs(_wrapped(link - p.sector_angle)) < p.sector_half:
        level += p.sector
    return _Dry(level, p.asymmetry_link, p.stribeck_link, p.turn_link, p.efficiency_link)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _field(angle: float, speed: float, t: float, p: _Plant) -> float:
    """All torques (N m) on the link that its surroundings make, by angle (rad), speed (rad/s) and time (s)."""
    torque = p.offset_link - (p.drag_link * speed + p.slant) * abs(speed)
    if p.gravity_torque > 0.0:
        torque -= p.gravity_torque * math.sin(angle - p.gravity_angle)
    if p.spring_rate > 0.0:
        torque -= p.spring_rate * (angle - p.spring_angle)
    if p.outside_torque > 0.0:
        torque += p.outside_torque * math.sin(2.0 * math.pi * p.outside_frequency * t + p.outside_phase)
    if 0.0 <= t - p.pulse_start < p.pulse_length:
        torque += p.pulse
    if p.stop_upper_stiffness > 0.0 and angle > p.stop_upper_angle:
        push = p.stop_upper_stiffness * (angle - p.stop_upper_angle) * (1.0 + p.stop_loss * speed)
        torque -= max(push, 0.0)
    if p.stop_lower_stiffness > 0.0 and angle < p.stop_lower_angle:
        push = p.stop_lower_stiffness * (p.stop_lower_angle - angle) * (1.0 - p.stop_loss * speed)
        torque += max(push, 0.0)
    if p.detent_torque > 0.0:
        off = _wrapped(angle - p.detent_angle) / p.detent_width
        torque -= p.detent_torque * off * math.exp(0.5 - 0.5 * off * off)
    if p.hump_torque > 0.0:
        off = (abs(speed) - p.hump_speed) / p.hump_width
        # The factor fades it out towards rest, where friction that does not turn with speed would not be friction.
        torque -= p.hump_torque * math.exp(-0.5 * off * off) * math.tanh(speed / (0.2 * p.hump_speed))
    return torque


@njit(cache=True)  # type: ignore[untyped-decorator]
def _ripple(angle: float, p: _Plant) -> float:
    phase = p.ripple_order * angle + p.ripple_phase
    return math.sin(phase) + p.ripple_second * math.sin(2.0 * phase)


class _Step(NamedTuple):
    """How long a step is, s, and what share of a change each delay of first order lets pass within it."""

    length: float
    winding: float
    lag: float
    source: float


class _Electric(NamedTuple):
    """What the drive keeps from one step to the next."""

    filtered: float  # duty (%) or share of the supply, by where the lag sits
    bus: float  # V
    current: float  # A
    temperature: float  # K above the start


@njit(cache=True)  # type: ignore[untyped-decorator]
def _steps(span: float, p: _Plant) -> tuple[int, _Step]:
    """How many steps lie between two stamps that are `span` (s) apart, and what each is like."""
    steps = max(math.ceil(span / STEP - 1e-6), 1)
    h = span / steps
    winding_time = p.lag_time if p.lag_time > 0.0 and p.lag_place == WINDING_LAG else p.winding_time
    winding = 1.0 - math.exp(-h / winding_time)
    lag = 1.0 - math.exp(-h / p.lag_time) if p.lag_time > 0.0 else 0.0
    source = 1.0 - math.exp(-h / p.source_time) if p.source_resistance > 0.0 else 0.0
    return steps, _Step(h, winding, lag, source)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _drive(e: _Electric, duty: float, motor_speed: float, step: _Step, p: _Plant) -> tuple[_Electric, float]:
    """The drive after a step at a duty (%), and the torque (N m) of its current."""
    filtered, bus = e.filtered, e.bus
    # Duty: register, clip, command filter, dead time, output filter.
    asked = math.floor(duty * 0.01 * p.pwm_steps + 0.5) / (0.01 * p.pwm_steps)
    if p.clip > 0.0:
        asked = min(max(asked, -p.clip), p.clip)
    if step.lag > 0.0 and p.lag_place == COMMAND_LAG:
        filtered += step.lag * (asked - filtered)
        asked = filtered
    on = _bridge(asked, p)
    switching = on != 0.0
    if step.lag > 0.0 and p.lag_place == VOLTAGE_LAG:
        filtered += step.lag * (on - filtered)
        on = filtered
    # Current.
    resistance = p.resistance * (1.0 + p.heat_resistance * e.temperature)
    constant = p.constant * (1.0 - p.heat_flux * e.temperature)
    if p.source_resistance > 0.0:
        bus += step.source * (p.supply - p.source_resistance * on * e.current - bus)
    emf = constant * motor_speed
    if p.bridge_open > 0.0 and not switching:
        emf *= 1.0 - p.bridge_open
    voltage = on * bus * (1.0 - p.heat_drive * e.temperature)
    current = e.current + step.winding * ((voltage - emf) / resistance - e.current)
    temperature = e.temperature
    if p.heating > 0.0:
        temperature += step.length * (p.heating * resistance * current * current - p.cooling * temperature)
    return _Electric(filtered, bus, current, temperature), constant * current


@njit(cache=True)  # type: ignore[untyped-decorator]
def _bristle(bend: float, motor_speed: float, h: float, p: _Plant) -> tuple[float, float]:
    """The bend (of the travel) after a step of h (s), and the torque (N m) that it takes of the motor."""
    # An implicit step: the bend that the speed at its end would leave.
    bend = (bend + h * motor_speed / p.bristle_travel) / (1.0 + h * abs(motor_speed) / p.bristle_travel)
    stiff = p.bristle / p.bristle_travel
    rate = motor_speed - abs(motor_speed) * bend
    return bend, p.bristle * bend + 0.5 * math.sqrt(stiff * p.motor_inertia) * rate


@njit(cache=True)  # type: ignore[untyped-decorator]
def _run(time: Array, duty: Array, motor_noise: Array, link_noise: Array, p: _Plant) -> Array:
    """Link angle, its speed, motor angle (at the link) and current at the stamps, (n, 4)."""
    n = time.size
    out = np.zeros((n, 4))
    motor, wheel, link = p.gap_start * p.backlash_gap, 0.0, 0.0
    motor_speed = wheel_speed = link_speed = rider = rider_speed = bend = 0.0
    electric = _Electric(0.0, p.supply, 0.0, 0.0)
    motor_dry = _Dry(p.dry_motor, p.asymmetry_motor, p.stribeck_motor, p.turn_motor, p.efficiency_motor)
    flexible = p.joint_compliance > 0.0
    due = -1  # the stamp whose duty has arrived at the drive
    for k in range(n):
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = link, link_speed, motor, electric.current
        if k == n - 1:
            break
        steps, step = _steps(time[k + 1] - time[k], p)
        h = step.length
        for j in range(steps):
            t = time[k] + j * h
            while due + 1 < n and time[due + 1] + p.delay <= t + 1e-9:
                due += 1
            electric, torque = _drive(electric, duty[due] if due >= 0 else 0.0, motor_speed, step, p)
            # Torques.
            at = min(int((t - time[0]) / NOISE_STEP), motor_noise.size - 1)
            on_wheel, from_motor = _mesh(motor, wheel, motor_speed, wheel_speed, p)
            ripple = _ripple(wheel, p) if p.ripple_motor > 0.0 or p.ripple_link > 0.0 else 0.0
            drive = torque * (1.0 + p.commutation * math.sin(p.commutator_order * motor))
            drive += p.offset_motor + motor_noise[at] - from_motor + p.ripple_motor * ripple
            drive -= (p.motor_viscous + p.drag_motor * abs(motor_speed)) * motor_speed
            load = _field(link, link_speed, t, p) + link_noise[at] - p.link_viscous * link_speed
            load += p.ripple_link * ripple
            if p.rider_inertia > 0.0:
                drawn = p.rider_stiffness * (link - rider) + p.rider_damping * (link_speed - rider_speed)
                load -= drawn
                rider_speed += h * drawn / p.rider_inertia
                rider += h * rider_speed
            if p.bristle > 0.0:
                bend, taken = _bristle(bend, motor_speed, h, p)
                drive -= taken
            inertia = p.link_inertia + (p.load_added if t >= p.load_time else 0.0)
            if flexible:
                twist = (wheel - link) / p.joint_compliance + p.joint_damping * (wheel_speed - link_speed)
                load += twist
                inertia -= p.joint_hub
                wheel_speed += h * (on_wheel - twist) / p.joint_hub
            else:
                load += on_wheel
            # Speeds, then angles: dry friction takes what it needs to hold, at most what it has.
            change = h * drive / p.motor_inertia
            held = _dry_torque(motor_dry, motor_speed + change, motor_speed, wheel, from_motor, p)
            motor_speed = _held(motor_speed, change, h * held / p.motor_inertia)
            change = h * load / inertia
            held = _dry_torque(_link_dry(link, t - time[0], p), link_speed + change, link_speed, link, from_motor, p)
            link_speed = _held(link_speed, change, h * held / inertia)
            motor += h * motor_speed
            link += h * link_speed
            if flexible:
                wheel += h * wheel_speed
            else:
                wheel, wheel_speed = link, link_speed
    return out


def _noise(rig: Rig, span: float, seed: int) -> tuple[Array, Array]:
    """Torques (N m at the link) on motor and link, one value per `NOISE_STEP`."""
    n = math.ceil(span / NOISE_STEP) + 1
    keep = math.exp(-NOISE_STEP / rig.noise_time)
    # White noise through a filter of gain one at standstill: the density at low frequency is as drawn.
    white = np.random.default_rng(seed).standard_normal((2, n)) * (rig.noise_density / math.sqrt(NOISE_STEP))
    coloured = lfilter([1.0 - keep], [1.0, -keep], white, axis=1)
    return math.sqrt(rig.noise_at_motor) * coloured[0], math.sqrt(1.0 - rig.noise_at_motor) * coloured[1]


def _plant(rig: Rig, effects: Sequence[Concealed]) -> _Plant:
    values = together(effects, (*VOCABULARY, *OUTSIDE))
    at_link = {
        "winding_time": rig.inductance / rig.resistance,
        "constant": rig.ratio * rig.motor_constant,
        "motor_inertia": rig.ratio**2 * rig.motor_inertia,
        "motor_viscous": rig.ratio**2 * rig.motor_viscous,
        "commutator_order": rig.ratio * rig.commutator_bars,
    }
    as_it_is = {name: value for name, value in asdict(rig).items() if name in _Plant._fields}
    return _Plant(**(as_it_is | at_link | values))


def simulate(rig: Rig, effects: Sequence[Concealed], time: Array, duty: Array, seed: int | None) -> Simulated:
    """The rig from rest with these effects: stamps (n,) in s, duty (n,) in %, held from each stamp to the next.

    `seed` draws the process noise and nothing else; None is none. Raises ValueError for an effect that is not known or
    there twice.
    """
    plant = _plant(rig, effects)
    time, duty = np.ascontiguousarray(time, dtype=float), np.ascontiguousarray(duty, dtype=float)
    quiet = np.zeros(1), np.zeros(1)
    motor_noise, link_noise = quiet if seed is None else _noise(rig, time[-1] - time[0], seed)
    link, velocity, motor, current = _run(time, duty, motor_noise, link_noise, plant).T.copy()
    shown = link + plant.eccentricity * np.sin(link + plant.eccentricity_phase)
    counts = np.floor(shown * rig.counts_per_revolution / (2.0 * math.pi) + rig.encoder_phase).astype(np.int64)
    return Simulated(time, duty, counts, shown, link, velocity, motor * rig.ratio, current, rig.counts_per_revolution)
