"""The loops around the stepper: one recording through the model, with and without derivatives.

Plain Python in the stepper's language plus arrays; `twin.kernel` compiles this text together with the
generated functions, whose names it uses freely.

`predict` runs the model in innovation form. At each stamp it notes what the sensor should read, then moves the
state towards what it did read by the gains of a Kalman filter; gains of zero give a free run. The command is
held from stamp to stamp and acts `delay` later; pieces between edges are split so that none exceeds `longest`.
`closed` simulates the rig's own loop: command = r * reference - y * output - v * velocity, raised to
the smallest that the loop gives, clipped at the largest.
"""

# mypy: ignore-errors
# ruff: noqa: F821

from __future__ import annotations

import numpy as np


def predict(time, command, measured, gains, speed, closed, law, x, p, k, longest, predicted, states):
    """Fill `predicted` (N,) and, where it has rows, `states` (N, states); `command` is filled where closed."""
    count = len(time)
    x = numbers(x)
    p = numbers(p)
    k = numbers(k)
    edge = 0
    delay = 0.0
    if has.input_delay:
        delay = p.delay
    # An edge within rounding of a stamp is on it: a piece of 1e-16 s would only upset what sticks.
    rounding = 1e-6 * longest
    for i in range(count):
        reading = x.velocity if speed else x.position + sensor(x.position, p)
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
        if error == error:
            x.position = x.position + gains[i, 0] * error
            x.velocity = x.velocity + gains[i, 1] * error
            x.motor_velocity = x.motor_velocity + gains[i, 1] * error
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
    time, command, measured, gains, speed, closed, law, x, xd, p, pd, k, longest, begin, predicted, slopes, first,
    commands,
):
    """As `predict` from stamp `begin` on for as many as `predicted` has room, with the derivative of what the sensor
    should read in row `i * stride + first` of `slopes`. `x` and `xd` are left as they are for the next stamp.

    `slopes` is (room, stride, 8), `commands` (N or 1, 8) holds the derivative of the loop's own command.
    """
    count = len(time)
    x = numbers(x)
    p = numbers(p)
    k = numbers(k)
    xd = numbers(xd)
    pd = numbers(pd)
    edge = 0
    delay = 0.0
    rounding = 1e-6 * longest
    d_delay = zero()
    if has.input_delay:
        delay = p.delay
        d_delay = row(pd, index.delay)
    for i in range(begin, begin + len(predicted)):
        offset, d_offset = sensor_t(x.position, row(xd, 0), x, xd, p, pd, k)
        reading = x.position + offset
        d_reading = row(xd, 0) + d_offset
        if speed:
            reading = x.velocity
            d_reading = row(xd, 1)
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
        if error == error:
            x.position = x.position + gains[i, 0] * error
            x.velocity = x.velocity + gains[i, 1] * error
            x.motor_velocity = x.motor_velocity + gains[i, 1] * error
            put(xd, 0, row(xd, 0) - gains[i, 0] * d_reading)
            put(xd, 1, row(xd, 1) - gains[i, 1] * d_reading)
            put(xd, 3, row(xd, 3) - gains[i, 1] * d_reading)
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
    return 0.0


def riccati(time, measured, damping, density, speed, start, gains, spread):
    """Kalman gains (N, 2) and innovation variances (N,) of an axis with viscous damping and white torque noise.

    Variances are in units of the reading's own variance; `density` (N,) is that of the torque noise before each stamp
    in the same units; `start` holds the variances of position and velocity at the first stamp.
    """
    a = start[0]
    b = 0.0
    c = start[1]
    for i in range(len(time)):
        if i > 0:
            h = time[i] - time[i - 1]
            f = np.exp(-damping * h)
            g = h
            if damping * h > 1e-6:
                g = (1.0 - f) / damping
            a = a + 2.0 * g * b + g * g * c + density[i] * h * h * h / 3.0
            b = f * (b + g * c) + density[i] * h * h / 2.0
            c = f * f * c + density[i] * h
        seen = c if speed else a
        spread[i] = seen + 1.0
        gains[i, 0] = 0.0
        gains[i, 1] = 0.0
        if measured[i] == measured[i]:
            first = b if speed else a
            second = c if speed else b
            gains[i, 0] = first / spread[i]
            gains[i, 1] = second / spread[i]
            a -= gains[i, 0] * first
            if speed:
                b -= gains[i, 0] * second
            else:
                b -= gains[i, 1] * first
            c -= gains[i, 1] * second
    return 0.0
