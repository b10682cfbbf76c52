"""The loops around the stepper: one recording through the model, with and without derivatives.

Plain Python in the stepper's language plus arrays; `twin.simulation.kernel` compiles this text together with the
generated functions, whose names it uses freely.

`predict` runs the model in innovation form. At each stamp it notes what the sensor should read. A Kalman filter's gains
then move the state towards what the sensor did read; without noise it is a free run. The filter knows whether motor and
link touch. In the gap each has its own uncertainty, and no sensor sees the motor. After a silence the filter restarts
at the reading, and has predicted nothing. The command is held from stamp to stamp and acts `delay` later; pieces
between edges are split so that none exceeds `longest`. `closed` simulates the rig's own loop: command = r * reference -
y * output - v * velocity, raised to the smallest that the loop gives, clipped at the largest.
"""

# mypy: ignore-errors
# ruff: noqa: F821

from __future__ import annotations

import numpy as np


def believing(noise, now, c):
    """The covariance where a filter begins, with link and motor as one, in units of a reading's variance.

    `c` (11,) holds the covariance of position and velocity: the link's (xx, xv, vv), the motor's, and that between them
    (xx, xv, vx, vv). Its last element is the time of the last reading. `noise` (4,) holds the density of the torque
    noise, the variances of position and velocity at the start, and the longest silence.
    """
    c[:] = 0.0
    c[0] = c[3] = c[6] = noise[1]
    c[2] = c[5] = c[9] = noise[2]
    c[10] = now


def spreading(c, h, damping, density, share, touching):
    """Move the covariance by the time h. Link and motor that touch are one body. What is then known is what was known
    of their centre of mass: an impact does not change it, whenever it happened. In the gap the motor, with `share` of
    the inertia, takes half of the torque noise. The link's noise there is that of contact, whatever its mass. If it
    grew as the link gets lighter, the filter would have no memory for a very light link, which would then be likely.
    """
    f = np.exp(-damping * h)
    g = h
    if damping * h > 1e-6:
        g = (1.0 - f) / damping
    if touching:
        other = 1.0 - share
        a = other * other * c[0] + 2.0 * other * share * c[6] + share * share * c[3]
        b = other * other * c[1] + other * share * (c[7] + c[8]) + share * share * c[4]
        v = other * other * c[2] + 2.0 * other * share * c[9] + share * share * c[5]
        c[0] = c[3] = c[6] = a + 2.0 * g * b + g * g * v + density * h * h * h / 3.0
        c[1] = c[4] = c[7] = c[8] = f * (b + g * v) + density * h * h / 2.0
        c[2] = c[5] = c[9] = f * f * v + density * h
        return
    for i in range(2):
        noise = density * h
        if i == 1:
            noise = 0.5 * noise / (share * share)
        b = c[3 * i + 1]
        v = c[3 * i + 2]
        c[3 * i] += 2.0 * g * b + g * g * v + noise * h * h / 3.0
        c[3 * i + 1] = f * (b + g * v) + noise * h / 2.0
        c[3 * i + 2] = f * f * v + noise
    c[6] += g * (c[7] + c[8]) + g * g * c[9]
    c[7] = f * (c[7] + g * c[9])
    c[8] = f * (c[8] + g * c[9])
    c[9] = f * f * c[9]


def correcting(c, speed, of_motor, seen, gain):
    """Fill `gain` (4,) for the link's and the motor's position and velocity. Return the variance of the next reading of
    the sensor, which is on the link or on the motor. The covariance learns from it if it is `seen`.
    """
    first = 1 if speed else 0
    if of_motor:
        gain[0] = c[6 + first]
        gain[1] = c[8 + first]
        gain[2] = c[3 + first]
        gain[3] = c[4 + first]
        spread = gain[2 + first] + 1.0
    else:
        gain[0] = c[first]
        gain[1] = c[first + 1]
        gain[2] = c[6 + 2 * first]
        gain[3] = c[7 + 2 * first]
        spread = gain[first] + 1.0
    if seen:
        for i in range(2):
            c[3 * i] -= gain[2 * i] * gain[2 * i] / spread
            c[3 * i + 1] -= gain[2 * i] * gain[2 * i + 1] / spread
            c[3 * i + 2] -= gain[2 * i + 1] * gain[2 * i + 1] / spread
        c[6] -= gain[0] * gain[2] / spread
        c[7] -= gain[0] * gain[3] / spread
        c[8] -= gain[1] * gain[2] / spread
        c[9] -= gain[1] * gain[3] / spread
    for i in range(4):
        gain[i] = gain[i] / spread
    return spread


def predict(time, command, measured, noise, speed, closed, law, x, p, k, longest, predicted, spread, pull, states):
    """Fill `predicted` and `spread` (N,) and, where they have rows, `pull` (N,) and `states` (N, states).

    `spread` is the expected variance of an innovation in units of the reading's. `pull` is the velocity that a unit of
    it adds to the centre of mass. `command` is filled where the loop is closed; `noise` as in `believing`.
    """
    count = len(time)
    x = numbers(x)
    p = numbers(p)
    k = numbers(k)
    density = noise[0]
    c = np.empty(11)
    gain = np.empty(4)
    believing(noise, time[0], c)
    half = 0.0
    share = 0.5
    if has.backlash:
        half = 0.5 * p.backlash_gap
        share = p.motor_share
    of_motor = False
    if has.motor_sensor:
        of_motor = True
    edge = 0
    delay = 0.0
    if has.input_delay:
        delay = p.delay
    # An edge within rounding of a stamp is on it: a piece of 1e-16 s would only upset what sticks.
    rounding = 1e-6 * longest
    for i in range(count):
        reading = x.position + sensor(x.position, x.gap, p)
        if speed:
            reading = x.velocity
            if has.motor_sensor:
                reading = x.motor_velocity
        predicted[i] = reading
        if len(states) > 0:
            for s in range(states.shape[1]):
                states[i, s] = x[s]
        if closed:
            u = law[0] * command[i] - law[1] * reading - law[2] * x.velocity
            if u > 0.0 and u < law[4]:
                u = law[4]
            elif u < 0.0 and u > -law[4]:
                u = -law[4]
            command[i] = min(max(u, -law[3]), law[3])
        error = measured[i] - reading
        seen = error == error
        spread[i] = 1.0
        if density > 0.0:
            if i > 0:
                touching = abs(x.gap) >= half * (1.0 - 1e-9)
                spreading(c, time[i] - time[i - 1], p.viscous_friction, density, share, touching)
            if seen and time[i] - c[10] > noise[3]:
                predicted[i] = np.nan
                if speed:
                    x.velocity = x.velocity + error
                    x.motor_velocity = x.motor_velocity + error
                else:
                    x.position = x.position + error
                error = 0.0
                believing(noise, time[i], c)
            spread[i] = correcting(c, speed, of_motor, seen, gain)
            if len(pull) > 0:
                pull[i] = (1.0 - share) * gain[1] + share * gain[3]
            if seen:
                c[10] = time[i]
                x.position = x.position + gain[0] * error
                x.velocity = x.velocity + gain[1] * error
                x.motor_velocity = x.motor_velocity + gain[3] * error
                if abs(x.gap) < half:
                    # A correction brings the motor to the flank at most, never into it.
                    x.gap = min(max(x.gap + (gain[2] - gain[0]) * error, -half), half)
        if i == count - 1:
            break
        now = time[i]
        end = time[i + 1]
        while now < end:
            while edge < i and time[edge + 1] + delay <= now + rounding:
                edge += 1
            until = end
            if edge < i and time[edge + 1] + delay < end - rounding:
                until = time[edge + 1] + delay
            acting = command[edge]
            if time[edge] + delay > now + rounding:
                acting = 0.0
                if time[edge] + delay < until:
                    until = time[edge] + delay
            span = until - now
            pieces = 1
            if span > longest:
                pieces = int(span / longest + 0.999999)
                span = span / pieces
            for _ in range(pieces):
                if has.common:
                    step_common(x, p, k, acting, span)
                else:
                    step(x, p, k, acting, span)
            now = until
    return 0.0


def predict_t(
    time,
    command,
    measured,
    noise,
    speed,
    closed,
    law,
    x,
    xd,
    p,
    pd,
    k,
    longest,
    begin,
    c,
    predicted,
    spread,
    slopes,
    first,
    commands,
):
    """As `predict` from stamp `begin` on for as many as `predicted` has room, with the derivative of what the sensor
    should read in row `i * stride + first` of `slopes`. `x`, `xd` and `c` are left as they are for the next stamp.

    `slopes` is (room, stride, WIDTH), `commands` (N or 1, WIDTH) holds the derivative of the loop's own command.
    Gains are followed as they are: that they themselves depend on the parameters is left out.
    """
    count = len(time)
    x = numbers(x)
    p = numbers(p)
    k = numbers(k)
    states = len(xd)
    xd = numbers(xd)
    pd = numbers(pd)
    density = noise[0]
    gain = np.empty(4)
    if begin == 0:
        believing(noise, time[0], c)
    half = 0.0
    d_half = zero()
    share = 0.5
    if has.backlash:
        half = 0.5 * p.backlash_gap
        d_half = 0.5 * row(pd, index.backlash_gap)
        share = p.motor_share
    of_motor = False
    if has.motor_sensor:
        of_motor = True
    edge = 0
    delay = 0.0
    rounding = 1e-6 * longest
    d_delay = zero()
    if has.input_delay:
        delay = p.delay
        d_delay = row(pd, index.delay)
    for i in range(begin, begin + len(predicted)):
        offset, d_offset = sensor_t(x.position, row(xd, 0), x.gap, row(xd, 2), x, xd, p, pd, k)
        reading = x.position + offset
        d_reading = row(xd, 0) + d_offset
        if speed:
            reading = x.velocity
            d_reading = row(xd, 1)
            if has.motor_sensor:
                reading = x.motor_velocity
                d_reading = row(xd, 3)
        predicted[i - begin] = reading
        put(slopes, (i - begin) * slopes.shape[1] + first, d_reading)
        if closed:
            u = law[0] * command[i] - law[1] * reading - law[2] * x.velocity
            put(commands, i, -law[1] * d_reading - law[2] * row(xd, 1))
            if u > law[3] or u < -law[3] or (u < law[4] and u > -law[4]):
                put(commands, i, zero())
            if u > 0.0 and u < law[4]:
                u = law[4]
            elif u < 0.0 and u > -law[4]:
                u = -law[4]
            command[i] = min(max(u, -law[3]), law[3])
        error = measured[i] - reading
        seen = error == error
        spread[i - begin] = 1.0
        if density > 0.0:
            if i > 0:
                touching = abs(x.gap) >= half * (1.0 - 1e-9)
                spreading(c, time[i] - time[i - 1], p.viscous_friction, density, share, touching)
            if seen and time[i] - c[10] > noise[3]:
                predicted[i - begin] = np.nan
                if speed:
                    x.velocity = x.velocity + error
                    x.motor_velocity = x.motor_velocity + error
                    put(xd, 1, row(xd, 1) - d_reading)
                    put(xd, 3, row(xd, 3) - d_reading)
                else:
                    x.position = x.position + error
                    put(xd, 0, row(xd, 0) - d_reading)
                error = 0.0
                d_reading = zero()
                believing(noise, time[i], c)
            spread[i - begin] = correcting(c, speed, of_motor, seen, gain)
            if seen:
                c[10] = time[i]
                x.position = x.position + gain[0] * error
                x.velocity = x.velocity + gain[1] * error
                x.motor_velocity = x.motor_velocity + gain[3] * error
                put(xd, 0, row(xd, 0) - gain[0] * d_reading)
                put(xd, 1, row(xd, 1) - gain[1] * d_reading)
                put(xd, 3, row(xd, 3) - gain[3] * d_reading)
                if abs(x.gap) < half:
                    moved = x.gap + (gain[2] - gain[0]) * error
                    x.gap = min(max(moved, -half), half)
                    put(xd, 2, row(xd, 2) - (gain[2] - gain[0]) * d_reading)
                    if moved > half:
                        put(xd, 2, d_half)
                    if moved < -half:
                        put(xd, 2, -1.0 * d_half)
        if i == count - 1:
            break
        now = time[i]
        end = time[i + 1]
        d_now = zero()
        while now < end:
            while edge < i and time[edge + 1] + delay <= now + rounding:
                edge += 1
            until = end
            d_until = zero()
            if edge < i and time[edge + 1] + delay < end - rounding:
                until = time[edge + 1] + delay
                d_until = d_delay
            acting = command[edge]
            d_acting = zero()
            if closed:
                d_acting = row(commands, edge)
            if time[edge] + delay > now + rounding:
                acting = 0.0
                d_acting = zero()
                if time[edge] + delay < until:
                    until = time[edge] + delay
                    d_until = d_delay
            span = until - now
            d_span = d_until - d_now
            pieces = 1
            if span > longest:
                pieces = int(span / longest + 0.999999)
                span = span / pieces
                d_span = (1.0 / pieces) * d_span
            for _ in range(pieces):
                if has.common:
                    step_t_common(acting, d_acting, span, zero(), x, xd, p, pd, k)
                else:
                    step_t(acting, d_acting, span, d_span, x, xd, p, pd, k)
            now = until
            d_now = d_until
        # At rest the filter forgets what the parameters have done before, by a factor with each reading.
        for s in range(states):
            put(xd, s, settled(row(xd, s)))
    return 0.0
