"""The loops around the stepper: one recording through the model, with and without derivatives.

Plain Python in the stepper's language plus arrays; `twin.simulation.kernel` compiles this text together with the
generated functions, whose names it uses freely. Functions that take `s` are sections of the loops
(`twin.codegen.sections`).

`predict` runs the model in innovation form. At each stamp it notes what the sensor should read. A Kalman filter's gains
then move the state towards what the sensor did read; without noise it is a free run. The filter knows whether motor and
link touch. In the gap each has its own uncertainty, and no sensor sees the motor. After a silence the filter restarts
at the reading, and has predicted nothing. The command is held from stamp to stamp and acts `delay` later; pieces
between edges are split so that none exceeds `longest`. `closed` simulates the rig's own loop: command = r * reference -
y * output - v * velocity, raised to the smallest that the loop gives, clipped at the largest.
"""

# mypy: ignore-errors
# ruff: noqa: F821, F841

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


def shares_in_filter(p, s):
    """What of the axis the filter knows: half the gap, the motor's share of the inertia, where the sensor is."""
    s.half = 0.0
    s.share = 0.5
    if has.backlash:
        s.half = 0.5 * p.backlash_gap
        s.share = p.motor_share
    s.of_motor = False
    if has.motor_sensor:
        s.of_motor = True


def expected_reading(x, p, speed, s):
    """What the sensor should read."""
    s.reading = x.position + sensor(x.position, x.gap, p)
    if speed:
        s.reading = x.velocity
        if has.motor_sensor:
            s.reading = x.motor_velocity


def limited_command(law, s):
    """The loop's own command, raised to the least that it gives and clipped at the most."""
    if s.u > 0.0 and s.u < law[4]:
        s.u = law[4]
    elif s.u < 0.0 and s.u > -law[4]:
        s.u = -law[4]
    s.u = min(max(s.u, -law[3]), law[3])


def prior(time, noise, c, x, p, s):
    """Move the covariance on to this stamp, and say whether the silence before it was too long."""
    if s.i > 0:
        touching = abs(x.gap) >= s.half * (1.0 - 1e-9)
        spreading(c, time[s.i] - time[s.i - 1], p.viscous_friction, noise[0], s.share, touching)
    s.afresh = s.seen and time[s.i] - c[10] > noise[3]


def begin_at_reading(time, noise, c, x, speed, s):
    """After a silence: begin anew at what was read."""
    if speed:
        x.velocity = x.velocity + s.error
        x.motor_velocity = x.motor_velocity + s.error
    else:
        x.position = x.position + s.error
    s.error = 0.0
    believing(noise, time[s.i], c)


def corrected_states(time, c, gain, x, s):
    """Move the state towards what was read."""
    c[10] = time[s.i]
    x.position = x.position + gain[0] * s.error
    x.velocity = x.velocity + gain[1] * s.error
    x.motor_velocity = x.motor_velocity + gain[3] * s.error
    s.free = abs(x.gap) < s.half
    if s.free:
        # A correction brings the motor to the flank at most, never into it.
        s.moved = x.gap + (gain[2] - gain[0]) * s.error
        x.gap = min(max(s.moved, -s.half), s.half)


def next_edge(time, command, s):
    """The command that acts now, and until when; `at_edge` where that is for an edge of the command."""
    while s.edge < s.i and time[s.edge + 1] + s.delay <= s.now + s.rounding:
        s.edge += 1
    s.until = s.end
    s.at_edge = False
    if s.edge < s.i and time[s.edge + 1] + s.delay < s.end - s.rounding:
        s.until = time[s.edge + 1] + s.delay
        s.at_edge = True
    s.acting = command[s.edge]
    s.driven = True
    if time[s.edge] + s.delay > s.now + s.rounding:
        s.acting = 0.0
        s.driven = False
        if time[s.edge] + s.delay < s.until:
            s.until = time[s.edge] + s.delay
            s.at_edge = True


def predict(time, command, measured, noise, speed, closed, law, x, p, k, longest, predicted, spread, pull, states):
    """Fill `predicted` and `spread` (N,) and, where they have rows, `pull` (N,) and `states` (N, states).

    `spread` is the expected variance of an innovation in units of the reading's. `pull` is the velocity that a unit of
    it adds to the centre of mass. `command` is filled where the loop is closed; `noise` as in `believing`.
    """
    count = len(time)
    x = numbers(x)
    p = numbers(p)
    k = numbers(k)
    c = np.empty(11)
    gain = np.empty(4)
    believing(noise, time[0], c)
    shares_in_filter(p, s)
    edge = 0
    delay = 0.0
    if has.input_delay:
        delay = p.delay
    # An edge within rounding of a stamp is on it: a piece of 1e-16 s would only upset what sticks.
    rounding = 1e-6 * longest
    for i in range(count):
        expected_reading(x, p, speed, s)
        predicted[i] = reading
        if len(states) > 0:
            for state in range(states.shape[1]):
                states[i, state] = x[state]
        if closed:
            u = law[0] * command[i] - law[1] * reading - law[2] * x.velocity
            limited_command(law, s)
            command[i] = u
        error = measured[i] - reading
        seen = error == error
        spread[i] = 1.0
        if noise[0] > 0.0:
            prior(time, noise, c, x, p, s)
            if afresh:
                predicted[i] = np.nan
                begin_at_reading(time, noise, c, x, speed, s)
            spread[i] = correcting(c, speed, of_motor, seen, gain)
            if len(pull) > 0:
                pull[i] = (1.0 - share) * gain[1] + share * gain[3]
            if seen:
                corrected_states(time, c, gain, x, s)
        if i == count - 1:
            break
        now = time[i]
        end = time[i + 1]
        while now < end:
            next_edge(time, command, s)
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


def reading_and_slope(x, xd, p, pd, k, speed, s):
    """What the sensor should read, and its derivative."""
    offset, d_offset = sensor_t(x.position, row(xd, 0), x.gap, row(xd, 2), x, xd, p, pd, k)
    s.reading = x.position + offset
    s.d_reading = row(xd, 0) + d_offset
    if speed:
        s.reading = x.velocity
        s.d_reading = row(xd, 1)
        if has.motor_sensor:
            s.reading = x.motor_velocity
            s.d_reading = row(xd, 3)


def command_and_slope(command, commands, law, x, xd, s):
    """The loop's own command, and its derivative: none where it is at a limit."""
    s.u = law[0] * command[s.i] - law[1] * s.reading - law[2] * x.velocity
    put(commands, s.i, -law[1] * s.d_reading - law[2] * row(xd, 1))
    if s.u > law[3] or s.u < -law[3] or (s.u < law[4] and s.u > -law[4]):
        put(commands, s.i, zero())
    limited_command(law, s)
    command[s.i] = s.u


def begin_slopes_at_reading(xd, speed, s):
    """The derivative where the filter begins anew."""
    if speed:
        put(xd, 1, row(xd, 1) - s.d_reading)
        put(xd, 3, row(xd, 3) - s.d_reading)
    else:
        put(xd, 0, row(xd, 0) - s.d_reading)
    s.d_reading = zero()


def corrected_slopes(gain, xd, s):
    """The derivative of what `corrected_states` does, gains apart."""
    put(xd, 0, row(xd, 0) - gain[0] * s.d_reading)
    put(xd, 1, row(xd, 1) - gain[1] * s.d_reading)
    put(xd, 3, row(xd, 3) - gain[3] * s.d_reading)
    if s.free:
        put(xd, 2, row(xd, 2) - (gain[2] - gain[0]) * s.d_reading)
        if s.moved > s.half:
            put(xd, 2, s.d_half)
        if s.moved < -s.half:
            put(xd, 2, -1.0 * s.d_half)


def advance_with_slopes(time, command, commands, closed, longest, x, xd, p, pd, k, s):
    """Move state and derivative from this stamp to the next."""
    s.now = time[s.i]
    s.end = time[s.i + 1]
    d_now = zero()
    while s.now < s.end:
        next_edge(time, command, s)
        d_until = zero()
        if s.at_edge:
            d_until = s.d_delay
        d_acting = zero()
        if closed and s.driven:
            d_acting = row(commands, s.edge)
        span = s.until - s.now
        d_span = d_until - d_now
        pieces = 1
        if span > longest:
            pieces = int(span / longest + 0.999999)
            span = span / pieces
            d_span = (1.0 / pieces) * d_span
        for _ in range(pieces):
            if has.common:
                step_t_common(s.acting, d_acting, span, zero(), x, xd, p, pd, k)
            else:
                step_t(s.acting, d_acting, span, d_span, x, xd, p, pd, k)
        s.now = s.until
        d_now = d_until


def predict_t(
    time, command, measured, noise, speed, closed, law, x, xd, p, pd, k, longest, begin, c, predicted, spread, slopes,
    first, commands,
):  # fmt: skip
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
    gain = np.empty(4)
    if begin == 0:
        believing(noise, time[0], c)
    shares_in_filter(p, s)
    d_half = zero()
    if has.backlash:
        d_half = 0.5 * row(pd, index.backlash_gap)
    edge = 0
    delay = 0.0
    rounding = 1e-6 * longest
    d_delay = zero()
    if has.input_delay:
        delay = p.delay
        d_delay = row(pd, index.delay)
    for i in range(begin, begin + len(predicted)):
        reading_and_slope(x, xd, p, pd, k, speed, s)
        predicted[i - begin] = reading
        put(slopes, (i - begin) * slopes.shape[1] + first, d_reading)
        if closed:
            command_and_slope(command, commands, law, x, xd, s)
        error = measured[i] - reading
        seen = error == error
        spread[i - begin] = 1.0
        if noise[0] > 0.0:
            prior(time, noise, c, x, p, s)
            if afresh:
                predicted[i - begin] = np.nan
                begin_at_reading(time, noise, c, x, speed, s)
                begin_slopes_at_reading(xd, speed, s)
            spread[i - begin] = correcting(c, speed, of_motor, seen, gain)
            if seen:
                corrected_states(time, c, gain, x, s)
                corrected_slopes(gain, xd, s)
        if i == count - 1:
            break
        advance_with_slopes(time, command, commands, closed, longest, x, xd, p, pd, k, s)
        # At rest the filter forgets what the parameters have done before, by a factor with each reading.
        for state in range(states):
            put(xd, state, settled(row(xd, state)))
    return 0.0


#: What the kernel compiles: functions, and sections of the two loops.
LOOPS = (
    believing, spreading, correcting,
    shares_in_filter, expected_reading, limited_command, prior, begin_at_reading, corrected_states, next_edge, predict,
    reading_and_slope, command_and_slope, begin_slopes_at_reading, corrected_slopes, advance_with_slopes, predict_t,
)  # fmt: skip
