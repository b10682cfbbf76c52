/* The base model written by hand for speed alone: what `bench.py` measures the compiled kernel against.
   Inertia, viscous friction, dead-band, backlash; the same pieces, events and order as twin/model/stepper.py, no derivatives. */

#include <math.h>

static double reach(double distance, double speed, double acceleration, double limit)
{
    if (distance < 0.0) {
        distance = -distance;
        speed = -speed;
        acceleration = -acceleration;
    }
    if (distance > 0.0) {
        double under = speed * speed + 2.0 * acceleration * distance;
        if (speed > 0.0) {
            if (under > 0.0)
                return 2.0 * distance / (speed + sqrt(under));
        } else if (acceleration > 0.0) {
            return (sqrt(under) - speed) / acceleration;
        }
    }
    return limit;
}

/* p: input gain, viscous friction, dead-band forwards, backwards, gap, motor's share of inertia, of friction. */
void bare_loop(const double *duty, double *position, long count, double step, const double *p)
{
    const double gain = p[0], forward = p[2], reverse = p[3], half = 0.5 * p[4];
    const double mass_m = p[5], mass_l = 1.0 - p[5], b_m = p[6] * p[1], b_l = p[1] - b_m;
    double x = 0.0, v = 0.0, gap = 0.0, w = 0.0;

    for (long i = 0; i < count; ++i) {
        position[i] = x;
        double u = duty[i], torque = 0.0, left = step;
        if (u > forward)
            torque = gain * (u - forward);
        else if (u < -reverse)
            torque = gain * (u + reverse);
        while (left > 0.0) {
            int side = 0;
            double h = left, closing = w - v;
            if (gap >= half && closing >= 0.0)
                side = 1;
            else if (gap <= -half && closing <= 0.0)
                side = -1;
            if (side != 0) {
                if (closing != 0.0)
                    v = w = mass_m * w + mass_l * v;
                gap = side * half;
                closing = 0.0;
            } else {
                if (h > 0.0005)
                    h = 0.0005;
                while (h * b_m / mass_m > 0.015)
                    h *= 0.5;
            }
            double at_m = w, at_l = v, a_m = 0.0, a_l = 0.0;
            int together = 0;
            for (int stage = 0; stage < 2; ++stage) {
                if (stage == 1) {
                    at_l = v + 0.5 * h * a_l;
                    if (at_l * v < 0.0)
                        at_l = 0.0;
                    at_m = together ? at_l : w + 0.5 * h * a_m;
                    if (at_m * w < 0.0)
                        at_m = 0.0;
                }
                double push_m = torque - b_m * at_m, push_l = -b_l * at_l;
                together = side != 0 && side * (push_m * mass_l - push_l * mass_m) >= 0.0;
                if (together) {
                    a_m = a_l = push_m + push_l;
                } else {
                    a_m = push_m / mass_m;
                    a_l = push_l / mass_l;
                }
            }
            int event = 0;
            double span = h, time;
            if (v * a_l < 0.0 && (time = -v / a_l) < span) {
                event = 1;
                span = time;
            }
            if (!together) {
                if (w * a_m < 0.0 && (time = -w / a_m) < span) {
                    event = 2;
                    span = time;
                }
                if ((time = reach(half - gap, closing, a_m - a_l, h)) < span) {
                    event = 3;
                    span = time;
                }
                if ((time = reach(-half - gap, closing, a_m - a_l, h)) < span) {
                    event = 4;
                    span = time;
                }
                gap += span * (closing + 0.5 * span * (a_m - a_l));
            }
            x += span * (v + 0.5 * span * a_l);
            v += span * a_l;
            w = together ? v : w + span * a_m;
            if (event == 1) {
                v = 0.0;
                if (together)
                    w = 0.0;
            } else if (event == 2) {
                w = 0.0;
            } else if (event == 3) {
                gap = half;
            } else if (event == 4) {
                gap = -half;
            }
            left -= span;
        }
    }
}
