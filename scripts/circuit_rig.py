"""A second simulator of rigs: the motor as a circuit, three bodies, friction as bristles or as a set-valued law.

It shares nothing with the model in `twin/` nor with the rigs in MuJoCo, which are alike where both are simple. Here the
back-EMF brakes the motor alone, and heat takes current and torque constant. Dry friction has its own shares at motor
and link and may give before it slides. The supply falls with the current that the bridge draws from it. The motor
stands anywhere in the gap at the start. Noise is the motor's and has a colour.

Units: the inertia of motor and link is 1, so torques are in rad/s^2. Duty in percent, angles in rad, time in s. Voltage
is a share of the supply's, current of what flows when the motor is held at full duty.

Chain: duty -> delay -> saturation -> dead-band -> filter -> supply -> winding -> motor -> teeth with a gap ->
(elastic coupling ->) link -> encoder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, floor, inf, pi, radians, sin, sqrt
from typing import NamedTuple

import numpy as np
from concealed import Concealed, Drawing, check, drawn
from numba import njit
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
TURN = 2.0 * pi
SAMPLE = 0.002
SUBSTEPS = 100
SETTLE = 0.5  # s at zero duty before the recording
WARM_RESISTANCE, WARM_TORQUE = 0.0039, -0.002  # copper and magnets, 1/K
FAR = 1e6  # rad: where a stop is that is not there


class Rig(NamedTuple):
    """The truth about a rig. What follows the encoder is of effects, and as it stands here none is there."""

    stall_torque: float  # at full duty
    back_emf: float  # voltage per rad/s
    motor_viscous: float  # 1/s
    link_viscous: float
    motor_inertia: float  # share
    gap: float
    teeth_stiffness: float
    teeth_damping: float
    dead_band_forward: float
    dead_band_reverse: float
    start: float  # link angle
    start_in_gap: float  # motor angle less that
    noise: float  # white torque at the motor below its corner, rad/s^2/sqrt(Hz)
    noise_time: float  # s, of its corner
    counts_per_revolution: float
    encoder_phase: float  # of one count

    coulomb: float = 0.0
    excess: float = 0.0  # of friction at rest over the sliding one
    excess_speed: float = 1.0
    one_way: float = 0.0  # share by which friction is larger forwards
    around: float = 0.0  # share by which it varies over a turn
    around_phase: float = 0.0
    per_load: float = 0.0  # friction over the teeth's torque
    load_at_motor: float = 0.0
    dry_at_motor: float = 0.0  # share
    bristle: float = 0.0  # rad by which friction gives before it slides; 0: it does not
    offset_motor: float = 0.0
    offset_link: float = 0.0
    drag: float = 0.0
    gravity: float = 0.0
    gravity_phase: float = 0.0
    spring: float = 0.0
    spring_rest: float = 0.0
    ripple_motor: float = 0.0
    ripple_link: float = 0.0
    ripple_order: float = 0.0
    ripple_phase: float = 0.0
    stop_upper: float = FAR
    stop_lower: float = -FAR
    stop_stiffness: float = 0.0
    stop_damping: float = 0.0
    gear_inertia: float = 0.0  # of the link's, ahead of an elastic coupling; 0: there is none
    coupling_stiffness: float = 0.0
    coupling_damping: float = 0.0
    filter_time: float = 0.0  # of the voltage
    winding_time: float = 0.0  # L/R
    delay: float = 0.0
    saturation: float = inf
    source_resistance: float = 0.0  # over the winding's
    heating: float = 0.0  # K/s at the current 1
    cooling_time: float = 1.0
    load_time: float = inf
    load_factor: float = 1.0  # of the link's inertia from then on
    eccentricity: float = 0.0
    eccentricity_phase: float = 0.0
    shake: float = 0.0
    shake_frequency: float = 0.0
    shake_phase: float = 0.0
    latch: float = 0.0
    latch_width: float = 1.0
    latch_angle: float = 0.0
    hump: float = 0.0
    hump_speed: float = 0.0
    hump_width: float = 1.0
    cubic: float = 0.0
    cubic_flat: float = 0.0
    slant: float = 0.0  # 1/s by which viscous friction is larger forwards, smaller in reverse
    run_in: float = 0.0  # friction at the recording's start beyond what is left later
    run_in_time: float = 1.0
    sector: float = 0.0  # friction within an angle of a turn
    sector_angle: float = 0.0
    sector_half: float = 1.0
    pulse: float = 0.0
    pulse_start: float = 0.0
    pulse_length: float = 0.0
    give: float = 0.0  # friction on the motor that gives before it slides
    give_travel: float = 1.0
    rider: float = 0.0  # inertia of what rides on the link
    rider_rate: float = 0.0
    rider_loss: float = 0.0
    clock: float = 0.0  # s, when the recording begins

    @property
    def viscous_friction(self) -> float:
        return self.stall_torque * self.back_emf + self.motor_viscous + self.link_viscous

    @property
    def half_torque(self) -> float:
        """Torque at 50 % duty, held: the scale of every effect's size."""
        return self.stall_torque * (0.5 - 0.005 * (self.dead_band_forward + self.dead_band_reverse))

    @property
    def half_speed(self) -> float:
        """Steady speed at 50 % duty without further effects, rad/s."""
        return self.half_torque / self.viscous_friction

    @property
    def own(self) -> dict[str, tuple[float, float]]:
        """What a first model has numbers for: the value, and the largest that it may be."""
        names = "stall_torque motor_viscous link_viscous dead_band_forward dead_band_reverse gap"
        shares = {"motor_inertia": 0.98}
        return {n: (getattr(self, n), most) for n, most in (dict.fromkeys(names.split(), inf) | shares).items()}

    def with_(self, **values: float) -> Rig:
        """The rig with other numbers."""
        return self._replace(**values)

    def truths(self) -> dict[str, float]:
        """What is drawn with the rig, whatever is concealed in it."""
        return {n: v for n, v in self._asdict().items() if n not in self._field_defaults}

    def model_values(self) -> dict[str, float]:
        """The rig's numbers under the model's names."""
        reduced = self.motor_inertia * (1.0 - self.motor_inertia)
        rate = sqrt(self.teeth_stiffness / reduced)
        return {
            "input_gain": 0.01 * self.stall_torque,
            "viscous_friction": self.viscous_friction,
            "dead_band_forward": self.dead_band_forward,
            "dead_band_reverse": self.dead_band_reverse,
            "backlash_gap": self.gap,
            "motor_share": self.motor_inertia,
            "friction_share": 1.0 - self.link_viscous / self.viscous_friction,
            "tooth_frequency": rate / TURN,
            "tooth_damping": self.teeth_damping / (2.0 * rate * reduced),
        }


@dataclass(frozen=True)
class Simulated:
    """A recording and what is true behind it, all (n,) at the stamps of `time`."""

    time: Array
    duty: Array
    counts: NDArray[np.int64]
    shown: Array  # by the encoder's disc before it is counted, rad
    position: Array
    velocity: Array
    motor_position: Array
    current: Array
    temperature: Array  # K above the start
    counts_per_revolution: int


def draw_rig(rng: np.random.Generator) -> Rig:
    """One rig of about the population that the estimator study draws from."""

    def log_uniform(low: float, high: float) -> float:
        return low * (high / low) ** float(rng.uniform())

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    viscous = 1.0 / log_uniform(0.15, 2.0)
    forward, reverse = between(3.0, 9.0), between(3.0, 9.0)
    stall = viscous * log_uniform(1.0, 15.0) / (0.6 - 0.005 * (forward + reverse))
    electric, at_link = between(0.35, 0.95), between(0.15, 0.7)
    share = between(0.1, 0.4)
    rate, reduced = TURN * log_uniform(60.0, 200.0), share * (1.0 - share)
    gap = radians(log_uniform(0.5, 5.0))
    return Rig(
        stall_torque=stall,
        back_emf=viscous * electric / stall,
        motor_viscous=viscous * (1.0 - electric) * (1.0 - at_link),
        link_viscous=viscous * (1.0 - electric) * at_link,
        motor_inertia=share,
        gap=gap,
        teeth_stiffness=rate**2 * reduced,
        teeth_damping=2.0 * between(0.1, 0.5) * rate * reduced,
        dead_band_forward=forward,
        dead_band_reverse=reverse,
        start=between(-3.0, 3.0),
        start_in_gap=gap * between(-0.5, 0.5),
        noise=log_uniform(3e-4, 5e-3) * stall * 0.45,
        noise_time=between(0.005, 0.05),
        counts_per_revolution=float(rng.choice([4096, 8192, 10000, 16384, 20000, 40000])),
        encoder_phase=between(0.0, 1.0),
    )


# ---- effects ----

Parameters = dict[str, float]


def _dry_friction(d: Drawing, level: float) -> Parameters:
    """Plain dry friction; its share at the motor and whether it gives are the rig's own."""
    at_motor = d.between(0.0, 0.4) * float(d.rng.random() < 0.5)
    bristle = 6e-5 * 7.0 ** d.between(0.0, 1.0) * float(d.rng.random() < 0.5)
    return {"coulomb": level, "dry_at_motor": at_motor, "bristle": bristle}


def _stribeck_friction(d: Drawing) -> tuple[Parameters, Parameters]:
    level = d.between(0.02, 0.06) * d.rig.half_torque
    more = {"excess": d.torque, "excess_speed": d.speed * d.between(0.02, 0.15)}
    plain = _dry_friction(d, level)
    return plain | more, plain


def _friction_asymmetry(d: Drawing) -> tuple[Parameters, Parameters]:
    share = d.between(0.2, 0.8) * d.either()
    plain = _dry_friction(d, d.torque / abs(share))
    return plain | {"one_way": share if d.size else 0.0}, plain


def _position_dependent_friction(d: Drawing) -> tuple[Parameters, Parameters]:
    share, phase = d.between(0.3, 0.95), d.phase()
    plain = _dry_friction(d, d.torque / share)
    return plain | {"around": share if d.size else 0.0, "around_phase": phase}, plain


def _end_stop(d: Drawing) -> Parameters:
    away = d.speed * 0.3 / d.size * d.rng.uniform(0.1, 0.3, 2) if d.size else np.array([FAR, FAR])
    upper, lower = away.tolist()
    missing, rate = d.rng.integers(0, 4), TURN * d.between(15.0, 50.0)
    return {
        "stop_upper": FAR if missing == 0 else d.rig.start + upper,
        "stop_lower": -FAR if missing == 1 else d.rig.start - lower,
        "stop_stiffness": rate**2,
        "stop_damping": 2.0 * d.between(0.1, 0.4) * rate,
    }


def _joint_elasticity(d: Drawing) -> Parameters:
    if not d.size:
        return {}
    gear = d.between(0.03, 0.1) * (1.0 - d.rig.motor_inertia)
    ahead, rate = d.rig.motor_inertia + gear, TURN * min(3.0 * sqrt(0.3 / d.size), 60.0)
    reduced = ahead * (1.0 - ahead)
    return {
        "gear_inertia": gear,
        "coupling_stiffness": rate**2 * reduced,
        "coupling_damping": 2.0 * d.between(0.01, 0.1) * rate * reduced,
    }


def _load_change(d: Drawing) -> Parameters:
    factor = 1.0 + 3.0 * d.size
    factor = factor if d.rng.random() < 0.5 else 1.0 / factor
    return {"load_factor": factor, "load_time": d.duration * d.between(0.3, 0.7)}


def _gravity(d: Drawing) -> Parameters:
    down = -d.phase()  # it starts hanging, or would swing
    return {"gravity": d.torque, "gravity_phase": -down, "start": down}


def _thermal_fade(d: Drawing) -> Parameters:
    time = d.duration * d.between(0.3, 1.0)
    return {"heating": 1500.0 * d.size / time, "cooling_time": time}


_EFFECTS: dict[str, Callable[[Drawing], Parameters]] = {
    "constant_offset": lambda d: {d.one_of("offset_motor", "offset_link"): d.torque * d.either()},
    "coulomb_friction": lambda d: _dry_friction(d, d.torque),
    "detent": lambda d: {
        "latch": d.torque, "latch_width": d.between(0.06, 0.2),
        "latch_angle": d.rig.start + d.reach * d.between(-1.0, 1.0)},
    "disturbance_pulse": lambda d: {
        "pulse": d.torque * d.either(), "pulse_start": d.duration * d.between(0.1, 0.7),
        "pulse_length": d.duration * d.between(0.05, 0.2)},
    "drive_saturation": lambda d: {"saturation": 100.0 * (1.0 - 2.0 * d.size)},
    "encoder_eccentricity": lambda d: {"eccentricity": 0.1 * d.size, "eccentricity_phase": d.phase()},
    "end_stop": _end_stop,
    "flexible_load": lambda d: {
        "rider": 2.0 * d.size, "rider_rate": TURN * 0.8 * 10.0 ** d.between(0.0, 1.0),
        "rider_loss": 0.03 * 10.0 ** d.between(0.0, 1.0)},
    "friction_run_in": lambda d: {"run_in": d.torque, "run_in_time": d.duration * d.between(0.05, 0.3)},
    "gravity": _gravity,
    "input_delay": lambda d: {"delay": 0.1 * d.size},
    "joint_elasticity": _joint_elasticity,
    "load_change": _load_change,
    "load_dependent_friction": lambda d: {"per_load": d.size, "load_at_motor": float(d.rng.random() < 0.5)},
    "motor_lag": lambda d: {d.one_of("filter_time", "winding_time"): 0.2 * d.size},
    "periodic_disturbance": lambda d: {
        "shake": d.torque, "shake_frequency": 0.5 * 30.0 ** d.between(0.0, 1.0), "shake_phase": d.phase()},
    "presliding_friction": lambda d: {"give": d.torque, "give_travel": 0.02 * 4.0 ** d.between(0.0, 1.0)},
    "quadratic_drag": lambda d: {"drag": d.torque / d.speed**2},
    "spring": lambda d: {"spring": d.torque / pi, "spring_rest": d.rig.start + d.between(-0.5, 0.5)},
    "sticky_sector": lambda d: {
        "sector": d.torque, "sector_angle": d.rig.start + d.reach * d.between(-1.0, 1.0),
        "sector_half": d.between(0.15, 0.5)},
    "supply_sag": lambda d: {"source_resistance": d.size},
    "thermal_fade": _thermal_fade,
    "torque_ripple": lambda d: {
        d.one_of("ripple_motor", "ripple_link"): d.torque, "ripple_order": float(d.rng.integers(4, 41)),
        "ripple_phase": d.phase()},
    "viscous_asymmetry": lambda d: {"slant": d.size * d.rig.viscous_friction * d.either()},
    "other_cubic_spring": lambda d: {
        "cubic": d.torque / max(d.speed, 1.0) ** 3, "cubic_flat": d.speed * d.between(0.1, 0.4)},
    "other_speed_hump": lambda d: {
        "hump": d.torque, "hump_speed": d.speed * d.between(0.3, 0.7), "hump_width": d.speed * d.between(0.05, 0.12)},
}  # fmt: skip
# Parts of dry friction: their numbers with those of the plain friction, and the latter alone.
_IN_DRY_FRICTION: dict[str, Callable[[Drawing], tuple[Parameters, Parameters]]] = {
    "friction_asymmetry": _friction_asymmetry,
    "position_dependent_friction": _position_dependent_friction,
    "stribeck_friction": _stribeck_friction,
}

OUTSIDE = ("other_cubic_spring", "other_speed_hump")
VOCABULARY = tuple(sorted({*_EFFECTS, *_IN_DRY_FRICTION} - {*OUTSIDE}))


def draw_effect(rng: np.random.Generator, id: str, rig: Rig, size: float, duration: float = 60.0) -> Concealed:
    """An effect of the given size, the rest of its parameters at random; size 0 is no effect at all.

    `size` is the effect's torque over the drive's at 50 % duty. Where there is no torque to speak of, 0.3 is as large
    as such an effect gets. That is a lag of 60 ms, a delay of 30 ms, a coupling of 3 Hz or clipping at 40 %. It is an
    eccentricity of 30 mrad, or a load almost doubled or halved. It is 450 K at stall (and so 20 to 100 in use), or a
    source with 0.3 of the winding's resistance.
    """
    drawing = Drawing(rng, rig, size, duration)
    return drawn(id, drawing, _EFFECTS, _IN_DRY_FRICTION, VOCABULARY + OUTSIDE)


# ---- the simulation ----


@njit(cache=True)
def _slowed(level, speed, bend, mass, rig, step):  # type: ignore[no-untyped-def]
    """Speed after one step of a body's dry friction, which it would have had as `speed`, and the bristle's new bend.

    Set-valued: friction stops the body and no more. As bristles (LuGre): `bend` is a share of the give, and the speed
    is the one that bends them, from a quadratic, or a body at rest on a slope would creep.
    """
    if level <= 0.0:
        return speed, bend
    if rig.bristle <= 0.0:
        most = step * level * (1.0 + rig.one_way if speed > 0.0 else 1.0 - rig.one_way) / mass
        return speed - min(max(speed, -most), most), bend
    level *= 1.0 + rig.one_way if bend > 0.0 else 1.0 - rig.one_way
    rate, damping = step / rig.bristle, 1.2 * sqrt(level * rig.bristle * mass)
    push = speed - step * level * bend / mass
    side = 1.0 if push > 0.0 else -1.0
    linear = 1.0 + rate * ((step * level + damping * (1.0 - side * bend)) / mass - side * speed)
    after = side * 2.0 * abs(push) / (linear + sqrt(linear**2 + 4.0 * rate * abs(push)))
    return after, (bend + rate * after) / (1.0 + rate * abs(after))


class _Step(NamedTuple):
    """How long a step is, s, and what share of a change filter and winding let pass within it."""

    length: float
    voltage: float
    current: float


class _Drive(NamedTuple):
    """What the drive keeps from one step to the next."""

    filtered: float  # voltage
    current: float
    heat: float  # K above the start


@njit(cache=True)
def _drive(drive, duty, w_motor, step, rig):  # type: ignore[no-untyped-def]
    """The drive after a step at a duty (%) and a speed of the motor (rad/s)."""
    u = min(max(duty, -rig.saturation), rig.saturation)
    acts = max(u - rig.dead_band_forward, 0.0) + min(u + rig.dead_band_reverse, 0.0)
    filtered = drive.filtered + step.voltage * (0.01 * acts - drive.filtered)
    emf = rig.back_emf * (1.0 + WARM_TORQUE * drive.heat) * w_motor
    resistance = 1.0 + WARM_RESISTANCE * drive.heat
    # The bridge draws filtered * current from a source that falls with it and takes nothing back.
    rail = (1.0 + rig.source_resistance * filtered * emf) / (1.0 + rig.source_resistance * filtered**2)
    current = drive.current + step.current * ((filtered * min(rail, 1.0) - emf) / resistance - drive.current)
    heat = drive.heat + step.length * (rig.heating * current**2 - drive.heat / rig.cooling_time)
    return _Drive(filtered, current, heat)


@njit(cache=True)
def _field(link, w_link, now, rig):  # type: ignore[no-untyped-def]
    """Torque on the link at an angle (rad), a speed (rad/s) and a time (s), without teeth and dry friction."""
    torque = rig.offset_link + rig.ripple_link * sin(rig.ripple_order * link + rig.ripple_phase)
    torque -= rig.link_viscous * w_link + rig.slant * abs(w_link)
    torque -= rig.drag * w_link * abs(w_link) + rig.gravity * sin(link + rig.gravity_phase)
    torque -= rig.spring * (link - rig.spring_rest)
    torque += rig.shake * sin(TURN * rig.shake_frequency * now + rig.shake_phase)
    off = ((link - rig.latch_angle + pi) % TURN - pi) / rig.latch_width
    torque -= rig.latch * off * exp(0.5 - 0.5 * off**2)
    if 0.0 <= now - rig.clock - rig.pulse_start < rig.pulse_length:
        torque += rig.pulse
    hump = rig.hump * exp(-(((abs(w_link) - rig.hump_speed) / rig.hump_width) ** 2))
    torque -= hump if w_link > 0.0 else -hump
    away = link - rig.start
    torque -= rig.cubic * (max(away - rig.cubic_flat, 0.0) + min(away + rig.cubic_flat, 0.0)) ** 3
    if link > rig.stop_upper:
        torque -= max(rig.stop_stiffness * (link - rig.stop_upper) + rig.stop_damping * w_link, 0.0)
    if link < rig.stop_lower:
        torque -= min(rig.stop_stiffness * (link - rig.stop_lower) + rig.stop_damping * w_link, 0.0)
    return torque


@njit(cache=True)
def _teeth(twist, rate, rig):  # type: ignore[no-untyped-def]
    """Torque through the teeth, which push and do not pull."""
    half = 0.5 * rig.gap
    if twist > half:
        return max(rig.teeth_stiffness * (twist - half) + rig.teeth_damping * rate, 0.0)
    if twist < -half:
        return min(rig.teeth_stiffness * (twist + half) + rig.teeth_damping * rate, 0.0)
    return 0.0


@njit(cache=True)
def _dry(link, w_link, now, rig):  # type: ignore[no-untyped-def]
    """Dry friction of motor and link together, without what the teeth's torque adds."""
    dry = rig.coulomb + rig.excess * exp(-((w_link / rig.excess_speed) ** 2))
    dry *= 1.0 + rig.around * sin(link + rig.around_phase)
    dry += rig.run_in * exp(-max(now - rig.clock, 0.0) / rig.run_in_time)
    if abs((link - rig.sector_angle + pi) % TURN - pi) < rig.sector_half:
        dry += rig.sector
    return dry


@njit(cache=True)
def _play(rig, duty, shaking, substeps):  # type: ignore[no-untyped-def]
    """Symplectic Euler; `duty` (n,) held, `shaking` (n + 1,) straight lines between, both per SAMPLE. Rows (n, 5)."""
    h = SAMPLE / substeps
    pass_voltage = 1.0 - exp(-h / rig.filter_time) if rig.filter_time > 0.0 else 1.0
    pass_current = 1.0 - exp(-h / rig.winding_time) if rig.winding_time > 0.0 else 1.0
    step, drive = _Step(h, pass_voltage, pass_current), _Drive(0.0, 0.0, 0.0)
    out = np.empty((len(duty), 5))
    elastic = rig.gear_inertia > 0.0
    link_inertia = 1.0 - rig.motor_inertia - rig.gear_inertia
    link = gear = rider = rig.start
    motor = rig.start + rig.start_in_gap
    w_link = w_gear = w_motor = w_rider = bend_link = bend_motor = give = 0.0
    for k in range(len(duty)):
        out[k] = link, w_link, motor, drive.current, drive.heat
        for j in range(substeps):
            now = k * SAMPLE + j * h
            if now >= rig.load_time:
                link_inertia = (1.0 - rig.motor_inertia - rig.gear_inertia) * rig.load_factor
            late = floor((now - rig.delay) / SAMPLE + 1e-9)
            drive = _drive(drive, duty[late] if late >= 0 else 0.0, w_motor, step, rig)
            # Torques on motor and link without teeth and dry friction.
            mixed = shaking[k] + (shaking[k + 1] - shaking[k]) * j / substeps
            on_motor = rig.stall_torque * (1.0 + WARM_TORQUE * drive.heat) * drive.current + mixed
            on_motor -= rig.motor_viscous * w_motor
            on_motor += rig.offset_motor + rig.ripple_motor * sin(rig.ripple_order * motor + rig.ripple_phase)
            on_link = _field(link, w_link, now, rig)
            if rig.rider > 0.0:
                drawn = rig.rider_rate**2 * (link - rider) + 2.0 * rig.rider_loss * rig.rider_rate * (w_link - w_rider)
                on_link -= rig.rider * drawn
                w_rider += h * drawn
                rider += h * w_rider
            if rig.give > 0.0:
                gives = w_motor / rig.give_travel - abs(w_motor) / rig.give_travel * give
                give += h * gives
                on_motor -= rig.give * give + 0.6 * sqrt(rig.give * rig.give_travel * rig.motor_inertia) * gives
            twist, rate = (motor - gear, w_motor - w_gear) if elastic else (motor - link, w_motor - w_link)
            teeth = passed = _teeth(twist, rate, rig)
            if elastic:
                passed = rig.coupling_stiffness * (gear - link) + rig.coupling_damping * (w_gear - w_link)
                w_gear += h * (teeth - passed) / rig.gear_inertia
            # Speeds.
            dry, per_load = _dry(link, w_link, now, rig), rig.per_load * abs(teeth)
            at_link = (1.0 - rig.dry_at_motor) * dry + (1.0 - rig.load_at_motor) * per_load
            at_motor = rig.dry_at_motor * dry + rig.load_at_motor * per_load
            w_link += h * (on_link + passed) / link_inertia
            w_motor += h * (on_motor - teeth) / rig.motor_inertia
            w_link, bend_link = _slowed(at_link, w_link, bend_link, link_inertia, rig, h)
            w_motor, bend_motor = _slowed(at_motor, w_motor, bend_motor, rig.motor_inertia, rig, h)
            link += h * w_link
            motor += h * w_motor
            gear += h * w_gear
    return out


@dataclass(frozen=True)
class Stepping:
    """How a rig is simulated: s at zero duty before the recording, and internal steps per SAMPLE."""

    settle: float = SETTLE
    substeps: int = SUBSTEPS


STEPPING = Stepping()


def simulate(
    rig: Rig,
    effects: Sequence[Concealed],
    time: Array,
    duty: Array,
    seed: int | None,
    stepping: Stepping = STEPPING,
) -> Simulated:
    """Play `duty` (n,) in percent, held from stamp to stamp of `time` (n,), whole multiples of SAMPLE from its first.

    `seed` draws the process noise; None is none.
    Raises ValueError for an effect that is not known or there twice.
    """
    check(effects, VOCABULARY + OUTSIDE)
    for e in effects:
        # Two parts of dry friction each bring some; the share that each is of it is then of the whole.
        rig = rig._replace(**{**e.parameters, "coulomb": rig.coulomb + e.parameters.get("coulomb", 0.0)})
    before, settle = round(stepping.settle / SAMPLE), stepping.settle
    # Its clock begins with the recording.
    phase = rig.shake_phase - TURN * rig.shake_frequency * settle
    rig = rig._replace(load_time=rig.load_time + settle, shake_phase=phase, clock=settle)
    command = np.concatenate([np.zeros(before), duty])
    white = np.zeros(len(command) + 1)
    if seed is not None:
        white = np.random.default_rng(seed).standard_normal(len(command) + 1) * rig.noise / sqrt(SAMPLE)
    keep = exp(-SAMPLE / rig.noise_time)
    track = _play(rig, command, lfilter([1.0 - keep], [1.0, -keep], white), stepping.substeps)[before:]
    shown = track[:, 0] + rig.eccentricity * np.sin(track[:, 0] + rig.eccentricity_phase)
    per_turn = int(rig.counts_per_revolution)
    counts = np.floor(shown * per_turn / TURN + rig.encoder_phase).astype(np.int64)
    return Simulated(np.asarray(time, float), np.asarray(duty, float), counts, shown, *track.T, per_turn)
