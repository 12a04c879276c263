/* How the reference of a phase moves: lines with smooth ends, circles spiralled into and out of. README.md (8), (9). */
#include "law.h"

static double smooth_area(double x) { return x * x * x * (1.0 - 0.5 * x); }

static double line_speed(const Phase *phase, double length)
{
    const double ramps = phase->ramp_in + phase->ramp_out;
    return 2.0 * length >= phase->speed * ramps ? phase->speed : 2.0 * length / ramps;
}

static double line_time(const Phase *phase, double length)
{
    if (length == 0.0)
        return 0.0;
    return length / line_speed(phase, length) + 0.5 * (phase->ramp_in + phase->ramp_out);
}

static void line_share(const Phase *phase, double length, double t, double *path, double *speed)
{
    const double total = line_time(phase, length);
    *path = length, *speed = 0.0;
    if (t >= total || length == 0.0)
        return;
    const double v = line_speed(phase, length);
    t = fmax(t, 0.0);
    if (t < phase->ramp_in) {
        const double x = t / phase->ramp_in;
        *path = v * phase->ramp_in * smooth_area(x), *speed = v * smooth(x);
    } else if (t > total - phase->ramp_out) {
        const double x = (total - t) / phase->ramp_out;
        *path = length - v * phase->ramp_out * smooth_area(x), *speed = v * smooth(x);
    } else {
        *path = v * (t - 0.5 * phase->ramp_in), *speed = v;
    }
}

static double circle_time(const Phase *phase) { return (phase->turns + 2.0) / phase->rate; }

static void circle_offset(const Phase *phase, double t, double offset[2], double velocity[2])
{
    const double total = circle_time(phase);
    offset[0] = offset[1] = velocity[0] = velocity[1] = 0.0;
    if (t <= 0.0 || t >= total)
        return;
    const double x = fmin(t, total - t) * phase->rate;
    const double r = phase->radius * smooth(x);
    double growth = x < 1.0 ? 6.0 * phase->radius * phase->rate * x * (1.0 - x) : 0.0;
    if (2.0 * t > total)
        growth = -growth;
    const double omega = 2.0 * PI * phase->rate;
    const double c = cos(omega * t), s = sin(omega * t);
    offset[0] = r * c, offset[1] = r * s;
    velocity[0] = growth * c - r * omega * s, velocity[1] = growth * s + r * omega * c;
}

double motion_time(const Phase *phase, double length)
{
    return phase->radius > 0.0 ? circle_time(phase) : line_time(phase, length);
}

void motion(const Phase *phase, const double start[3], const double end[3], double length, double t, double p[3],
            double velocity[3])
{
    for (int i = 0; i < 3; i++)
        p[i] = start[i], velocity[i] = 0.0;
    if (phase->radius > 0.0) {
        double offset[2];
        circle_offset(phase, t, offset, velocity);
        p[0] = start[0] + offset[0], p[1] = start[1] + offset[1];
    } else if (length > 0.0) {
        double path, speed;
        line_share(phase, length, t, &path, &speed);
        for (int i = 0; i < 3; i++) {
            const double direction = (end[i] - start[i]) / length;
            p[i] = path == length ? end[i] : start[i] + path * direction;
            velocity[i] = speed * direction;
        }
    }
}
