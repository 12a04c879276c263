/* A discrete PID, a low-pass and a smooth rise: (1) to (3) of README.md. */
#include "law.h"

double low_pass_share(double corner, double h) { return corner > 0.0 ? 1.0 - exp(-2.0 * PI * corner * h) : 1.0; }

double proposal(const Gains *gains, Loop *loop, double e, double h, double *integral)
{
    if (loop->started != 0.0) {
        const double rate = (e - loop->error) / h;
        loop->derivative += low_pass_share(gains->corner, h) * (rate - loop->derivative);
    }
    loop->error = e;
    loop->started = 1.0;
    *integral = loop->integral + gains->ki * e * h;
    return gains->kp * e + *integral + gains->kd * loop->derivative;
}

double smooth(double x)
{
    x = fmin(fmax(x, 0.0), 1.0);
    return x * x * (3.0 - 2.0 * x);
}
