/* The trajectory of one motor with a rotor, sample after sample, with its derivatives:
 * context_nodes/rotor/trajectory.py for compiled code. */
#include "white_box/whole_motor.h"

#define COLUMNS (STATES + COORDINATES)

/* Bound of the fastest rate: flow.py, _stiffness, of one motor. */
INLINE double fastest(const Linear *here)
{
    const double coupled = sqrt(absolute(here->by_state[CURRENT][SPEED] * here->by_state[SPEED][CURRENT]));
    return larger(absolute(here->by_state[CURRENT][CURRENT]) + coupled,
                  absolute(here->by_state[SPEED][SPEED]) + coupled);
}

/* The same over an interval in which a state may pass zero, where a softened sign is steep. */
INLINE double fastest_over(const double *p, double torque_constant, const double *state, const Linear *here,
                           double voltage, double length)
{
    double at[STATES], found = fastest(here);
    int passes = 0;
    for (int s = 0; s < STATES; s++) {
        const int near = absolute(state[s]) <= length * absolute(here->value[s]);
        at[s] = near ? 0.0 : state[s];
        passes |= near;
    }
    if (passes) {
        const Linear there = rate_of(p, torque_constant, at, voltage);
        found = larger(found, fastest(&there));
    }
    return found;
}

/* Move one interval on, in as many equal steps as its fastest rate asks for. */
static Linear interval_moved(const double *p, double torque_constant, const double *start, double voltage,
                             double length, double largest_step, int64_t most_steps)
{
    Linear here = rate_of(p, torque_constant, start, voltage);
    const double stiffness = fastest_over(p, torque_constant, start, &here, voltage, length) * length;
    const double wanted = ceil(stiffness / largest_step);
    const int stiff = !(wanted <= (double)most_steps);
    const int64_t count = stiff ? most_steps : wanted < 1.0 ? 1 : (int64_t)wanted;
    const double step = length / (double)count;
    Linear whole = {{0}, {{0}}, {{0}}};
    for (int s = 0; s < STATES; s++) whole.value[s] = start[s], whole.by_state[s][s] = 1.0;
    for (int64_t k = 0; k < count; k++) {
        if (k > 0) here = rate_of(p, torque_constant, whole.value, voltage);
        const Linear part = stiff ? exponential_step(whole.value, &here, step)
                                  : runge_kutta_step(p, torque_constant, whole.value, &here, voltage, step);
        whole = joined(&whole, &part);
    }
    return whole;
}

int64_t whole_motor_fingerprint(void) { return WHOLE_MOTOR_FINGERPRINT; }

/* Follow `count` intervals from a start. `states` has room for [count + 1][STATES], `slopes` for
 * [count + 1][STATES][COLUMNS], derivatives by both first states and every coordinate, and `transitions` for
 * [count][STATES][STATES]. Returns how many intervals were followed before a state was beyond its limit. */
int64_t whole_motor_run(const double *p, double torque_constant, const double *start, int64_t count,
                        const double *voltage, const double *length, const double *limits, double largest_step,
                        int64_t most_steps, double *states, double *slopes, double *transitions)
{
    for (int s = 0; s < STATES; s++) {
        states[s] = start[s];
        for (int j = 0; j < COLUMNS; j++) slopes[s * COLUMNS + j] = j == s;
    }
    for (int64_t k = 0; k < count; k++) {
        const Linear moved =
            interval_moved(p, torque_constant, states + k * STATES, voltage[k], length[k], largest_step, most_steps);
        const double *before = slopes + k * STATES * COLUMNS;
        double *after = slopes + (k + 1) * STATES * COLUMNS;
        for (int s = 0; s < STATES; s++) {
            if (!(absolute(moved.value[s]) <= limits[s])) return k;
            states[(k + 1) * STATES + s] = moved.value[s];
            for (int r = 0; r < STATES; r++) transitions[(k * STATES + s) * STATES + r] = moved.by_state[s][r];
            const double a = moved.by_state[s][CURRENT], b = moved.by_state[s][SPEED];
            for (int j = 0; j < COLUMNS; j++) after[s * COLUMNS + j] = a * before[j] + b * before[COLUMNS + j];
            for (int j = 0; j < COORDINATES; j++) after[s * COLUMNS + STATES + j] += moved.by_coordinate[s][j];
        }
    }
    return count;
}
