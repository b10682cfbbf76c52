"""The loops around the stepper: one recording through the model, with and without derivatives.

Plain Python in the stepper's language plus arrays; `twin.kernel` compiles this text together with the
generated functions, whose names it uses freely.

`predict` runs the model in innovation form. At each stamp it notes what the sensor should read, then moves the
state towards what it did read by the gains of a Kalman filter; gains of zero give a free run. The command is
held from stamp to stamp and acts `delay` later; pieces between edges are split so that none exceeds `longest`.
`closed` simulates the rig's own loop: command = r * reference - y * output - v * velocity, clipped at `limit`.
"""

# mypy: ignore-errors
# ruff: noqa: F821

from __future__ import annotations

import numpy as np


def predict(time, command, measured, gains, speed, closed, law, x, p, k, longest, predicted, states):
    """Fill `predicted` (N,) and, where it has rows, `states` (N, states); `command` is filled where closed."""
    count = len(time)
    edge = 0
    delay = 0.0
    if has.input_delay:
        delay = p.delay
    for i in range(count):
        reading = x.velocity if speed else x.position + sensor(x.position, p)
        predicted[i] = reading
        if len(states) > 0:
            for s in range(len(x)):
                states[i, s] = x[s]
        if closed:
            u = law[0] * command[i] - law[1] * reading - law[2] * x.velocity
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
            while edge < i and time[edge + 1] + delay <= now:
                edge += 1
            until = end
            if edge < i and time[edge + 1] + delay < end:
                until = time[edge + 1] + delay
            acting = command[edge]
            if time[edge] + delay > now:
                acting = 0.0
                if time[edge] + delay < until:
                    until = time[edge] + delay
            pieces = int((until - now) / longest + 0.999999)
            if pieces < 1:
                pieces = 1
            for _ in range(pieces):
                step(x, p, k, acting, (until - now) / pieces)
            now = until
    return 0.0


def predict_t(
    time,
    command,
    measured,
    gains,
    speed,
    closed,
    law,
    x,
    xd,
    p,
    col,
    k,
    n,
    longest,
    predicted,
    slopes,
    w,
    commands,
):
    """As `predict`, with `slopes` (N, n): the derivative of what the sensor should read."""
    count = len(time)
    edge = 0
    delay = 0.0
    late = -1
    if has.input_delay:
        delay = p.delay
        late = col[index.delay]
    for i in range(count):
        for j in range(n):
            w[row.sensor_position, j] = xd[0, j]
        offset = sensor_t(x.position, x, xd, p, col, k, w, n)
        reading = x.velocity if speed else x.position + offset
        predicted[i] = reading
        for j in range(n):
            slopes[i, j] = xd[1, j] if speed else xd[0, j] + w[row.sensor_return, j]
        if closed:
            u = law[0] * command[i] - law[1] * reading - law[2] * x.velocity
            for j in range(n):
                commands[i, j] = -law[1] * slopes[i, j] - law[2] * xd[1, j]
                if u > law[3] or u < -law[3]:
                    commands[i, j] = 0.0
            command[i] = min(max(u, -law[3]), law[3])
        error = measured[i] - reading
        if error == error:
            x.position = x.position + gains[i, 0] * error
            x.velocity = x.velocity + gains[i, 1] * error
            x.motor_velocity = x.motor_velocity + gains[i, 1] * error
            for j in range(n):
                xd[0, j] -= gains[i, 0] * slopes[i, j]
                xd[1, j] -= gains[i, 1] * slopes[i, j]
                xd[3, j] -= gains[i, 1] * slopes[i, j]
        if i == count - 1:
            break
        now = time[i]
        end = time[i + 1]
        slip = 0.0
        while now < end:
            while edge < i and time[edge + 1] + delay <= now:
                edge += 1
            until = end
            later = 0.0
            if edge < i and time[edge + 1] + delay < end:
                until = time[edge + 1] + delay
                later = 1.0
            acting = command[edge]
            held = edge
            if time[edge] + delay > now:
                acting = 0.0
                held = -1
                if time[edge] + delay < until:
                    until = time[edge] + delay
                    later = 1.0
            pieces = int((until - now) / longest + 0.999999)
            if pieces < 1:
                pieces = 1
            for _ in range(pieces):
                for j in range(n):
                    w[row.step_h, j] = 0.0
                    w[row.step_command, j] = 0.0
                if late >= 0:
                    w[row.step_h, late] = (later - slip) / pieces
                if closed and held >= 0:
                    for j in range(n):
                        w[row.step_command, j] = commands[held, j]
                step_t(acting, (until - now) / pieces, x, xd, p, col, k, w, n)
            now = until
            slip = later
    return 0.0


def riccati(time, measured, damping, density, speed, start, gains, spread):
    """Kalman gains (N, 2) and innovation variances (N,) of an axis with viscous damping and white torque noise.

    Variances are in units of the reading's own variance; `density` is that of the torque noise in the same
    units; `start` holds the variances of position and velocity at the first stamp.
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
            a = a + 2.0 * g * b + g * g * c + density * h * h * h / 3.0
            b = f * (b + g * c) + density * h * h / 2.0
            c = f * f * c + density * h
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
