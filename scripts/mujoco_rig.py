"""A motor-driven axis in MuJoCo, with effects to conceal in it: recordings whose truth is known.

Nothing here is shared with the model in `twin/`: the engine, the integrator, the compliant teeth, the
friction solver and the formulas are all different, so that what the tool finds in these recordings is not
found by construction.

Units: the total inertia of motor and link is 1, so every torque is the link acceleration in rad/s^2 that
it causes when the gears are in mesh. Duty in percent, angles in rad, time in s. Without effects, in mesh,
the rig obeys  domega/dt + b omega = c (V + delta).

Chain: duty -> delay -> saturation -> supply -> dead-band -> lag -> gain -> motor body -> teeth with a gap ->
(elastic coupling ->) link body -> encoder.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from math import exp, inf, pi, sin, sqrt

import numpy as np
from concealed import Concealed, Drawing, check
from numpy.typing import NDArray

try:
    import mujoco
except ModuleNotFoundError:
    sys.exit("rigs in MuJoCo need the extra mujoco: pip install '.[mujoco]'")

Array = NDArray[np.float64]
TURN = 2.0 * pi

# Halving it moves a base rig within one second by 0.09 counts (median of 60 rigs; 1.0 for one in ten, where
# teeth bounce), process noise by 2.9 (21): per rig, 0.04 (0.30) of what noise does, at worst 0.92.
STEP = 2e-4
SETTLE = 1.0  # at zero duty before the recording: it starts neither exactly at rest nor centred in the gap
GEAR_SHARE = 0.1  # of the link's inertia that sits ahead of the coupling when the coupling is elastic
BODY_INERTIA = 1e-6  # what MuJoCo insists a body has; the rest is written as armature, which may change later
BACK_EMF = 0.7  # share of the rig's viscous friction that is back-emf and so unloads the supply


@dataclass(frozen=True)
class Rig:
    """The truth about one base rig."""

    input_gain: float  # c, rad/s^2 per percent
    viscous_friction: float  # b, 1/s
    dead_band_forward: float  # percent, > 0
    dead_band_backward: float  # percent, > 0
    backlash: float  # the whole gap, rad
    motor_share: float  # of the total inertia
    motor_friction_share: float  # of viscous and of dry friction
    teeth_frequency: float  # Hz, motor against link, in mesh
    teeth_damping: float  # damping ratio of the same
    motor_noise: float  # white torque, rad/s^2/sqrt(Hz)
    link_noise: float
    counts_per_revolution: int
    encoder_phase: float  # of one count

    @property
    def half_torque(self) -> float:
        """Torque at 50 % duty: the scale of every effect's size."""
        return self.input_gain * (50.0 - 0.5 * (self.dead_band_forward + self.dead_band_backward))

    @property
    def half_speed(self) -> float:
        """Steady speed at 50 % duty without further effects, rad/s."""
        return self.half_torque / self.viscous_friction

    @property
    def own(self) -> dict[str, tuple[float, float]]:
        """What a first model has numbers for: the value, and the largest that it may be."""
        names = "input_gain viscous_friction dead_band_forward dead_band_backward backlash"
        shares = {"motor_share": 0.98, "motor_friction_share": 1.0}
        return {n: (getattr(self, n), most) for n, most in (dict.fromkeys(names.split(), inf) | shares).items()}

    def with_(self, **values: float) -> Rig:
        """The rig with other numbers."""
        return replace(self, **values)

    def truths(self) -> dict[str, float]:
        return asdict(self)

    def model_values(self) -> dict[str, float]:
        """The rig's numbers under the model's names."""
        return {
            "input_gain": self.input_gain,
            "viscous_friction": self.viscous_friction,
            "dead_band_forward": self.dead_band_forward,
            "dead_band_reverse": self.dead_band_backward,
            "backlash_gap": self.backlash,
            "motor_share": self.motor_share,
            "friction_share": self.motor_friction_share,
            "tooth_frequency": self.teeth_frequency,
            "tooth_damping": self.teeth_damping,
        }


def draw_rig(rng: np.random.Generator) -> Rig:
    """One rig from the population of the estimator study."""

    def log_uniform(low: float, high: float) -> float:
        return low * (high / low) ** float(rng.uniform())

    viscous = 1.0 / log_uniform(0.15, 2.0)
    forward, backward = rng.uniform(3.0, 9.0, 2).tolist()
    gain = viscous * log_uniform(1.0, 15.0) / (60.0 - 0.5 * (forward + backward))
    noise = log_uniform(3e-4, 5e-3) * gain * 45.0
    at_motor = float(rng.uniform(0.1, 0.9))
    return Rig(
        input_gain=gain,
        viscous_friction=viscous,
        dead_band_forward=forward,
        dead_band_backward=backward,
        backlash=log_uniform(0.5, 5.0) * TURN / 360.0,
        motor_share=float(rng.uniform(0.1, 0.4)),
        motor_friction_share=float(rng.uniform(0.3, 1.0)),
        teeth_frequency=log_uniform(60.0, 200.0),
        teeth_damping=float(rng.uniform(0.1, 0.5)),
        motor_noise=noise * sqrt(at_motor),
        link_noise=noise * sqrt(1.0 - at_motor),
        counts_per_revolution=int(rng.choice([10000, 10000, 10000, 4096, 8192, 16384, 20000, 40000])),
        encoder_phase=float(rng.uniform()),
    )


@dataclass(frozen=True)
class Simulated:
    """A recording and what is true behind it, all at the stamps of `time`."""

    time: Array
    duty: Array
    counts: NDArray[np.int64]
    shown: Array  # by the encoder's disc before it is counted, rad
    position: Array  # of the link, rad
    velocity: Array
    motor_position: Array  # referred to the link side
    motor_velocity: Array
    torque: Array  # of the drive on the motor, rad/s^2
    counts_per_revolution: int


class State:
    """What the effects' laws may look at during one internal step."""

    __slots__ = (
        "angle",
        "current",
        "duty",
        "motor_angle",
        "motor_speed",
        "speed",
        "supply",
        "time",
        "transmitted",
    )

    def __init__(self) -> None:
        self.time = self.angle = self.speed = self.motor_angle = self.motor_speed = 0.0
        self.duty = 0.0  # as commanded, after the delay
        self.current = 0.0  # in percent of the stall current at full duty
        self.supply = 1.0
        self.transmitted = 0.0  # torque through the teeth


Law = Callable[[State], float]
Shaper = Callable[[float, State], float]
Friction = Callable[[float, State], float]  # of the speed of the body it brakes; the magnitude, never negative
Parameters = dict[str, float]


# ---- laws that act in the loop; each takes its parameters and the rig, returns a function of the state ----


def constant_friction(p: Parameters, rig: Rig) -> Friction:
    magnitude = p["magnitude"]
    return lambda speed, s: magnitude


def stribeck_friction(p: Parameters, rig: Rig) -> Friction:
    magnitude, scale = p["magnitude"], p["speed"]
    return lambda speed, s: magnitude * exp(-((speed / scale) ** 2))


def one_way_friction(p: Parameters, rig: Rig) -> Friction:
    # At rest the side is that of the way the motor is being pushed.
    forward, backward = p["forward"], p["backward"]
    return lambda speed, s: forward if (speed if abs(speed) > 1e-6 else s.duty) > 0.0 else backward


def angle_friction(p: Parameters, rig: Rig) -> Friction:
    mean, phase = p["magnitude"], p["phase"]
    return lambda speed, s: mean * (1.0 + sin(s.angle + phase))


def run_in_friction(p: Parameters, rig: Rig) -> Friction:
    magnitude, scale = p["magnitude"], p["time"]
    return lambda speed, s: magnitude * exp(-max(s.time, 0.0) / scale)


def sector_friction(p: Parameters, rig: Rig) -> Friction:
    magnitude, middle, half = p["magnitude"], p["middle"], p["half"]
    return lambda speed, s: magnitude if abs((s.angle - middle + pi) % TURN - pi) < half else 0.0


def load_friction(p: Parameters, rig: Rig) -> Friction:
    share = p["share"]
    return lambda speed, s: share * abs(s.transmitted)


def constant_torque(p: Parameters, rig: Rig) -> Law:
    torque = p["torque"]
    return lambda s: torque


def quadratic_drag(p: Parameters, rig: Rig) -> Law:
    gain = p["gain"]
    return lambda s: -gain * s.speed * abs(s.speed)


def slanted_drag(p: Parameters, rig: Rig) -> Law:
    slant = p["slant"]
    return lambda s: -slant * abs(s.speed)


def pulse(p: Parameters, rig: Rig) -> Law:
    torque, begin, end = p["torque"], p["start"], p["start"] + p["length"]
    return lambda s: torque if begin <= s.time < end else 0.0


def gravity(p: Parameters, rig: Rig) -> Law:
    gain, phase = p["gain"], p["phase"]
    return lambda s: -gain * sin(s.angle + phase)


def spring(p: Parameters, rig: Rig) -> Law:
    stiffness, rest = p["stiffness"], p["rest"]
    return lambda s: -stiffness * (s.angle - rest)


def link_ripple(p: Parameters, rig: Rig) -> Law:
    gain, order, phase = p["gain"] * (1.0 - p["at_motor"]), p["order"], p["phase"]
    return lambda s: gain * sin(order * s.angle + phase)


def motor_ripple(p: Parameters, rig: Rig) -> Law:
    gain, order, phase = p["gain"] * p["at_motor"], p["order"], p["phase"]
    return lambda s: gain * sin(order * s.motor_angle + phase)


def disturbance(p: Parameters, rig: Rig) -> Law:
    gain, rate, phase = p["gain"], TURN * p["frequency"], p["phase"]
    return lambda s: gain * sin(rate * s.time + phase)


def brake_coast(p: Parameters, rig: Rig) -> Law:
    damping = p["damping"]
    return lambda s: -damping * s.motor_speed if s.duty == 0.0 else 0.0


def latch(p: Parameters, rig: Rig) -> Law:
    depth, width, angle = p["torque"], p["width"], p["angle"]

    def law(s: State) -> float:
        x = ((s.angle - angle + pi) % TURN - pi) / width
        return -depth * x * exp(0.5 - 0.5 * x * x)

    return law


def speed_hump(p: Parameters, rig: Rig) -> Law:
    torque, speed, width = p["torque"], p["speed"], p["width"]

    def law(s: State) -> float:
        drag = torque * exp(-(((abs(s.speed) - speed) / width) ** 2))
        return -drag if s.speed > 0.0 else drag

    return law


def cubic_spring(p: Parameters, rig: Rig) -> Law:
    stiffness, flat = p["stiffness"], p["flat"]

    def law(s: State) -> float:
        stretch = max(s.angle - flat, 0.0) + min(s.angle + flat, 0.0)
        return -stiffness * stretch**3

    return law


def bristles(p: Parameters, rig: Rig) -> Law:
    # LuGre with a constant sliding level, on the motor side; the bristles' own damping stops their ringing.
    level, give = p["magnitude"], p["give"]
    if level == 0.0:
        return lambda s: 0.0
    stiffness = level / give
    damping = 0.6 * sqrt(stiffness * rig.motor_share)
    bend = 0.0

    def law(s: State) -> float:
        nonlocal bend
        rate = s.motor_speed - abs(s.motor_speed) * bend / give
        bend += STEP * rate
        return -(stiffness * bend + damping * rate)

    return law


def rider(p: Parameters, rig: Rig) -> Law:
    # Something on a spring and a damper, which stands where the link stands until that moves.
    share, rate = p["share"], TURN * p["frequency"]
    loss = 2.0 * p["damping"] * rate
    place = speed = 0.0

    def law(s: State) -> float:
        nonlocal place, speed
        drawn = rate * rate * (s.angle - place) + loss * (s.speed - speed)
        speed += STEP * drawn
        place += STEP * speed
        return -share * drawn

    return law


def duty_sign_cogging(p: Parameters, rig: Rig) -> Law:
    gain, order, phase, side = p["gain"], p["order"], p["phase"], p["side"]
    return lambda s: gain * sin(order * s.motor_angle + phase) if s.duty * side > 0.0 else 0.0


def warming_viscosity(p: Parameters, rig: Rig) -> Law:
    damping, scale = p["damping"], p["time"]
    return lambda s: -damping * exp(-max(s.time, 0.0) / scale) * s.motor_speed


def drive_saturation(p: Parameters, rig: Rig) -> Shaper:
    limit = p["limit"]
    return lambda duty, s: min(max(duty, -limit), limit)


def supply_sag(p: Parameters, rig: Rig) -> Shaper:
    # The supply sees the motor's current only while the bridge is on; its capacitor delays the fall.
    resistance, blend = p["resistance"], STEP / p["time"]

    def law(duty: float, s: State) -> float:
        drawn = max(duty * s.current, 0.0) / 2500.0
        s.supply += blend * (1.0 - resistance * drawn - s.supply)
        return duty * s.supply

    return law


def motor_lag(p: Parameters, rig: Rig) -> Shaper:
    blend = 1.0 - exp(-STEP / p["time"]) if p["time"] > 0.0 else 1.0
    torque = 0.0

    def law(command: float, s: State) -> float:
        nonlocal torque
        before = torque
        torque += blend * (command - torque)
        return 0.5 * (before + torque) if blend < 1.0 else torque

    return law


def thermal_fade(p: Parameters, rig: Rig) -> Shaper:
    fade, blend = p["fade"], STEP / p["time"]
    heat = 0.0

    def law(torque: float, s: State) -> float:
        nonlocal heat
        heat += blend * (s.current * s.current / 2500.0 - heat)
        return torque / (1.0 + fade * heat)

    return law


def angle_gain(p: Parameters, rig: Rig) -> Shaper:
    share, phase = p["share"], p["phase"]
    return lambda torque, s: torque * (1.0 + share * sin(s.angle + phase))


Laws = dict[str, Callable[[Parameters, Rig], Law]]
Frictions = dict[str, Callable[[Parameters, Rig], Friction]]
Shapers = dict[str, Callable[[Parameters, Rig], Shaper]]

DRIVE: Shapers = {"drive_saturation": drive_saturation, "supply_sag": supply_sag}
GAIN: Shapers = {"motor_lag": motor_lag, "thermal_fade": thermal_fade, "other_angle_gain": angle_gain}
MOTOR: Laws = {
    "presliding_friction": bristles,
    "torque_ripple": motor_ripple,
    "other_brake_coast": brake_coast,
    "other_duty_sign_cogging": duty_sign_cogging,
    "other_warming_viscosity": warming_viscosity,
}
FRICTION: Frictions = {
    "coulomb_friction": constant_friction,
    "stribeck_friction": stribeck_friction,
    "friction_asymmetry": one_way_friction,
    "position_dependent_friction": angle_friction,
    "friction_run_in": run_in_friction,
    "sticky_sector": sector_friction,
    "load_dependent_friction": load_friction,
}
LINK: Laws = {
    "flexible_load": rider,
    "constant_offset": constant_torque,
    "quadratic_drag": quadratic_drag,
    "gravity": gravity,
    "spring": spring,
    "torque_ripple": link_ripple,
    "periodic_disturbance": disturbance,
    "viscous_asymmetry": slanted_drag,
    "disturbance_pulse": pulse,
    "detent": latch,
    "other_speed_hump": speed_hump,
    "other_cubic_spring": cubic_spring,
}

# ---- effects ----


def _friction_asymmetry(d: Drawing) -> Parameters:
    forward, backward = (d.torque, 0.0) if d.rng.uniform() < 0.5 else (0.0, d.torque)
    return {"forward": forward, "backward": backward}


def _end_stop(d: Drawing) -> Parameters:
    """One stop or two, nearer the larger the size; a stop that is not there lies far outside any travel."""
    far = 1e6
    reach = d.speed * 0.3 / d.size * d.rng.uniform(0.1, 0.3, 2) if d.size > 0.0 else np.array([far, far])
    missing = d.rng.integers(0, 4)  # 0: none below, 1: none above, else both are there
    return {
        "low": -far if missing == 0 else -float(reach[0]),
        "high": far if missing == 1 else float(reach[1]),
        "stiffness": (TURN * d.between(15.0, 50.0)) ** 2,
        "damping": d.between(0.1, 0.4),
    }


def _joint_elasticity(d: Drawing) -> Parameters:
    frequency = min(3.0 * sqrt(0.3 / d.size), 60.0) if d.size > 0.0 else 0.0
    return {"frequency": frequency, "damping": d.between(0.02, 0.2)}


def _order(d: Drawing) -> float:
    """How often something comes back in a turn."""
    return float(d.rng.integers(4, 41))


_EFFECTS: dict[str, Callable[[Drawing], Parameters]] = {
    "constant_offset": lambda d: {"torque": d.torque * d.either()},
    "coulomb_friction": lambda d: {"magnitude": d.torque},
    "detent": lambda d: {
        "torque": d.torque, "width": d.between(0.06, 0.2), "angle": d.reach * d.between(-1.0, 1.0)},
    "disturbance_pulse": lambda d: {
        "torque": d.torque * d.either(), "start": d.duration * d.between(0.1, 0.7),
        "length": d.duration * d.between(0.05, 0.2)},
    "drive_saturation": lambda d: {"limit": 100.0 * (1.0 - 2.0 * d.size)},
    "encoder_eccentricity": lambda d: {"amplitude": 0.1 * d.size, "phase": d.phase()},
    "end_stop": _end_stop,
    "flexible_load": lambda d: {
        "share": 2.0 * d.size, "frequency": 0.8 * 10.0 ** d.between(0.0, 1.0),
        "damping": 0.03 * 10.0 ** d.between(0.0, 1.0)},
    "friction_asymmetry": _friction_asymmetry,
    "friction_run_in": lambda d: {"magnitude": d.torque, "time": d.duration * d.between(0.05, 0.3)},
    "gravity": lambda d: {"gain": d.torque, "phase": d.phase()},
    "input_delay": lambda d: {"time": 0.1 * d.size},
    "joint_elasticity": _joint_elasticity,
    "load_change": lambda d: {"factor": 1.0 + 2.0 * d.size * d.either(), "time": d.duration * d.between(0.3, 0.7)},
    "load_dependent_friction": lambda d: {"share": d.size},
    "motor_lag": lambda d: {"time": 0.2 * d.size},
    "periodic_disturbance": lambda d: {
        "gain": d.torque, "frequency": 0.5 * 30.0 ** d.between(0.0, 1.0), "phase": d.phase()},
    "position_dependent_friction": lambda d: {"magnitude": d.torque, "phase": d.phase()},
    "presliding_friction": lambda d: {"magnitude": d.torque, "give": d.between(0.02, 0.08)},
    "quadratic_drag": lambda d: {"gain": d.torque / d.speed**2},
    "spring": lambda d: {"stiffness": d.torque / pi, "rest": d.between(-0.5, 0.5)},
    "sticky_sector": lambda d: {
        "magnitude": d.torque, "middle": d.reach * d.between(-1.0, 1.0), "half": d.between(0.15, 0.5)},
    "stribeck_friction": lambda d: {"magnitude": d.torque, "speed": d.speed * d.between(0.03, 0.15)},
    "supply_sag": lambda d: {"resistance": d.size, "time": d.between(0.002, 0.01)},
    "thermal_fade": lambda d: {"fade": d.size, "time": d.duration * d.between(0.15, 0.6)},
    "torque_ripple": lambda d: {
        "gain": d.torque, "order": _order(d), "phase": d.phase(), "at_motor": float(d.rng.integers(0, 2))},
    "viscous_asymmetry": lambda d: {"slant": 1.5 * d.size * d.rig.viscous_friction * d.either()},
    "other_angle_gain": lambda d: {"share": d.size, "phase": d.phase()},
    "other_brake_coast": lambda d: {"damping": 5.0 * d.size * d.rig.viscous_friction},
    "other_cubic_spring": lambda d: {
        "stiffness": d.torque / max(d.speed, 1.0) ** 3, "flat": d.speed * d.between(0.1, 0.4)},
    "other_duty_sign_cogging": lambda d: {
        "gain": d.torque, "order": _order(d), "phase": d.phase(), "side": d.either()},
    "other_speed_hump": lambda d: {
        "torque": d.torque, "speed": d.speed * d.between(0.3, 0.7), "width": d.speed * d.between(0.05, 0.12)},
    "other_warming_viscosity": lambda d: {
        "damping": 3.0 * d.size * d.rig.viscous_friction, "time": d.duration * d.between(0.1, 0.4)},
}  # fmt: skip

VOCABULARY = tuple(sorted(i for i in _EFFECTS if not i.startswith("other_")))
OUTSIDE = tuple(sorted(i for i in _EFFECTS if i.startswith("other_")))


def draw_effect(rng: np.random.Generator, id: str, rig: Rig, size: float, duration: float = 60.0) -> Concealed:
    """An effect of the given size, the rest of its parameters at random; size 0 is no effect at all.

    `size` is the effect's torque as a fraction of the drive's at 50 % duty. Where there is no torque to speak
    of, 0.3 is as large as such an effect gets on a real rig, and the effect is in proportion. That is a lag of
    60 ms, a delay of 30 ms, a coupling of 3 Hz, clipping at 40 % or an eccentricity of 30 mrad. Of a coupling the
    compliance is in proportion.
    """
    if id not in _EFFECTS:
        raise ValueError(f"no effect {id!r}; there are {', '.join(VOCABULARY + OUTSIDE)}")
    return Concealed(id, _EFFECTS[id](Drawing(rng, rig, size, duration)))


# ---- the MuJoCo model ----


@dataclass(frozen=True)
class Machine:
    """A compiled MuJoCo model; degrees of freedom: motor 0, link 1 and, with an elastic coupling, gear 2."""

    model: mujoco.MjModel
    step: float  # s
    inertia: tuple[float, ...]
    teeth_stiffness: float  # rad/s^2 per rad
    teeth_damping: float


def _contact(stiffness: float, damping: float, mobility: float, kind: str) -> str:
    # With an impedance this small MuJoCo's soft constraint is a plain one-sided spring and damper. With the
    # usual 0.9 and more it also cancels most of the load: the contact is stiffer at rest than it rings.
    reference = f"{-stiffness * mobility!r} {-damping * mobility!r}"
    return f'solref{kind}="{reference}" solimp{kind}="0.01 0.01 0.001 0.5 2"'


def build(rig: Rig, parameters: dict[str, Parameters], step: float = STEP) -> Machine:
    """Bodies, teeth, stops and coupling as MuJoCo elements; the laws above come in step by step."""
    share, motor_part = rig.motor_share, rig.motor_friction_share
    link = 1.0 - share
    stiffness = (TURN * rig.teeth_frequency) ** 2 * share * link
    damping = 2.0 * rig.teeth_damping * TURN * rig.teeth_frequency * share * link
    coupling = parameters.get("joint_elasticity", {"frequency": 0.0, "damping": 0.0})
    elastic = coupling["frequency"] > 0.0
    inertia = (share, link * (1.0 - GEAR_SHARE), link * GEAR_SHARE) if elastic else (share, link)
    viscous = (rig.viscous_friction * motor_part, rig.viscous_friction * (1.0 - motor_part), 0.0)

    bodies = []
    for name, own, drag in zip(("motor", "link", "gear"), inertia, viscous, strict=False):
        limit = ""
        if name == "link" and "end_stop" in parameters:
            stop = parameters["end_stop"]
            rate = sqrt(stop["stiffness"])
            limit = f'limited="true" range="{stop["low"]!r} {stop["high"]!r}" ' + _contact(
                stop["stiffness"], 2.0 * stop["damping"] * rate, 1.0 / own, "limit"
            )
        # MuJoCo's implicit damping divides by (J + h d): h d / 2 taken off J makes it the trapezoidal rule.
        armature = own - BODY_INERTIA - 0.5 * step * drag
        bodies.append(
            f'<body><inertial pos="0 0 0" mass="1" diaginertia="{" ".join([str(BODY_INERTIA)] * 3)}"/>'
            f'<joint name="{name}" axis="0 0 1" armature="{armature!r}" damping="{drag!r}" '
            # Dry friction stops a body within one step; it creeps at 1e-4 h of the acceleration it holds.
            f'solreffriction="0 {-1.0 / step!r}" solimpfriction="0.9999 0.9999 0.001 0.5 2" {limit}/></body>'
        )
    after = "gear" if elastic else "link"
    mobility = 1.0 / share + 1.0 / inertia[-1]
    half = 0.5 * rig.backlash
    tendons = [
        f'<fixed limited="true" range="{-half!r} {half!r}" {_contact(stiffness, damping, mobility, "limit")}>'
        f'<joint joint="motor" coef="1"/><joint joint="{after}" coef="-1"/></fixed>'
    ]
    if elastic:
        ahead, behind = share + inertia[2], inertia[1]
        rate = TURN * coupling["frequency"]
        stiff, loss = rate**2 * ahead * behind, 2.0 * coupling["damping"] * rate * ahead * behind
        tendons.append(
            f'<fixed stiffness="{stiff!r}" damping="{loss!r}" springlength="0">'
            f'<joint joint="gear" coef="1"/><joint joint="link" coef="-1"/></fixed>'
        )
    text = (
        f'<mujoco><compiler angle="radian"/><option timestep="{step!r}" gravity="0 0 0" integrator="Euler" '
        'iterations="30" tolerance="1e-10"><flag contact="disable" sensor="disable" equality="disable" '
        f'actuation="disable"/></option><worldbody>{"".join(bodies)}</worldbody>'
        f"<tendon>{''.join(tendons)}</tendon></mujoco>"
    )
    return Machine(mujoco.MjModel.from_xml_string(text), step, inertia, stiffness, damping)


def _mean_duty(time: Array, duty: Array, at: Array, delay: float, step: float) -> Array:
    """Mean of the held duty over the step centred on each instant of `at`.

    The engine's velocities live between its positions, so a kick stands for half a step on either side; the
    mean also makes any delay exact, whole steps or not.
    """
    edges = np.concatenate([time, [time[-1] + 2.0]])
    area = np.concatenate([[0.0], np.cumsum(duty * np.diff(edges))])
    bounds = np.concatenate([at - 0.5 * step, [at[-1] + 0.5 * step]]) - delay
    mean: Array = np.diff(np.interp(bounds, edges, area)) / step
    mean[np.abs(mean) < 1e-6] = 0.0  # rounding must not look like a duty that is not exactly zero
    return mean


@dataclass(frozen=True)
class Stepping:
    """How a rig is simulated: s at zero duty before the recording, begun at angle zero, and the internal step, s."""

    settle: float = SETTLE
    step: float = STEP


STEPPING = Stepping()


def simulate(
    rig: Rig,
    effects: Sequence[Concealed],
    time: Array,
    duty: Array,
    seed: int | None,
    stepping: Stepping = STEPPING,
) -> Simulated:
    """Play `duty` (n,) in percent, held from stamp to stamp of `time` (n,), on the rig with its effects.

    `seed` draws the process noise; None is none.
    Raises ValueError for an effect that is not known or there twice, and for one with a state of its own at any step
    but the usual one.
    """
    time, duty = np.asarray(time, dtype=float), np.asarray(duty, dtype=float)
    check(effects, VOCABULARY + OUTSIDE)
    parameters, step = {e.id: e.parameters for e in effects}, stepping.step
    if effects and step != STEP:
        raise ValueError("effects with a state of their own know only the usual step")

    machine = build(rig, parameters, step)
    before = round(stepping.settle / step)
    steps = before + int(np.ceil((time[-1] - time[0]) / step)) + 3
    # Half a step off, so that a duty that changes at a whole step changes between two kicks.
    at = (np.arange(steps) - before + 0.5) * step
    command = _mean_duty(time - time[0], duty, at, parameters.get("input_delay", {"time": 0.0})["time"], step)
    shaking = np.zeros((steps, 2))
    if seed is not None:
        process_noise = np.array([rig.motor_noise, rig.link_noise]) * (1.0 / sqrt(step))
        shaking = np.random.default_rng(seed).standard_normal((steps, 2)) * process_noise
    track = _run(rig, machine, parameters, at, command, shaking)

    # Column order: link angle, motor angle at the instant; link and motor speed half a step after; torque.
    stamps = time - time[0]
    link, motor = np.interp(stamps, at, track[:, 0]), np.interp(stamps, at, track[:, 1])
    link_speed = np.interp(stamps, at + 0.5 * step, track[:, 2])
    motor_speed = np.interp(stamps, at + 0.5 * step, track[:, 3])
    shift = parameters.get("encoder_eccentricity", {"amplitude": 0.0, "phase": 0.0})
    shown = link + shift["amplitude"] * np.sin(link + shift["phase"])
    counts = np.floor(shown * rig.counts_per_revolution / TURN + rig.encoder_phase).astype(np.int64)
    torque = np.interp(stamps, at, track[:, 4])
    per_turn = rig.counts_per_revolution
    return Simulated(time, duty, counts, shown, link, link_speed, motor, motor_speed, torque, per_turn)


def _run(
    rig: Rig, machine: Machine, parameters: dict[str, Parameters], at: Array, command: Array, shaking: Array
) -> Array:
    """Step the engine through, adding what the laws say; rows as `simulate` reads them."""
    model = machine.model
    data = mujoco.MjData(model)
    drive = [make(parameters[i], rig) for i, make in DRIVE.items() if i in parameters]
    gain = [make(parameters[i], rig) for i, make in GAIN.items() if i in parameters]
    on_motor = [make(parameters[i], rig) for i, make in MOTOR.items() if i in parameters]
    on_link = [make(parameters[i], rig) for i, make in LINK.items() if i in parameters]
    friction = [make(parameters[i], rig) for i, make in FRICTION.items() if i in parameters]
    change = parameters.get("load_change")
    c, forward, backward = rig.input_gain, rig.dead_band_forward, rig.dead_band_backward
    back_emf = BACK_EMF * rig.viscous_friction / rig.input_gain
    motor_part = rig.motor_friction_share
    half_gap, stiffness, damping = 0.5 * rig.backlash, machine.teeth_stiffness, machine.teeth_damping
    smooth = machine.step / 0.005  # oil and bearings follow the mean load of the teeth, not every knock

    track = np.empty((len(at), 5))
    angles, speeds, applied, dry = data.qpos, data.qvel, data.qfrc_applied, model.dof_frictionloss
    advance, s = mujoco.mj_step, State()
    for k, (now, duty, motor_shake, link_shake) in enumerate(
        zip(at.tolist(), command.tolist(), shaking[:, 0].tolist(), shaking[:, 1].tolist(), strict=True)
    ):
        places, rates = angles.tolist(), speeds.tolist()
        s.time, s.duty = now, duty
        s.motor_angle, s.angle = places[0], places[1]
        s.motor_speed, s.speed = rates[0], rates[1]
        for shape in drive:
            duty = shape(duty, s)
        s.current = duty - back_emf * s.motor_speed
        acting = duty - forward if duty > forward else duty + backward if duty < -backward else 0.0
        torque = c * acting
        for shape in gain:
            torque = shape(torque, s)
        motor, link = torque + motor_shake, link_shake
        for push in on_motor:
            motor += push(s)
        for push in on_link:
            link += push(s)
        if friction:
            twist = places[0] - places[-1]  # the last body is the one behind the teeth
            press = twist - half_gap if twist > half_gap else min(twist + half_gap, 0.0)
            load = stiffness * press + damping * (rates[0] - rates[-1]) if press else 0.0
            s.transmitted += smooth * ((load if load * press > 0.0 else 0.0) - s.transmitted)
            dry[0] = motor_part * sum([law(rates[0], s) for law in friction])
            dry[1] = (1.0 - motor_part) * sum([law(rates[1], s) for law in friction])
        if change and now >= change["time"]:
            model.dof_armature[1] += machine.inertia[1] * (change["factor"] - 1.0)
            mujoco.mj_setConst(model, mujoco.MjData(model))  # else the engine goes on with the mass matrix it has
            change = None
        applied[0], applied[1] = motor, link
        advance(model, data)
        track[k, :4] = places[1], places[0], speeds[1], speeds[0]
        track[k, 4] = torque
    return track
