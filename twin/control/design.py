"""From a model to a feedback-linearising tracking controller.

The inverse of the model's own laws turns the axis into a chain of integrators. The library python-control places that
chain's poles at the asked bandwidth, and designs the observer on the quantised encoder. The observer also estimates the
torque that the model lacks: that is the integral action. It knows the command that was really given, so it does not
wind up (Franklin, Powell, Workman, Digital Control of Dynamic Systems, 1998).
"""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np

from twin.codegen import control_law
from twin.control import linearization
from twin.control.controller import Controller, LimitCycle
from twin.errors import BadInput
from twin.model.fitted_model import Model
from twin.model.stepper import Structure

FAST = 4.0  # observer over loop
SLOW = 0.5  # integral action over loop
TOLERATED = 1.2  # error left alone at rest, where the loop would hunt, over the amplitude of its hunting
CALM = 0.3  # velocity gain over the loop's once it has hunted
CALM_ELASTIC = 0.12  # the same for compliant teeth, which throw the link back: more keeps it in motion
FULL_DRIVE = {"%": 100.0}
SPREAD_OF_NOISE = 0.03  # share of the limit that noise may take of the command
SLOWEST = 1e-5  # bandwidth over the sample rate: below, the sampled poles are one in double precision
SENSITIVE = 2.0  # largest sensitivity of a loop designed without an asked bandwidth
#: What nobody sees of what acts there.
_UNSEEN = {"bristle": "how far it is bent", "rider": "where it is in its swing"}
_TURN = np.linspace(0.0, 2.0 * math.pi, 25).tolist()  # places at one of which the motor is about at its weakest


def _cancelled(model: Model) -> Structure:
    """The structure of observer and inverse. It leaves out loads that depend on time, end stops, resonances beyond the
    loop, and effects with a motion of their own that no sensor sees.
    """
    left_out = []
    for effect in model.structure.effects:
        moment = effect.slot in ("load", "mass") and "time" in effect.depends_on
        rings = effect.station == "transmission" and "backlash" in effect.includes
        unseen = effect.slot in _UNSEEN or effect.station == "disturbance"
        if moment or rings or unseen or effect.id == "end_stop":
            left_out.append(effect.id)
    return model.structure.without(*left_out).with_("constant_offset")


def _joint(model: Model) -> linearization.Joint | None:
    """The slowest elastic element of the transmission."""
    v = model.values
    joints = [
        linearization.Joint(v[f"{kind}_frequency"], v[f"{kind}_damping"], v["motor_share"])
        for kind in ("joint", "tooth")
        if f"{kind}_frequency" in v
    ]
    return min(joints, key=lambda j: j.frequency, default=None)


def _limit(model: Model, asked: float | None) -> tuple[float, str]:
    """Largest command, and what to say where it is only assumed."""
    if asked is not None:
        if not (math.isfinite(asked) and asked > 0.0):
            raise BadInput(f"command limit is {asked:g}: give a number above 0, in {model.input_unit}")
        return asked, ""
    limit = min(FULL_DRIVE.get(model.input_unit, math.inf), model.values.get("saturation_limit", math.inf))
    if math.isfinite(limit):
        return limit, ""
    seen = model.provenance.get("largest_command", "")
    try:
        limit = float(seen)
    except ValueError:
        limit = math.nan
    if math.isfinite(limit) and limit > 0.0:
        return limit, f"limit: taken as the largest recorded command, {limit:.4g} {model.input_unit}."
    limit = 5.0 * _holding(model)
    return limit, (
        f"limit: the drive's largest command is not known; {limit:.4g} {model.input_unit} is assumed, five times "
        "what dead-band, friction and load take."
    )


def _holding(model: Model) -> float:
    """The command that moves the axis at one unit of speed against all that resists."""
    structure = _cancelled(model)
    law = control_law.functions(structure)
    p = [model.values.get(q.name, 0.0) for q in structure.parameters]
    moment = float(model.known.get("moment", 0.0))
    worst = 0.0
    for place in np.linspace(-math.pi, math.pi, 25):
        for side in (1.0, -1.0):
            pull = abs(law.load(place, 0.0, 0.0, moment, p) + law.drag(place, side, p))
            worst = max(worst, pull + law.grip(place, side, side, pull, 0.0, p))
    dead = max(model.values.get("dead_band_forward", 0.0), model.values.get("dead_band_reverse", 0.0))
    return max(worst / model.values["input_gain"] + dead, 1e-9)


def _reading_variance(model: Model) -> float:
    """Variance of one position reading; an identified spread has the counts in it."""
    if model.reads_speed:
        return 0.0
    return max(model.reading_std**2, model.resolution**2 / 12.0)


def _observer(model: Model, controller: Controller, rate: float) -> tuple[dict[str, float], float]:
    """Gains of the steady Kalman filter on position, velocity and unmodelled torque; the speed's spread.

    The filter is at least four times as fast as the loop, and its integral action half as fast. Where the model's own
    noise densities are too small for that, they are raised.
    """
    plant = replace(linearization.linearise(controller), lag_time=0.0)
    period = model.sample_time
    move, push = plant.over(period)
    a = np.block([[move, push[:, 1:]], [np.zeros((1, 2)), np.ones((1, 1))]])
    travel = controller.reachable_speed / rate if math.isfinite(controller.reachable_speed) else 1.0
    variance = max(_reading_variance(model), (1e-7 * travel) ** 2)
    density = variance * period
    torque = max(model.torque_density, density * (FAST * rate) ** 4)
    walk = torque * (SLOW * rate) ** 2
    noise = np.zeros((3, 3))
    noise[:2, :2] = torque * np.array([[period**3 / 3, period**2 / 2], [period**2 / 2, period]])
    noise[2, 2] = walk * period
    _, after, _ = control.dlqe(a, np.eye(3), np.array([[1.0, 0.0, 0.0]]), noise, np.array([[variance]]))
    before = a @ after @ a.T + noise
    gain = before[:, 0] / (before[0, 0] + variance)
    names = ("observer_position", "observer_velocity", "observer_disturbance")
    return dict(zip(names, map(float, gain), strict=True)), math.sqrt(float(after[1, 1]))


def _gains(controller: Controller, rate: float) -> dict[str, float]:
    """Poles of the chain of integrators at the asked rate, sampled with a hold; a faster lag keeps its own."""
    period, lag = controller.sample_time, controller.values.get("lag_time", 0.0)
    chain = linearization.Linear(0.0, 0.0, 1.0, lag, 1.0)
    a, b = chain.over(period)
    rates = [0.97 * rate, 1.03 * rate, *([1.06 * max(rate, 1.0 / lag)] if lag > 0.0 else [])]
    poles = np.exp(-period * np.array(rates))
    k = np.asarray(control.place(a, b[:, :1], poles)).ravel()
    return {
        "position_gain": float(k[0]),
        "velocity_gain": float(k[1]),
        "acceleration_gain": float(k[2]) if chain.order == 3 else 0.0,
    }


def _reach(controller: Controller) -> tuple[float, float]:
    """Speed and acceleration that full command holds against drag and dry friction, the weaker way."""
    law, p, k = controller.laws, controller.parameter_list, controller.known_list
    limit, gain = controller.settings["limit"], controller.values["input_gain"]
    damping = controller.values.get("viscous_friction", 0.0)
    total = 1.0 + max(law.mass(x, 0.0, k[0], p) for x in _TURN)

    def spare(speed: float, side: float) -> float:
        acts = min(side * law.drive(side * limit, side * damping * speed / gain, 0.0, x, p) for x in _TURN)
        return float(
            gain * acts
            + side * law.drag(0.0, side * speed, p)
            - law.grip(0.0, side * speed, side, 0.5 * gain * acts, 0.0, p)
        )

    acceleration = min(spare(0.0, side) for side in (1.0, -1.0)) / total
    speeds = []
    for side in (1.0, -1.0):
        low, high = 0.0, 1.0
        while spare(high, side) > 0.0 and high < 1e6:
            low, high = high, 2.0 * high
        for _ in range(50):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if spare(middle, side) > 0.0 else (low, middle)
        speeds.append(low if high < 1e6 else math.inf)
    return min(speeds), acceleration


def _own_rate(controller: Controller) -> float:
    """How fast the axis moves by itself, rad/s: friction or the pull of its load."""
    steep = [linearization.linearise(controller, place) for place in np.linspace(-math.pi, math.pi, 13)]
    return max(max(-s.damping, math.sqrt(abs(s.stiffness))) for s in steep)


def _tuned(model: Model, draft: Controller, bandwidth: float) -> Controller:
    """The draft with gains, observer and smoothing for one bandwidth."""
    rate = 2.0 * math.pi * bandwidth
    limit = draft.settings["limit"]
    gains, spread = _observer(model, draft, rate)
    settings = {**draft.settings, **_gains(draft, rate), **gains}
    settings["calming"] = (CALM_ELASTIC if model.structure.elastic else CALM) * settings["velocity_gain"]
    settings["rest_speed"] = max(3.0 * spread, 1e-9)
    tuned = replace(draft, bandwidth=bandwidth, settings=settings)
    noise = linearization.command_noise(tuned, _reading_variance(model), model.torque_density)
    settings["blur"] = max(2.0 * noise, 0.002 * limit) if math.isfinite(noise) else 0.1 * limit
    return replace(tuned, settings=settings, command_noise=noise)


def _ends(model: Model) -> tuple[float, float]:
    """Where the stops are."""
    if model.values.get("stop_stiffness", 0.0) <= 0.0:
        return -math.inf, math.inf
    return model.values["stop_lower"], model.values["stop_upper"]


def _draft(model: Model, limit: float) -> Controller:
    """Everything that does not depend on the bandwidth."""
    structure = _cancelled(model)
    # What the model lacks is the integral action, at the link.
    known = {"offset": 0.0, "shaft_share": 0.0, **model.values}
    values = {p.name: float(known.get(p.name, p.start)) for p in structure.parameters}
    period = model.sample_time
    delay = values.get("delay", 0.0)
    whole = math.floor(delay / period + 1e-9)
    settings = {
        "sample_time": period,
        "pieces": float(max(1, math.ceil(period / (0.002 / structure.substeps) - 1e-9))),
        "whole": float(whole),
        "part": max(delay - whole * period, 0.0),
        "resolution": 0.0 if model.reads_speed else model.resolution,
        "limit": limit,
        "position_gain": 1.0,
        "velocity_gain": 1.0,
        "acceleration_gain": 0.0,
        "observer_position": 0.0,
        "observer_velocity": 0.0,
        "observer_disturbance": 0.0,
        "rest_speed": 1.0,
        "blur": 1.0,
        "braking": 0.7,
        "hunting": 0.0,
        "calming": 0.0,
        "tolerance": 0.0,
    }
    known = {k: v for k, v in model.known.items() if k in ("payload", "moment")}
    draft = Controller(
        model.structure, structure, values, settings, known, model.axis_unit, model.input_unit, ends=_ends(model)
    )  # fmt: skip
    speed, acceleration = _reach(draft)
    if acceleration <= 0.0:
        raise BadInput(
            f"full command ({limit:g} {model.input_unit}) does not move this axis against its friction: "
            "allow a larger command, or check input_gain, friction and dead-band of the model"
        )
    return replace(draft, reachable_speed=speed, reachable_acceleration=acceleration)


def _sensible(model: Model, draft: Controller) -> tuple[float, str]:
    """A bandwidth in Hz and what sets it."""
    values, joint = draft.values, _joint(model)
    ceilings = {
        "the sample time": 0.15 / model.sample_time,
        "the delay": 0.5 / draft.latency,
        "the lag": 2.0 / values["lag_time"] if "lag_time" in values else math.inf,
        "the elastic joint": 2.0 * math.pi * joint.frequency / 3.0 if joint else math.inf,
        "the drive's strength": 10.0 * max(_own_rate(draft), draft.reachable_acceleration / draft.reachable_speed),
    }
    why = min(ceilings, key=lambda name: ceilings[name])
    bandwidth = ceilings[why] / (2.0 * math.pi)
    slowest = SLOWEST / model.sample_time
    while True:
        if not bandwidth >= slowest:
            raise BadInput(
                f"{why} would leave this axis a bandwidth below {slowest:.2g} Hz, which is no control at a sample time "
                f"of {model.sample_time:g} s: identify it again from a recording with more motion"
            )
        trial = _tuned(model, draft, bandwidth)
        if trial.command_noise > SPREAD_OF_NOISE * draft.settings["limit"]:
            why = "the sensor's resolution and the torque noise"
        elif not linearization.sensitivity(trial, joint) <= SENSITIVE:
            why = "the elastic joint" if joint else "the loop's robustness"
        else:
            break
        bandwidth *= 0.8
    return bandwidth, why


def _remarks(model: Model, controller: Controller) -> list[str]:
    """What is not cancelled, in sentences."""
    says = []
    for effect in model.structure.effects:
        if effect.id not in controller.structure and effect.station != "transmission":
            if effect.id == "end_stop":
                lower, upper = controller.ends
                says.append(
                    f"end_stop: a wall cannot be cancelled; references must stay between {lower:.4g} and "
                    f"{upper:.4g} {model.axis_unit}."
                )
            else:
                unknown = _UNSEEN.get(effect.slot, "its moment on the rig")
                says.append(
                    f"{effect.id}: {unknown} is not known, so it is not cancelled; "
                    "the integral action takes what it can."
                )
    for elastic, kind in (("joint_elasticity", "joint"), ("tooth_compliance", "tooth")):
        if elastic in model.structure:
            says.append(
                f"{elastic}: the ringing at {model.values[f'{kind}_frequency']:.3g} Hz is not damped actively; "
                "the loop stays below it."
            )
    if controller.values.get("backlash_gap", 0.0) > 0.0:
        says.append(
            f"backlash: in the gap of {controller.values['backlash_gap']:.3g} {model.axis_unit} the link is free; "
            "nothing cancels that."
        )
        if cycle := controller.limit_cycle:
            says.append(
                f"limit cycle: by its describing function the gap would let the loop hunt by {cycle.amplitude:.3g} "
                f"{model.axis_unit} at {cycle.frequency:.3g} Hz where neither load nor friction "
                f"holds the flank; there, and wherever it has swung three times at rest, errors below "
                f"{controller.settings['tolerance']:.3g} {model.axis_unit} are left alone."
            )
    limit = controller.settings["limit"]
    says.append(
        f"saturation: the command ends at {limit:.4g} {model.input_unit}, which reaches "
        f"{controller.reachable_speed:.3g} {model.axis_unit}/s and, from rest without load, "
        f"{controller.reachable_acceleration:.3g} {model.axis_unit}/s^2."
    )
    if controller.settings["whole"] + controller.settings["part"] > 0.0:
        says.append(
            "input_delay: bridged by prediction; a disturbance still acts unanswered for "
            f"{1e3 * controller.latency:.3g} ms."
        )
    if model.reads_speed:
        says.append("sensor: the rig logs only speed; the loop needs a position reading and assumes a perfect one.")
    return says


def design(model: Model, bandwidth: float | None = None, limit: float | None = None) -> Controller:
    """The controller for a model. `bandwidth` in Hz (None: chosen), `limit` the largest command.

    Raises BadInput for a bandwidth that the sample time, the delay or the loop's stability does not allow. Also for an
    axis that no command moves, and for a model whose input gain may be zero.
    """
    _check_gain(model)
    try:
        return _design(model, bandwidth, limit)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        said = " ".join(str(error).split())
        raise BadInput(
            f"no controller can be computed from these values ({said}): check the model's parameters, or identify it "
            "again"
        ) from error


def _check_gain(model: Model) -> None:
    """Raises BadInput where nothing moves the axis, or the model does not know which way."""
    gain, std = model.values["input_gain"], model.std("input_gain")
    if not gain > 0.0:
        raise BadInput(f"input_gain is {gain:g}: nothing moves this axis; identify it again")
    if 1.96 * std >= gain:
        raise BadInput(
            f"input_gain is not known ({gain:.3g} ± {std:.2g} {model.unit('input_gain')}), so feedback may have the "
            "wrong sign: identify it again from a recording with more motion"
        )


def _design(model: Model, bandwidth: float | None, limit: float | None) -> Controller:
    """The controller, once the gain is known."""
    largest, assumed = _limit(model, limit)
    draft = _draft(model, largest)
    says = [assumed] if assumed else []
    sensible, why = _sensible(model, draft)
    if bandwidth is None:
        bandwidth = sensible
        says.append(f"bandwidth: {bandwidth:.3g} Hz, set by {why}.")
    else:
        most, least = 0.1 / model.sample_time, SLOWEST / model.sample_time
        if not (math.isfinite(bandwidth) and bandwidth > 0.0):
            raise BadInput(f"bandwidth is {bandwidth:g} Hz: give a number above 0")
        if bandwidth > most:
            raise BadInput(
                f"bandwidth {bandwidth:g} Hz is beyond what a loop every {1e3 * model.sample_time:g} ms can do: "
                f"ask for at most {most:.3g} Hz"
            )
        if bandwidth < least:
            raise BadInput(
                f"bandwidth {bandwidth:g} Hz is too slow for a loop every {1e3 * model.sample_time:g} ms: ask for at "
                f"least {least:.2g} Hz, or for {sensible:.3g} Hz, which {why} allows"
            )
        if bandwidth > 1.2 * sensible:
            says.append(f"bandwidth: {bandwidth:.3g} Hz was asked for; {why} would set it at {sensible:.3g} Hz.")
    controller = _tuned(model, draft, bandwidth)
    margins = linearization.margins(controller, _joint(model))
    if not math.isfinite(margins.sensitivity):
        raise BadInput(
            f"bandwidth {bandwidth:g} Hz gives an unstable loop on this model: ask for {sensible:.3g} Hz or less "
            f"({why})"
        )
    cycle = _hunting(controller)
    settings = dict(controller.settings)
    if cycle is not None:
        settings["tolerance"] = TOLERATED * cycle.amplitude
        settings["hunting"] = cycle.amplitude * (2.0 * math.pi * cycle.frequency) ** 2
    controller = replace(controller, settings=settings, margins=margins, limit_cycle=cycle)
    return replace(controller, remarks=(*says, *_remarks(model, controller)))


def _hunting(controller: Controller) -> LimitCycle | None:
    """The limit cycle that the gap would cause in the linear loop."""
    values, law = controller.values, controller.laws
    held = min(law.grip(0.0, 0.0, side, 0.0, 0.0, controller.parameter_list) for side in (1.0, -1.0))
    share = 1.0 - values.get("dry_share", 0.0)
    gap = values.get("backlash_gap", 0.0)
    return linearization.limit_cycle(controller, gap, values.get("motor_share", 0.5), share * held)
