"""A simulator of rigs as textbooks write one, with concealed effects; it shares nothing with the model in `twin/`.

Two inertias, a spring and a damper beyond a gap, friction as a steep hyperbolic tangent, fixed steps of semi-implicit
Euler. Nothing ever sticks, and teeth may pull for a moment as they part. The inertia of motor and link together is 1,
so that torques are accelerations; angles in rad, duty in %, time in s.
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

Array = NDArray[np.float64]

STEP = 1e-4  # s; half a period of the hardest teeth are twenty
NOISE_STEP = 2e-3  # s, each value of the noise is held so long
SETTLE = 0.5  # s at zero duty before the recording
EMF = 0.6  # share of the motor's damping that is back-EMF and so unloads the supply

VOCABULARY: tuple[str, ...] = (
    "constant_offset", "coulomb_friction", "detent", "disturbance_pulse", "drive_saturation",
    "encoder_eccentricity", "end_stop", "flexible_load", "friction_asymmetry", "friction_run_in", "gravity",
    "input_delay", "joint_elasticity", "load_change", "load_dependent_friction", "motor_lag",
    "periodic_disturbance", "position_dependent_friction", "presliding_friction", "quadratic_drag", "spring",
    "sticky_sector", "stribeck_friction", "supply_sag", "thermal_fade", "torque_ripple", "viscous_asymmetry",
)  # fmt: skip
OUTSIDE: tuple[str, ...] = (
    "other_bump",  # a torque at one place of the travel
    "other_cubic_drag",
    "other_gain_asymmetry",  # the drive pulls harder one way
)


class _Plant(NamedTuple):
    """All that the kernel reads; 0 is "not there" for effects."""

    input_gain: float
    motor_viscous: float
    link_viscous: float
    dead_band_forward: float
    dead_band_reverse: float
    gap: float
    motor_share: float
    mesh_stiffness: float
    mesh_damping: float
    noise: float
    dry_share: float
    edge: float
    offset: float = 0.0
    coulomb: float = 0.0
    dry_forward: float = 0.0
    dry_reverse: float = 0.0
    stribeck: float = 0.0
    stribeck_speed: float = 1.0
    dry_wave: float = 0.0
    dry_wave_phase: float = 0.0
    dry_load: float = 0.0
    clip: float = math.inf
    eccentricity: float = 0.0
    eccentricity_phase: float = 0.0
    stop_upper: float = math.inf
    stop_lower: float = -math.inf
    stop_stiffness: float = 0.0
    stop_damping: float = 0.0
    gravity: float = 0.0
    gravity_phase: float = 0.0
    delay: float = 0.0
    joint_stiffness: float = 0.0
    joint_damping: float = 0.0
    load_time: float = math.inf
    load_factor: float = 1.0
    lag: float = 0.0
    shake: float = 0.0
    shake_frequency: float = 0.0
    shake_phase: float = 0.0
    drag: float = 0.0
    spring: float = 0.0
    spring_rest: float = 0.0
    sag: float = 0.0
    fade: float = 0.0
    fade_time: float = 1.0
    ripple: float = 0.0
    ripple_order: float = 0.0
    ripple_phase: float = 0.0
    bump: float = 0.0
    bump_angle: float = 0.0
    bump_width: float = 1.0
    cubic: float = 0.0
    gain_asymmetry: float = 0.0
    viscous_asymmetry: float = 0.0
    run_in: float = 0.0
    run_in_time: float = 1.0
    sector: float = 0.0
    sector_angle: float = 0.0
    sector_half: float = 0.0
    pulse: float = 0.0
    pulse_start: float = 0.0
    pulse_length: float = 0.0
    detent: float = 0.0
    detent_angle: float = 0.0
    detent_width: float = 1.0
    bristle: float = 0.0
    bristle_travel: float = 1.0
    rider_share: float = 0.0
    rider_rate: float = 0.0
    rider_damping: float = 0.0


@dataclass(frozen=True)
class Rig:
    """The truth about one rig."""

    input_gain: float  # rad/s^2 per %
    motor_viscous: float  # 1/s
    link_viscous: float
    dead_band_forward: float  # %
    dead_band_reverse: float
    gap: float  # rad, whole
    motor_share: float  # of the inertia
    mesh_stiffness: float  # 1/s^2
    mesh_damping: float  # 1/s
    noise: float  # rad/s^2 on motor and link each, RMS of what is held for 2 ms
    dry_share: float  # of dry friction that acts on the motor
    edge: float  # rad/s within which friction turns with the motion
    counts_per_revolution: int
    encoder_phase: float  # of a count

    @property
    def half_torque(self) -> float:
        """Acceleration (rad/s^2) at 50 % duty from rest: the scale of every effect's size."""
        return self.input_gain * (50.0 - 0.5 * (self.dead_band_forward + self.dead_band_reverse))

    @property
    def half_speed(self) -> float:
        """Steady speed (rad/s) at 50 % duty."""
        return self.half_torque / (self.motor_viscous + self.link_viscous)

    @property
    def own(self) -> dict[str, tuple[float, float]]:
        """What a first model has numbers for: the value, and the largest that it may be."""
        names = ["input_gain", "motor_viscous", "link_viscous", "dead_band_forward", "dead_band_reverse", "gap"]
        return {n: (getattr(self, n), math.inf) for n in names} | {"motor_share": (self.motor_share, 0.98)}

    def with_(self, **values: float) -> Rig:
        """The same rig with other values."""
        return replace(self, **values)  # type: ignore[arg-type]

    def truths(self) -> dict[str, float]:
        """All that was drawn with the rig."""
        return {name: float(value) for name, value in asdict(self).items()}

    def model_values(self) -> dict[str, float]:
        """The first model's numbers: rad/s^2 per %, 1/s, %, rad, Hz and ratios."""
        viscous, reduced = self.motor_viscous + self.link_viscous, self.motor_share * (1.0 - self.motor_share)
        mesh = math.sqrt(self.mesh_stiffness / reduced)
        return {
            "input_gain": self.input_gain,
            "viscous_friction": viscous,
            "dead_band_forward": self.dead_band_forward,
            "dead_band_reverse": self.dead_band_reverse,
            "backlash_gap": self.gap,
            "motor_share": self.motor_share,
            "friction_share": self.motor_viscous / viscous,
            "tooth_frequency": mesh / (2.0 * math.pi),
            "tooth_damping": self.mesh_damping / (2.0 * mesh * reduced),
        }


@dataclass(frozen=True, eq=False)
class Simulated:
    """One run, all (n,) at the stamps; `position` and `velocity` are the link's own, rad and rad/s."""

    time: Array
    duty: Array
    counts: NDArray[np.int64]
    shown: Array  # by the encoder's disc before it is counted, rad
    position: Array
    velocity: Array
    motor_position: Array
    counts_per_revolution: int


def draw_rig(rng: np.random.Generator) -> Rig:
    """A rig of a population between a lazy arm and a brisk spindle."""
    viscous, speed, at_motor = log_uniform(rng, 0.5, 5.0), log_uniform(rng, 3.0, 20.0), float(rng.uniform(0.4, 0.9))
    forward, reverse = rng.uniform(1.0, 10.0, 2).tolist()
    share, mesh = float(rng.uniform(0.1, 0.5)), 2.0 * math.pi * float(rng.uniform(60.0, 200.0))
    gain = viscous * speed / (50.0 - 0.5 * (forward + reverse))
    reduced = share * (1.0 - share)
    return Rig(
        input_gain=gain,
        motor_viscous=viscous * at_motor,
        link_viscous=viscous * (1.0 - at_motor),
        dead_band_forward=forward,
        dead_band_reverse=reverse,
        gap=log_uniform(rng, 0.005, 0.06),
        motor_share=share,
        mesh_stiffness=mesh**2 * reduced,
        mesh_damping=2.0 * float(rng.uniform(0.05, 0.4)) * mesh * reduced,
        noise=gain * log_uniform(rng, 0.1, 1.4),
        dry_share=float(rng.uniform(0.2, 1.0)),
        edge=0.1 * speed * log_uniform(rng, 0.003, 0.05),
        counts_per_revolution=int(rng.choice([2000, 4096, 8192, 20000])),
        encoder_phase=float(rng.uniform()),
    )


# ---- effects ----

Parameters = dict[str, float]


@dataclass(frozen=True)
class _Drawing(Drawing):
    turn: float  # an angle, rad
    sign: float


def _end_stop(d: _Drawing) -> Parameters:
    upper, lower = (d.reach * d.rng.uniform(0.5, 1.0, 2) * (0.3 / max(d.size, 1e-9)) ** 0.5).tolist()
    stiffness = 3e4 if d.size > 0.0 else 0.0
    return {"stop_upper": upper, "stop_lower": -lower, "stop_stiffness": stiffness, "stop_damping": 60.0}


def _flexible_load(d: _Drawing) -> Parameters:
    rate = 2.0 * math.pi * d.log_uniform(0.8, 8.0)
    damping = 2.0 * d.log_uniform(0.03, 0.3) * rate
    return {"rider_share": 2.0 * d.size, "rider_rate": rate, "rider_damping": damping}


def _joint_elasticity(d: _Drawing) -> Parameters:
    share = d.rig.motor_share
    reduced, rate = share * (1.0 - share), 0.0
    if d.size > 0.0:
        rate = 2.0 * math.pi * min(3.0 * math.sqrt(0.3 / d.size), 40.0)
    return {"joint_stiffness": rate**2 * reduced, "joint_damping": 2.0 * d.between(0.03, 0.2) * rate * reduced}


def _position_dependent_friction(d: _Drawing) -> tuple[Parameters, Parameters]:
    # The plain part is four thirds of what varies: friction stays friction.
    plain = {"coulomb": d.torque / 0.75}
    return plain | {"dry_wave": d.torque, "dry_wave_phase": d.turn}, plain


def _stribeck_friction(d: _Drawing) -> tuple[Parameters, Parameters]:
    plain = {"coulomb": 0.5 * d.torque}
    return plain | {"stribeck": d.torque, "stribeck_speed": d.speed * d.log_uniform(0.03, 0.12)}, plain


_EFFECTS: dict[str, Callable[[_Drawing], Parameters]] = {
    "constant_offset": lambda d: {"offset": d.sign * d.torque},
    "coulomb_friction": lambda d: {"coulomb": d.torque},
    "detent": lambda d: {
        "detent": d.torque, "detent_angle": d.reach * d.between(-1.0, 1.0), "detent_width": d.between(0.1, 0.3)},
    "disturbance_pulse": lambda d: {
        "pulse": d.sign * d.torque, "pulse_start": d.duration * d.between(0.1, 0.7),
        "pulse_length": d.duration * d.between(0.05, 0.2)},
    "drive_saturation": lambda d: {"clip": 100.0 * (1.0 - 2.0 * d.size) if d.size > 0.0 else math.inf},
    "encoder_eccentricity": lambda d: {"eccentricity": 0.1 * d.size, "eccentricity_phase": d.turn},
    "end_stop": _end_stop,
    "flexible_load": _flexible_load,
    "friction_asymmetry": lambda d: {"dry_forward" if d.sign > 0.0 else "dry_reverse": d.torque},
    "friction_run_in": lambda d: {"run_in": d.torque, "run_in_time": d.duration * d.between(0.05, 0.3)},
    "gravity": lambda d: {"gravity": d.torque, "gravity_phase": d.turn},
    "input_delay": lambda d: {"delay": 0.1 * d.size},
    "joint_elasticity": _joint_elasticity,
    "load_change": lambda d: {
        "load_time": d.duration * d.between(0.2, 0.6), "load_factor": (1.0 + 2.0 * d.size) ** d.sign},
    "load_dependent_friction": lambda d: {"dry_load": d.size},
    "motor_lag": lambda d: {"lag": 0.2 * d.size},
    "periodic_disturbance": lambda d: {
        "shake": d.torque, "shake_frequency": d.log_uniform(0.5, 15.0), "shake_phase": d.turn},
    "presliding_friction": lambda d: {"bristle": d.torque, "bristle_travel": d.log_uniform(0.02, 0.08)},
    "quadratic_drag": lambda d: {"drag": d.torque / d.speed**2},
    "spring": lambda d: {"spring": d.torque / d.speed, "spring_rest": d.between(-0.2, 0.2) * d.speed},
    "sticky_sector": lambda d: {
        "sector": d.torque, "sector_angle": d.reach * d.between(-1.0, 1.0), "sector_half": d.between(0.15, 0.5)},
    "supply_sag": lambda d: {"sag": d.size},
    "thermal_fade": lambda d: {"fade": d.size, "fade_time": d.duration * d.between(0.15, 0.6)},
    "torque_ripple": lambda d: {
        "ripple": d.torque, "ripple_order": float(d.rng.integers(4, 40)), "ripple_phase": d.turn},
    "viscous_asymmetry": lambda d: {"viscous_asymmetry": 3.0 * d.size},
    "other_bump": lambda d: {
        "bump": d.sign * d.torque, "bump_angle": d.reach * d.between(-1.0, 1.0), "bump_width": d.between(0.1, 0.3)},
    "other_cubic_drag": lambda d: {"cubic": d.torque / d.speed**3},
    "other_gain_asymmetry": lambda d: {"gain_asymmetry": d.sign * d.size},
}  # fmt: skip
# Parts of dry friction: their numbers with those of the plain friction, and the latter alone.
_IN_DRY_FRICTION: dict[str, Callable[[_Drawing], tuple[Parameters, Parameters]]] = {
    "position_dependent_friction": _position_dependent_friction,
    "stribeck_friction": _stribeck_friction,
}


def draw_effect(rng: np.random.Generator, id: str, rig: Rig, size: float, duration: float = 60.0) -> Concealed:
    """An effect of that size, all else about it at random; size 0 is no effect at all.

    The size is its torque over that of the drive at 50 % duty. Where it has none, 0.3 is a lag of 60 ms, a delay of 30
    ms, a coupling of 3 Hz or a clip at 40 % duty. It is 30 mrad of eccentricity, or a load that is
    1.6 times the link's. A stop comes nearer as the size grows. `duration` (s) is of the recording.

    Raises ValueError for an id that is not known.
    """
    turn, sign = float(rng.uniform(-math.pi, math.pi)), float(rng.choice([-1.0, 1.0]))
    drawing = _Drawing(rng, rig, size, duration, turn, sign)
    return drawn(id, drawing, _EFFECTS, _IN_DRY_FRICTION, [*VOCABULARY, *OUTSIDE])


# ---- running it ----


@njit(cache=True)  # type: ignore[untyped-decorator]
def _drive(duty: float, motor_speed: float, p: _Plant) -> float:
    """What is left of a duty (%) behind clip, supply and dead-band."""
    u = min(max(duty, -p.clip), p.clip)
    if p.sag > 0.0:
        emf = EMF * p.motor_viscous * motor_speed / p.input_gain
        u *= 1.0 - p.sag * abs(u - emf) / 50.0
    if u > p.dead_band_forward:
        return u - p.dead_band_forward
    if u < -p.dead_band_reverse:
        return u + p.dead_band_reverse
    return 0.0


@njit(cache=True)  # type: ignore[untyped-decorator]
def _dry(angle: float, speed: float, passed: float, t: float, p: _Plant) -> float:
    """Dry friction at a speed, of which motor and link have a share each; teeth pass `passed`."""
    size = p.coulomb + p.stribeck * math.exp(-((speed / p.stribeck_speed) ** 2)) + p.dry_load * abs(passed)
    size += p.dry_wave * math.sin(angle + p.dry_wave_phase) + (p.dry_forward if speed > 0.0 else p.dry_reverse)
    size += p.run_in * math.exp(-max(t, 0.0) / p.run_in_time)
    if math.cos(angle - p.sector_angle) > math.cos(p.sector_half):
        size += p.sector
    return size * math.tanh(speed / p.edge)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _field(angle: float, speed: float, t: float, p: _Plant) -> float:
    """What the surroundings do to the link."""
    torque = p.offset - p.drag * speed * abs(speed) - p.cubic * speed**3
    torque -= p.gravity * math.sin(angle + p.gravity_phase) + p.spring * (angle - p.spring_rest)
    torque += p.shake * math.sin(2.0 * math.pi * p.shake_frequency * t + p.shake_phase)
    if 0.0 <= t - p.pulse_start < p.pulse_length:
        torque += p.pulse
    well = math.sin(0.5 * (angle - p.detent_angle)) * 2.0 / p.detent_width
    torque -= p.detent * well * math.exp(0.5 - 0.5 * well * well)
    torque += p.bump * math.exp(-0.5 * ((angle - p.bump_angle) / p.bump_width) ** 2)
    if angle > p.stop_upper:
        torque -= max(p.stop_stiffness * (angle - p.stop_upper) + p.stop_damping * speed, 0.0)
    if angle < p.stop_lower:
        torque -= min(p.stop_stiffness * (angle - p.stop_lower) + p.stop_damping * speed, 0.0)
    return torque


@njit(cache=True)  # type: ignore[untyped-decorator]
def _run(time: Array, duty: Array, noise: Array, p: _Plant) -> Array:
    """Link angle, its speed and the motor's angle at the stamps (n, 3); `noise` (2, values) begins with the settling.

    The first stamp is at `SETTLE`; until then the duty is zero.
    """
    n = time.size
    out = np.zeros((n, 3))
    motor = motor_speed = link = link_speed = lagging = heat = bend = rider = rider_speed = 0.0
    stiffness, damping = p.mesh_stiffness, p.mesh_damping
    if p.joint_stiffness > 0.0:
        stiffness, damping = p.joint_stiffness, p.joint_damping
    half, due, k = 0.5 * p.gap, -1, 0
    for step in range(round((SETTLE + time[-1] - time[0]) / STEP) + 1):
        t = step * STEP - SETTLE  # from the first stamp on
        while k < n and time[k] - time[0] <= t + 1e-9:
            out[k, 0], out[k, 1], out[k, 2] = link, link_speed, motor
            k += 1
        while due + 1 < n and time[due + 1] - time[0] + p.delay <= t + 1e-9:
            due += 1
        u = _drive(duty[due] if due >= 0 else 0.0, motor_speed, p)
        if p.lag > 0.0:
            lagging += STEP * (u - lagging) / p.lag
            u = lagging
        gain = p.input_gain * (1.0 - p.fade * heat)
        if u < 0.0:
            gain *= 1.0 + p.gain_asymmetry
        heat += STEP * ((u / 40.0) ** 2 - heat) / p.fade_time
        apart, closing = motor - link, motor_speed - link_speed
        passed = 0.0
        if apart > half:
            passed = stiffness * (apart - half) + damping * closing
        elif apart < -half:
            passed = stiffness * (apart + half) + damping * closing
        at = min(int((t + SETTLE) / NOISE_STEP), noise.shape[1] - 1)
        viscous = p.motor_viscous * (1.0 + (p.viscous_asymmetry if motor_speed < 0.0 else 0.0))
        push = gain * u - viscous * motor_speed - p.dry_share * _dry(link, motor_speed, passed, t, p) - passed
        if p.bristle > 0.0:
            bending = motor_speed - abs(motor_speed) * bend / p.bristle_travel
            bend += STEP * bending
            spring = p.bristle / p.bristle_travel
            push -= spring * bend + 0.6 * math.sqrt(spring * p.motor_share) * bending
        push += noise[0, at] + p.ripple * math.sin(p.ripple_order * motor + p.ripple_phase)
        pull = passed - p.link_viscous * link_speed - (1.0 - p.dry_share) * _dry(link, link_speed, passed, t, p)
        pull += noise[1, at] + _field(link, link_speed, t, p)
        if p.rider_share > 0.0:
            drawn = p.rider_rate**2 * (link - rider) + p.rider_damping * (link_speed - rider_speed)
            pull -= p.rider_share * drawn
            rider_speed += STEP * drawn
            rider += STEP * rider_speed
        inertia = (1.0 - p.motor_share) * (p.load_factor if t >= p.load_time else 1.0)
        motor_speed += STEP * push / p.motor_share
        link_speed += STEP * pull / inertia
        motor += STEP * motor_speed
        link += STEP * link_speed
    return out


def _plant(rig: Rig, effects: Sequence[Concealed]) -> _Plant:
    values = together(effects, (*VOCABULARY, *OUTSIDE))
    return _Plant(**({n: v for n, v in asdict(rig).items() if n in _Plant._fields} | values))


def simulate(rig: Rig, effects: Sequence[Concealed], time: Array, duty: Array, seed: int | None) -> Simulated:
    """The rig from rest with these effects: stamps (n,) in s, duty (n,) in %, held from each stamp to the next.

    `seed` draws the process noise and nothing else; None is none. Raises ValueError for an effect that is not known or
    there twice.
    """
    plant = _plant(rig, effects)
    time, duty = np.ascontiguousarray(time, dtype=float), np.ascontiguousarray(duty, dtype=float)
    values = math.ceil((SETTLE + time[-1] - time[0]) / NOISE_STEP) + 1
    shaken = np.zeros((2, values))
    if seed is not None:
        shaken = rig.noise * np.random.default_rng(seed).standard_normal((2, values))
    link, velocity, motor = _run(time, duty, shaken, plant).T.copy()
    shown = link + plant.eccentricity * np.sin(link + plant.eccentricity_phase)
    counts = np.floor(shown * rig.counts_per_revolution / (2.0 * math.pi) + rig.encoder_phase).astype(np.int64)
    return Simulated(time, duty, counts, shown, link, velocity, motor, rig.counts_per_revolution)
