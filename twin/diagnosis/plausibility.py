"""Whether the values of a fitted effect still agree with its name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from twin.diagnosis import thresholds
from twin.estimation import parameter_bounds
from twin.estimation.fit import Fit
from twin.estimation.prepared_recording import PreparedRecording
from twin.estimation.problem import FitProblem

Rule = Callable[[Sequence[PreparedRecording], Mapping[str, float]], bool]


def _positions(cases: Sequence[PreparedRecording]) -> NDArray[np.float64]:
    return np.concatenate([c.positions for c in cases])


def _ripple(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """It has repeated."""
    return values["ripple_order"] * float(np.ptp(_positions(cases))) >= thresholds.MIN_REPEATS * 2.0 * math.pi


def _disturbance(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """It has repeated, moves more than rounding does, and comes from outside."""
    cycles = values["disturbance_frequency"] * max(float(c.drive.time[-1]) for c in cases)
    rate = 2.0 * math.pi * values["disturbance_frequency"]
    moved = abs(values["disturbance"]) / rate ** (1 if cases[0].drive.speed else 2)
    moves = any(moved > thresholds.MIN_WAVE_OF_COUNT * c.recording.resolution for c in cases)
    return (
        cycles >= thresholds.MIN_REPEATS
        and moves
        and all(_state_share(c, values) < thresholds.MAX_STATE_SHARE for c in cases)
    )


def _load(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """It was another before, and has been this one since."""
    ends = [float(c.drive.time[-1]) for c in cases]
    return any(
        thresholds.MIN_SHARE_OF_TIME * end < values["load_time"] < (1.0 - thresholds.MIN_SHARE_OF_TIME) * end
        for end in ends
    )


def _spring(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """It is more than a constant."""
    places = _positions(cases)
    middle = 0.5 * float(places.max() + places.min())
    return abs(values["spring_rest"] - middle) <= 2.0 * float(np.ptp(places))


def _joint(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """There is a motor on its one side, something on the other, and they swing."""
    least, most = parameter_bounds.bounds_of("motor_share")
    return (
        1.5 * least < values["motor_share"] < 1.0 - 1.5 * (1.0 - most)
        and values["joint_damping"] < thresholds.MAX_DAMPING_RATIO
    )


def _stribeck(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """Friction that falls with speed has two conditions. Readings can tell the speed within which it falls from rest.
    And an axis that is pushed by its static friction moves by a count before friction has fallen. Every dry contact
    gives by as much, and its presliding at a reversal looks like friction that is many times as large at rest.
    """
    least, _ = parameter_bounds.bounds_of("stribeck_velocity")
    speed, held = values["stribeck_velocity"], values["coulomb_friction"] + values["stribeck_friction"]
    told = min(c.recording.resolution / (1.0 if c.drive.speed else thresholds.CREEP_TIME) for c in cases)
    count = min((c.recording.resolution for c in cases if not c.drive.speed), default=0.0)
    return speed > max(2.0 * least, told) and speed**2 > 2.0 * held * count


def _fade(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """It takes gain away: what gives some is no heat."""
    return values["fade"] > 0.0


def _delay_rule(name: str) -> Rule:
    """What comes late is not lost between two readings."""
    return lambda cases, values: values[name] > thresholds.MIN_DELAY_OF_STEP * max(c.step for c in cases)


def _eccentricity(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """The encoder still shows about where the link is."""
    return values["eccentricity"] < thresholds.MAX_ECCENTRICITY


def _position_dependent_friction(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """It holds the link back on a good part of the way, not where the way ends: that is a stop."""
    wave = values["friction_variation"] * np.sin(_positions(cases) - values["friction_angle"])
    return float(np.mean(values["coulomb_friction"] + wave > 0.0)) > thresholds.MIN_FRICTION_SHARE


def _stop(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """It stops the link, which moves towards it. A stop that gives way further is a spring that stiffens. Where a
    recording begins, no stop has been reached.
    """
    places = _positions(cases)
    travel = float(np.ptp(places))
    deepest = max(float(places.max()) - values["stop_upper"], values["stop_lower"] - float(places.min()))
    depths = [
        sign * (case.positions - values[stop]) / travel
        for case in cases
        for stop, sign in (("stop_upper", 1.0), ("stop_lower", -1.0))
    ]
    met = [depth for depth in depths if depth.max() > 0.0]
    return deepest <= thresholds.MAX_GIVE * travel and (not met or any(_approaches_stop(depth) for depth in met))


def _approaches_stop(depth: NDArray[np.float64]) -> bool:
    """Whether the depths (N,) behind a stop, as shares of the travel, are not those of the beginning alone."""
    away = np.flatnonzero(depth < -thresholds.STOP_CLEARANCE)
    return len(away) > 0 and bool(np.any(depth[away[0] :] > 0.0))


def _presliding(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """It slides within the travel. Its presliding exceeds the encoder's count, and that of any dry contact."""
    seen = [thresholds.MIN_GIVE_ANGLE * c.recording.lever for c in cases]
    seen += [thresholds.MIN_GIVE_COUNTS * c.recording.resolution for c in cases if not c.drive.speed]
    return max(seen) < values["presliding_travel"] < thresholds.MAX_GIVE * float(np.ptp(_positions(cases)))


def _flexible_load(cases: Sequence[PreparedRecording], values: Mapping[str, float]) -> bool:
    """It is held loosely enough to be left behind: what is not is inertia of the link."""
    _, stiffest = parameter_bounds.bounds_of("flexible_load_stiffness")
    _, most = parameter_bounds.bounds_of("flexible_load_damping")
    return values["flexible_load_stiffness"] < stiffest / 1.5 and values["flexible_load_damping"] < most / 1.5


RULES: Mapping[str, Rule] = {
    "load_change": _load,
    "torque_ripple": _ripple,
    "periodic_disturbance": _disturbance,
    "spring": _spring,
    "joint_elasticity": _joint,
    "stribeck_friction": _stribeck,
    "thermal_fade": _fade,
    "motor_lag": _delay_rule("lag_time"),
    "input_delay": _delay_rule("delay"),
    "encoder_eccentricity": _eccentricity,
    "position_dependent_friction": _position_dependent_friction,
    "end_stop": _stop,
    "presliding_friction": _presliding,
    "flexible_load": _flexible_load,
}


def _implausible_effects(problem: FitProblem, point: Fit) -> set[str]:
    """The effects of the fit that are no longer what their names say. Those with a phase need a size, too."""
    phases = {e.id: e.screen.phase for e in point.structure.effects if e.screen is not None}
    flung = {
        effect for effect, phase in phases.items() if phase and not abs(point.values[phase]) < thresholds.MAX_PHASE
    }
    ruled = {
        effect
        for effect, rule in RULES.items()
        if effect in point.structure and not rule(problem.recordings, point.values)
    }
    pages = {
        e.id
        for e in point.structure.effects
        if e.plausible is not None and not any(e.plausible(point.values, c.recorded) for c in problem.recordings)
    }
    return flung | ruled | pages


def is_plausible(problem: FitProblem, point: Fit, before: Fit | None = None) -> bool:
    """Whether every effect of the fit still is what its name says, or was not so in the model before it either. A first
    model may contain an implausible effect because it was told to, such as a delay that does not exist. That is no
    argument against an addition.
    """
    bent = _implausible_effects(problem, point)
    return not bent or (before is not None and bent <= _implausible_effects(problem, before))


def _state_share(case: PreparedRecording, values: Mapping[str, float]) -> float:
    """The share of a periodic disturbance's wave that position and direction of motion predict along a recording.

    Where the motion itself is periodic, a disturbance with its period cannot be told from a torque that depends on the
    state. That torque is the likelier of the two.
    """
    if case.drive.speed:
        return 0.0
    time, y = case.drive.time, case.drive.measured
    seen = np.isfinite(y)
    time, y = time[seen], y[seen]
    wave = np.sin(2.0 * math.pi * values["disturbance_frequency"] * time - values["disturbance_phase"])
    place = np.searchsorted(np.unique(np.quantile(y, np.linspace(0.0, 1.0, 13)[1:-1])), y)
    label = 2 * place + (np.gradient(y, time) > 0.0)
    count = np.maximum(np.bincount(label), 1)
    mean = np.bincount(label, wave) / count
    spread = float(np.sum((wave - wave.mean()) ** 2))
    return 1.0 - float(np.sum((wave - mean[label]) ** 2)) / max(spread, 1e-300)
