/* The trajectory of one motor with a rotor, sample after sample, with its derivatives:
 * context_nodes/rotor/trajectory.py for compiled code. */
#include "white_box/whole_motor.h"

#define COLUMNS (STATES + COORDINATES)

/* Bound of the fastest rate: flow.py, _stiffness, of one motor. */
INLINE double fastest(const Linear *here)
{
    const double coupled =
        sqrt(absolute(here->by_state[CURRENT][SPEED] * here->by_state[SPEED][CURRENT]));
    return larger(absolute(here->by_state[CURRENT][CURRENT]) + coupled,
                  absolute(here->by_state[SPEED][SPEED]) + coupled);
}

/* Equal steps from a start, as many as a stiffness asks for; `here` is the rate at the start. */
static Linear in_steps(const double *p, double torque_constant, const double *start,
                       const Linear *rate, double voltage,
                       double length, double stiffness, double largest_step, int64_t most_steps,
                       int64_t *taken)
{
    const double wanted = ceil(stiffness * length / largest_step);
    const int stiff = !(wanted <= (double)most_steps);
    const int64_t count = stiff ? most_steps : wanted < 1.0 ? 1 : (int64_t)wanted;
    const double step = length / (double)count;
    *taken += count;
    Linear here = *rate, whole = {{0}, {{0}}, {{0}}};
    for (int s = 0; s < STATES; s++) whole.value[s] = start[s], whole.by_state[s][s] = 1.0;
    for (int64_t k = 0; k < count; k++) {
        if (k > 0) here = rate_of(p, torque_constant, whole.value, voltage);
        const Linear part = stiff ? exponential_step(whole.value, &here, step)
                                  : runge_kutta_step(
                                        p, torque_constant, whole.value, &here, voltage, step);
        whole = joined(&whole, &part);
    }
    return whole;
}

/* Which states pass zero on the way, or may: there a softened sign is steep. */
INLINE int passing(const double *start, const Linear *here, const double *end, double length)
{
    int passes = 0;
    for (int s = 0; s < STATES; s++) {
        const int near = absolute(start[s]) <= length * absolute(here->value[s]);
        passes |= (near || start[s] * end[s] <= 0.0) << s;
    }
    return passes;
}

/* Move one interval on, again in shorter steps where a state has passed zero. */
static Linear interval_moved(const double *p, double torque_constant, const double *start,
                             double voltage,
                             double length, double largest_step, int64_t most_steps,
                             int64_t *taken)
{
    const Linear here = rate_of(p, torque_constant, start, voltage);
    const double away = fastest(&here);
    const Linear moved =
        in_steps(p, torque_constant, start, &here, voltage, length, away, largest_step, most_steps,
                 taken);
    const int passes = passing(start, &here, moved.value, length);
    if (!passes) return moved;
    double at[STATES];
    for (int s = 0; s < STATES; s++) at[s] = passes >> s & 1 ? 0.0 : start[s];
    const Linear there = rate_of(p, torque_constant, at, voltage);
    const double steepest = fastest(&there);
    if (!(steepest > away)) return moved;
    return in_steps(
        p, torque_constant, start, &here, voltage, length, steepest, largest_step, most_steps,
        taken);
}

int64_t whole_motor_fingerprint(void) { return WHOLE_MOTOR_FINGERPRINT; }

/* Follow `count` intervals from a start. `load`, where there is one, is what it takes of the
 * acceleration over every interval. `states` has room for [count + 1][STATES], `slopes` for
 * [count + 1][STATES][COLUMNS], derivatives by both first states and every coordinate, and
 * `transitions` for [count][STATES][STATES]. Returns how many intervals were followed before a
 * state was beyond its limit, or before all took more than `patience` steps together; `taken` is
 * how many they were. */
int64_t whole_motor_follow(const double *p, double torque_constant, const double *start,
                           int64_t count, const double *voltage, const double *length,
                           const double *load, const double *limits, double largest_step,
                           int64_t most_steps, int64_t patience, double *states, double *slopes,
                           double *transitions, int64_t *taken)
{
    *taken = 0;
    double loaded[COORDINATES];
    for (int j = 0; j < COORDINATES; j++) loaded[j] = p[j];
    for (int s = 0; s < STATES; s++) {
        states[s] = start[s];
        for (int j = 0; j < COLUMNS; j++) slopes[s * COLUMNS + j] = j == s;
    }
    for (int64_t k = 0; k < count; k++) {
        if (load) loaded[LOAD_TORQUE] = p[LOAD_TORQUE] + load[k];
        const Linear moved =
            interval_moved(loaded, torque_constant, states + k * STATES, voltage[k], length[k],
                           largest_step, most_steps, taken);
        if (*taken > patience) return k;
        const double *before = slopes + k * STATES * COLUMNS;
        double *after = slopes + (k + 1) * STATES * COLUMNS;
        for (int s = 0; s < STATES; s++) {
            if (!(absolute(moved.value[s]) <= limits[s])) return k;
            states[(k + 1) * STATES + s] = moved.value[s];
            for (int r = 0; r < STATES; r++)
                transitions[(k * STATES + s) * STATES + r] = moved.by_state[s][r];
            const double a = moved.by_state[s][CURRENT], b = moved.by_state[s][SPEED];
            for (int j = 0; j < COLUMNS; j++)
                after[s * COLUMNS + j] = a * before[j] + b * before[COLUMNS + j];
            for (int j = 0; j < COORDINATES; j++)
                after[s * COLUMNS + STATES + j] += moved.by_coordinate[s][j];
        }
    }
    return count;
}

/* Derivatives of a followed motion by the knots of a load that runs straight between them.
 * `place` is that of every interval among the knots, at most `knots - 1`; `by_knot` has room for
 * [count + 1][STATES][knots]. */
void whole_motor_by_knot(int64_t count, int64_t knots, const double *place, const double *slopes,
                         const double *transitions, double *by_knot)
{
    for (int64_t j = 0; j < STATES * knots; j++) by_knot[j] = 0.0;
    for (int64_t k = 0; k < count; k++) {
        const double *before = by_knot + k * STATES * knots;
        double *after = by_knot + (k + 1) * STATES * knots;
        const double *here = slopes + k * STATES * COLUMNS + STATES + LOAD_TORQUE;
        const int64_t left = place[k] >= knots - 1 ? knots - 2 : (int64_t)place[k];
        const double share = place[k] - (double)left;
        for (int s = 0; s < STATES; s++) {
            const double a = transitions[(k * STATES + s) * STATES + CURRENT];
            const double b = transitions[(k * STATES + s) * STATES + SPEED];
            const double pushed =
                here[(STATES + s) * COLUMNS] - a * here[0] - b * here[COLUMNS];
            for (int64_t j = 0; j < knots; j++)
                after[s * knots + j] = a * before[j] + b * before[knots + j];
            after[s * knots + left] += (1.0 - share) * pushed;
            after[s * knots + left + 1] += share * pushed;
        }
    }
}
