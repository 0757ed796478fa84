/* The trajectory of one motor with a rotor, sample after sample, with its derivatives:
 * context_nodes/rotor/rotor_trajectory.py for compiled code. */
#include <stddef.h>

#include "context_nodes/native/free_motion.h"

#define COLUMNS (STATES + COORDINATES)

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
    const int is_long = count >= FEWEST_INTERVALS;
    Ladder ladder;
    if (is_long) ladder_made(p, torque_constant, limits, length[count / 2], &ladder);
    for (int64_t k = 0; k < count; k++) {
        if (load) loaded[LOAD_TORQUE] = p[LOAD_TORQUE] + load[k];
        const double *here = states + k * STATES;
        const int is_ready =
            is_long && ladder_of(loaded, torque_constant, limits, here, voltage[k], length[k],
                                 largest_step, &ladder);
        const Stepping by = {largest_step, most_steps, is_ready ? &ladder : NULL};
        const Linear moved =
            moved_on(loaded, torque_constant, here, voltage[k], length[k], &by, 0, taken);
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

/* Run freely from a start and take the residual, and the sums of its squares with the derivatives
 * by both first states: `sums` is that of the products of these, then with the residual. Returns
 * whether all was followed. */
static int left(const double *p, double torque_constant, const double *start, int64_t count,
                const double *voltage, const double *length, const double *reading,
                const double *limits, double largest_step, int64_t most_steps, int64_t patience,
                Ladder *ladder, double *residual, double sums[STATES][STATES + 1])
{
    double here[STATES], slope[STATES][STATES] = {{1.0, 0.0}, {0.0, 1.0}};
    int64_t taken = 0;
    for (int s = 0; s < STATES; s++) {
        here[s] = start[s];
        for (int r = 0; r <= STATES; r++) sums[s][r] = 0.0;
    }
    for (int64_t k = 0;; k++) {
        const double off = reading[k] - here[CURRENT];
        residual[k] = off;
        for (int s = 0; s < STATES; s++) {
            for (int r = 0; r < STATES; r++) sums[s][r] += slope[CURRENT][s] * slope[CURRENT][r];
            sums[s][STATES] += slope[CURRENT][s] * off;
        }
        if (k == count) return 1;
        const int is_ready = ladder_of(p, torque_constant, limits, here, voltage[k], length[k],
                                       largest_step, ladder);
        const Stepping by = {largest_step, most_steps, is_ready ? ladder : NULL};
        const Linear moved =
            moved_on(p, torque_constant, here, voltage[k], length[k], &by, 0, &taken);
        if (taken > patience) return 0;
        double next[STATES][STATES];
        for (int s = 0; s < STATES; s++) {
            if (!(absolute(moved.value[s]) <= limits[s])) return 0;
            here[s] = moved.value[s];
            for (int r = 0; r < STATES; r++)
                next[s][r] = moved.by_state[s][CURRENT] * slope[CURRENT][r] +
                             moved.by_state[s][SPEED] * slope[SPEED][r];
        }
        for (int s = 0; s < STATES; s++)
            for (int r = 0; r < STATES; r++) slope[s][r] = next[s][r];
    }
}

/* The residual of `count` intervals that is left where both first states fit best, by Gauss-Newton
 * in at most `most_runs` runs, converged or not;
 * `reading` and `residual` have [count + 1]. It ends where a step would take off less than
 * `least_gain` mean squares. Returns how many runs there were; 0 where one could not be
 * followed. */
int64_t whole_motor_residual(const double *p, double torque_constant, int64_t count,
                             const double *voltage, const double *length, const double *reading,
                             const double *limits, double largest_step, int64_t most_steps,
                             int64_t patience, int64_t most_runs, double least_gain,
                             double *residual)
{
    const double turns = p[BACK_EMF_CONSTANT];
    double start[STATES] = {reading[0], 0.0}, sums[STATES][STATES + 1];
    if (turns > 0.0)
        start[SPEED] = (voltage[0] * p[INDUCTANCE] - p[RESISTANCE] * reading[1]) / turns;
    start[SPEED] = smaller(larger(start[SPEED], -limits[SPEED]), limits[SPEED]);
    Ladder ladder;
    ladder_made(p, torque_constant, limits, length[count / 2], &ladder);
    for (int64_t runs = 1;; runs++) {
        if (!left(p, torque_constant, start, count, voltage, length, reading, limits, largest_step,
                  most_steps, patience, &ladder, residual, sums))
            return 0;
        const double *a = sums[CURRENT], *b = sums[SPEED];
        const double size = a[CURRENT] * b[SPEED], product = a[SPEED] * b[CURRENT];
        double step[STATES] = {a[STATES] / a[CURRENT], 0.0};
        if (size - product > 1e-9 * size) { /* else friction holds the rotor */
            step[CURRENT] = (b[SPEED] * a[STATES] - a[SPEED] * b[STATES]) / (size - product);
            step[SPEED] = (a[CURRENT] * b[STATES] - b[CURRENT] * a[STATES]) / (size - product);
        }
        double squares = 0.0;
        for (int64_t k = 0; k <= count; k++) squares += residual[k] * residual[k];
        const double gain = step[CURRENT] * a[STATES] + step[SPEED] * b[STATES];
        if (gain * (double)count <= least_gain * squares || runs == most_runs) return runs;
        for (int s = 0; s < STATES; s++) start[s] += step[s];
    }
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

/* What further inputs move the states by: `gains` is [count][STATES] of one input, `inputs` is
 * [count][columns], and `states` has room for [count + 1][columns][STATES]. */
void whole_motor_respond(int64_t count, int64_t columns, const double *transitions,
                         const double *gains, const double *inputs, double *states)
{
    for (int64_t j = 0; j < columns; j++) {
        double current = 0.0, speed = 0.0;
        for (int64_t k = 0;; k++) {
            double *at = states + (k * columns + j) * STATES;
            at[CURRENT] = current, at[SPEED] = speed;
            if (k == count) break;
            const double *by = transitions + k * STATES * STATES, *gain = gains + k * STATES;
            const double input = inputs[k * columns + j], before = current;
            current = by[0] * before + by[1] * speed + gain[CURRENT] * input;
            speed = by[2] * before + by[3] * speed + gain[SPEED] * input;
        }
    }
}
