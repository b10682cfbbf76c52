"""The loop made linear: what python-control is asked about gains, margins, noise and limit cycles.

States of the plant: position, velocity and, with a lag, the command behind it. Dry friction, dead-band and gap
are left out here: the controller undoes the first two, the third is the describing function's business.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import control
import numpy as np
import scipy.linalg
import scipy.optimize
from numpy.typing import NDArray

from twin.control.controller import Controller, LimitCycle, Margins
from twin.model.stepper import KNOWN

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Linear:
    """Accelerations per position, velocity, effective command, over the total inertia; lag_time 0: no lag."""

    stiffness: float
    damping: float
    gain: float
    lag_time: float
    inertia: float

    @property
    def order(self) -> int:
        return 3 if self.lag_time > 0.0 else 2

    def continuous(self) -> tuple[FloatArray, FloatArray]:
        """A (n, n) and B (n, 2): inputs are the effective command and a disturbing acceleration."""
        a, b = np.zeros((self.order, self.order)), np.zeros((self.order, 2))
        a[0, 1] = 1.0
        a[1, :2] = self.stiffness, self.damping
        b[1, 1] = 1.0
        if self.lag_time > 0.0:
            a[1, 2] = self.gain
            a[2, 2] = -1.0 / self.lag_time
            b[2, 0] = 1.0 / self.lag_time
        else:
            b[1, 0] = self.gain
        return a, b

    def over(self, span: float) -> tuple[FloatArray, FloatArray]:
        """Transition over a span with both inputs held."""
        return _over(*self.continuous(), span)


def _over(a: FloatArray, b: FloatArray, span: float) -> tuple[FloatArray, FloatArray]:
    n, inputs = b.shape
    block = np.zeros((n + inputs, n + inputs))
    block[:n, :n], block[:n, n:] = a * span, b * span
    whole = scipy.linalg.expm(block)
    return whole[:n, :n], whole[:n, n:]


def linearise(controller: Controller, position: float = 0.0) -> Linear:
    """The axis about rest at a position."""
    law, p = controller.laws, controller.parameter_list
    moment, payload = controller.known_list[list(KNOWN).index("moment")], controller.known_list[0]
    h = 1e-6
    total = 1.0 + law.mass(position, 0.0, payload, p)
    ahead, behind = (
        law.load(place, 0.0, 0.0, moment, p) + law.shaft(place, p) for place in (position + h, position - h)
    )
    stiffness = (ahead - behind) / (2 * h)
    # One-sided where the law has a corner at rest: the mean of both sides.
    damping = sum(
        law.load(position, s * h, 0.0, moment, p) + law.drag(position, s * h, p)
        if s > 0
        else -law.load(position, s * h, 0.0, moment, p) - law.drag(position, s * h, p)
        for s in (1, -1)
    ) / (2 * h)
    return Linear(
        stiffness / total,
        damping / total,
        controller.values["input_gain"] / total,
        controller.values.get("lag_time", 0.0),
        total,
    )


def _chain(linear: Linear, controller: Controller) -> Callable[[FloatArray, float], FloatArray]:
    """One sample of the linear controller: (state, reading) -> state. State: observer, disturbance, commands."""
    g, n = controller.settings, linear.order
    whole, part, period = int(g["whole"]), g["part"], g["sample_time"]
    first, rest = linear.over(part), linear.over(period - part)

    def carry(x: FloatArray, d: float, q: FloatArray, index: int) -> FloatArray:
        x = first[0] @ x + first[1] @ np.array([q[index + 1] if part else 0.0, d])
        return np.asarray(rest[0] @ x + rest[1] @ np.array([q[index], d]))

    def sample(state: FloatArray, reading: float) -> FloatArray:
        x, d, q = state[:n].copy(), float(state[n]), state[n + 1 :].copy()
        error = reading - x[0]
        x[0] += g["observer_position"] * error
        x[1] += g["observer_velocity"] * error
        d += g["observer_disturbance"] * error
        x = carry(x, d, q, whole)
        y = x.copy()
        for j in range(whole):
            y = carry(y, d, q, whole - 1 - j)
        if part:
            y = first[0] @ y + first[1] @ np.array([q[0], d])
        wish = -g["position_gain"] * y[0] - g["velocity_gain"] * y[1]
        free = linear.stiffness * y[0] + linear.damping * y[1] + d
        if linear.lag_time > 0.0:
            now = linear.gain * y[2] + free
            jump = wish - (1.0 + g["acceleration_gain"]) * now
            drift = linear.stiffness * y[1] + linear.damping * now
            command = y[2] + (jump - linear.lag_time * drift) / linear.gain
        else:
            command = (wish - free) / linear.gain
        return np.concatenate([x, [d, command], q[:-1]])

    return sample


def _matrices(function: Callable[[FloatArray, float], FloatArray], count: int) -> tuple[FloatArray, FloatArray]:
    """A and B of a linear map, by what it does to unit vectors."""
    zero = np.zeros(count)
    a = np.column_stack([function(unit, 0.0) for unit in np.eye(count)])
    return a, function(zero, 1.0)[:, None]


def controller_system(linear: Linear, controller: Controller) -> Any:
    """Reading -> command issued, as a python-control system."""
    count = linear.order + 3 + int(controller.settings["whole"])
    a, b = _matrices(_chain(linear, controller), count)
    c = np.zeros((1, count))
    c[0, linear.order + 1] = 1.0
    return control.ss(a, b, c, [[0.0]], controller.sample_time)


@dataclass(frozen=True)
class Joint:
    """The ringing of link against motor, which the controller leaves alone but its margins do not."""

    frequency: float  # Hz
    damping: float  # ratio
    motor_share: float  # of the inertia


def plant_system(linear: Linear, controller: Controller, joint: Joint | None = None) -> Any:
    """Command issued -> position of the link, sampled, with the input delay."""
    g, n = controller.settings, linear.order
    whole, part = int(g["whole"]), g["part"]
    a, b = linear.continuous()
    c = np.eye(1, n)
    if joint is not None:
        # The centre of mass moves as the rigid axis does; the twist rides on it.
        rate = 2.0 * math.pi * joint.frequency
        twist = np.array([[0.0, 1.0], [-(rate**2), -2.0 * joint.damping * rate]])
        a = scipy.linalg.block_diag(a, twist)
        b = np.vstack([b, np.zeros((2, 2))])
        if linear.lag_time > 0.0:
            a[n + 1, 2] = linear.gain / joint.motor_share
        else:
            b[n + 1, 0] = linear.gain / joint.motor_share
        c = np.concatenate([c, [[-joint.motor_share, 0.0]]], axis=1)
    order = len(a)
    first, rest = _over(a, b, part), _over(a, b, g["sample_time"] - part)

    def move(state: FloatArray, command: float) -> FloatArray:
        x, q = state[:order], np.concatenate([[command], state[order:]])
        x = first[0] @ x + first[1] @ np.array([q[whole + 1], 0.0])
        x = rest[0] @ x + rest[1] @ np.array([q[whole], 0.0])
        return np.concatenate([x, q[:-1]])

    sampled_a, sampled_b = _matrices(move, order + whole + 1)
    seen = np.concatenate([c, np.zeros((1, whole + 1))], axis=1)
    return control.ss(sampled_a, sampled_b, seen, [[0.0]], g["sample_time"])


def loop(controller: Controller, joint: Joint | None = None, true: Linear | None = None) -> Any:
    """The open loop at rest, broken at the plant's input, with negative feedback.

    `true` is the axis where it is not the one that the controller was designed for.
    """
    linear = linearise(controller)
    return -controller_system(linear, controller) * plant_system(true or linear, controller, joint)


def _response(open_loop: Any, controller: Controller, count: int) -> tuple[NDArray[np.complex128], FloatArray]:
    """Frequency response from a hundredth of the bandwidth to the Nyquist frequency, at rates in rad/s."""
    nyquist = math.pi / controller.sample_time
    omega = np.geomspace(1e-2 * min(2.0 * math.pi * controller.bandwidth, nyquist), 0.99 * nyquist, count)
    # All rates in one call; python-control asks for them one by one.
    z = np.exp(1j * omega * controller.sample_time)[:, None, None]
    states = np.linalg.solve(z * np.eye(open_loop.nstates) - open_loop.A, open_loop.B[None])
    return (open_loop.C @ states + open_loop.D)[:, 0, 0], omega


def stable(open_loop: Any) -> bool:
    return bool(np.max(np.abs(control.feedback(open_loop, 1).poles())) < 1.0)


def sensitivity(controller: Controller, joint: Joint | None = None) -> float:
    """The largest sensitivity of the sampled loop (NaN where it is unstable)."""
    open_loop = loop(controller, joint)
    if not stable(open_loop):
        return math.nan
    response, _ = _response(open_loop, controller, 2000)
    return float(np.max(1.0 / np.abs(1.0 + response)))


def margins(controller: Controller, joint: Joint | None = None) -> Margins:
    """Margins of the sampled loop (all NaN where it is unstable)."""
    largest = sensitivity(controller, joint)
    if math.isnan(largest):
        return Margins(math.nan, math.nan, math.nan, math.nan)
    response, omega = _response(loop(controller, joint), controller, 2000)
    gain, phase, _, _, crossover, _ = control.stability_margins(control.frd(response, omega))
    radians = math.radians(phase)
    return Margins(float(gain), radians, radians / float(crossover), largest)


def command_noise(controller: Controller, reading_variance: float, torque_density: float) -> float:
    """Standard deviation of the command that noise alone causes in the closed loop."""
    linear = linearise(controller)
    link, ruler = plant_system(linear, controller), controller_system(linear, controller)
    n, m = link.nstates, ruler.nstates
    a = np.block([[link.A, link.B @ ruler.C], [ruler.B @ link.C, ruler.A]])
    if np.max(np.abs(np.linalg.eigvals(a))) >= 1.0:
        return math.inf
    period = controller.sample_time
    noise = np.zeros((n + m, n + m))
    noise[0, 0] = torque_density * period**3 / 3.0
    noise[0, 1] = noise[1, 0] = torque_density * period**2 / 2.0
    noise[1, 1] = torque_density * period
    noise[n:, n:] = reading_variance * (ruler.B @ ruler.B.T)
    spread = scipy.linalg.solve_discrete_lyapunov(a, noise, method="bilinear")
    return math.sqrt(max(float((ruler.C @ spread[n:, n:] @ ruler.C.T)[0, 0]), 0.0))


class Gap(control.DescribingFunctionNonlinearity):  # type: ignore[misc]
    """Describing function of a gap between two bodies, for the torque that crosses it.

    The torque A_T sin(phi) changes sign. Then the motor (share s of the inertia) moves without contact until it has
    covered the gap g. This is at phi_1 with A (phi_1 - sin phi_1) = g, where A = A_T / (s w^2) is the amplitude of that
    motion. It lands without rebound and hands over the momentum s w A (1 - cos phi_1); from there both move as one. The
    fundamental of torque and impulse over A_T is a function of A / g alone.
    """

    def __init__(self, gap: float) -> None:
        self.gap = gap

    def describing_function(self, A: float) -> complex:
        if A * math.pi <= self.gap:
            return 0.0
        f = scipy.optimize.brentq(lambda x: A * (x - math.sin(x)) - self.gap, 0.0, math.pi)
        landing = 1.0 - math.cos(f)
        in_phase = 0.5 * (math.pi - f) + 0.25 * math.sin(2.0 * f) + landing * math.sin(f)
        ahead = -0.5 * math.sin(f) ** 2 + landing * math.cos(f)
        return 2.0 / math.pi * complex(in_phase, ahead)


def limit_cycle(controller: Controller, gap: float, motor_share: float, held: float) -> LimitCycle | None:
    """The hunting that a gap causes in a loop that takes no notice of it, by harmonic balance.

    `held` is the link's dry friction: where the swing's torque does not exceed it, the link sticks. Of several
    solutions the largest is the stable one: beyond it the gap matters less and the loop pulls inwards.
    """
    if gap <= 0.0:
        return None
    response, omega = _response(loop(controller), controller, 500)
    element = Gap(gap)
    flights = gap / math.pi * np.geomspace(1.0001, 300.0, 200)
    found = control.describing_function_response(
        control.frd(response, omega, smooth=True), element, flights, omega, refine=False
    )
    cycles = []
    for flight, rate in found.intersections:
        amplitude = motor_share * float(flight) * abs(element.describing_function(float(flight)))
        if amplitude * float(rate) ** 2 > held:
            cycles.append(LimitCycle(amplitude, float(rate) / (2.0 * math.pi)))
    return max(cycles, key=lambda c: c.amplitude, default=None)
