/* The trajectory of one motor with a rotor, sample after sample, with its derivatives:
 * context_nodes/rotor/rotor_trajectory.py for compiled code. */
#include <stddef.h>

#include "context_nodes/native/held_rotor.h"
#include "context_nodes/native/straight_motion.h"
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

/* How steps are chosen; `ladder` may be none. */
typedef struct {
    double largest_step;
    int64_t most_steps;
    const Ladder *ladder;
} Stepping;

enum { FEW_STEPS = 4, STRAIGHT_COST = 2, HELD_COST = 4, FEWEST_INTERVALS = 8, MANY_STEPS = 16 };
#define SAME_LENGTH 1e-6

/* Move on by a length, the ladder's where there is one: at once where friction holds the rotor or
 * the rate is straight on the way, in steps where these are few, else by halves. Steps are shorter
 * where a state passes zero. */
static Linear moved_on(const double *p, double torque_constant, const double *start, double voltage,
                       double length, const Stepping *by, int level, int64_t *taken)
{
    const Linear here = rate_of(p, torque_constant, start, voltage);
    Linear moved;
    if (may_be_held(&here, length)) {
        *taken += HELD_COST;
        if (held_moved(p, torque_constant, start, voltage, length, &moved)) return moved;
    }
    if (by->ladder && straight_moved(by->ladder, level, p, torque_constant, start, &here, voltage,
                                     length, &moved)) {
        *taken += STRAIGHT_COST;
        return moved;
    }
    double away = fastest(&here);
    const double few = FEW_STEPS * by->largest_step;
    const int may_halve = by->ladder && level < HALVINGS;
    if (!may_halve || away * length <= few) {
        moved = in_steps(p, torque_constant, start, &here, voltage, length, away, by->largest_step,
                         by->most_steps, taken);
        const int passes = passing(start, &here, moved.value, length);
        if (!passes) return moved;
        double at[STATES];
        for (int s = 0; s < STATES; s++) at[s] = passes >> s & 1 ? 0.0 : start[s];
        const Linear there = rate_of(p, torque_constant, at, voltage);
        const double steepest = fastest(&there);
        if (!(steepest > away)) return moved;
        away = steepest;
        if (!may_halve || away * length <= few)
            return in_steps(p, torque_constant, start, &here, voltage, length, away,
                            by->largest_step, by->most_steps, taken);
    }
    const Linear first =
        moved_on(p, torque_constant, start, voltage, 0.5 * length, by, level + 1, taken);
    const Linear then =
        moved_on(p, torque_constant, first.value, voltage, 0.5 * length, by, level + 1, taken);
    return joined(&first, &then);
}

/* Make the ladder of a length anew where that is worth it; returns whether there is one. */
static int ladder_of(const double *p, double torque_constant, const double *far,
                     const double *start, double voltage, double length, double largest_step,
                     Ladder *ladder)
{
    if (absolute(length - ladder->length) <= SAME_LENGTH * ladder->length) return ladder->is_made;
    const Linear here = rate_of(p, torque_constant, start, voltage);
    if (!(fastest(&here) * length > MANY_STEPS * largest_step)) return 0;
    ladder_made(p, torque_constant, far, length, ladder);
    return ladder->is_made;
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

enum { LOADED = STATES, FILTER_STATES };
typedef struct {
    double noise, no_load_speed, share, coarseness, slip, stall, furthest, memory, largest_step;
    int64_t most_steps;
} FilterSettings;

int64_t whole_motor_filter_size(void) { return sizeof(FilterSettings); }

/* How much every filter counts, by its log-likelihood. */
static void shares_of(int64_t filters, const double *likelihood, double *share)
{
    double most = likelihood[0], sum = 0.0;
    for (int64_t f = 1; f < filters; f++) most = larger(most, likelihood[f]);
    for (int64_t f = 0; f < filters; f++) sum += share[f] = exp(likelihood[f] - most);
    for (int64_t f = 0; f < filters; f++) share[f] /= sum;
}

/* One sample of the filters of rotor/speed_filter.py: predict about their common mean, correct by
 * the measured current, mix. Room: `states` [filters][3], `covariance` [filters][3][3],
 * `likelihood` and `share` [filters], `mixed` [2] for the speed and its variance. Returns 0 where
 * the mean cannot be followed; then nothing has changed. */
int64_t whole_motor_filter_step(const double *p, double torque_constant,
                                const FilterSettings *set, const double *walks, int64_t filters,
                                double length, double voltage, double reading, double *states,
                                double *covariance, double *likelihood, double *share,
                                double *mixed)
{
    double mean[FILTER_STATES] = {0}, loaded[COORDINATES];
    shares_of(filters, likelihood, share);
    for (int64_t f = 0; f < filters; f++)
        for (int s = 0; s < FILTER_STATES; s++) mean[s] += share[f] * states[f * FILTER_STATES + s];
    for (int j = 0; j < COORDINATES; j++) loaded[j] = p[j];
    loaded[LOAD_TORQUE] = mean[LOADED];
    int64_t taken = 0;
    const Stepping by = {set->largest_step, set->most_steps, NULL};
    const Linear moved = moved_on(loaded, torque_constant, mean, voltage, length, &by, 0, &taken);
    const double most[STATES] = {100.0 * (absolute(mean[CURRENT]) + set->noise) + 1e3,
                                 100.0 * set->no_load_speed + absolute(mean[SPEED])};
    for (int s = 0; s < STATES; s++)
        if (!(absolute(moved.value[s]) <= most[s])) return 0;
    double motion[FILTER_STATES][FILTER_STATES] = {{0}};
    for (int s = 0; s < STATES; s++) {
        for (int r = 0; r < STATES; r++) motion[s][r] = moved.by_state[s][r];
        motion[s][LOADED] = moved.by_coordinate[s][LOAD_TORQUE];
    }
    motion[LOADED][LOADED] = 1.0;
    const double end[FILTER_STATES] = {moved.value[CURRENT], moved.value[SPEED], mean[LOADED]};
    const double current_noise = set->coarseness * set->noise;
    const double slip = set->slip * set->no_load_speed;
    for (int64_t f = 0; f < filters; f++) {
        double *x = states + f * FILTER_STATES;
        double *c = covariance + f * FILTER_STATES * FILTER_STATES;
        double apart[FILTER_STATES], half[FILTER_STATES][FILTER_STATES];
        for (int s = 0; s < FILTER_STATES; s++) apart[s] = x[s] - mean[s];
        for (int s = 0; s < FILTER_STATES; s++) {
            x[s] = end[s];
            for (int r = 0; r < FILTER_STATES; r++) x[s] += motion[s][r] * apart[r];
            for (int r = 0; r < FILTER_STATES; r++) {
                half[s][r] = 0.0;
                for (int k = 0; k < FILTER_STATES; k++)
                    half[s][r] += motion[s][k] * c[k * FILTER_STATES + r];
            }
        }
        for (int s = 0; s < FILTER_STATES; s++)
            for (int r = 0; r < FILTER_STATES; r++) {
                double sum = 0.0;
                for (int k = 0; k < FILTER_STATES; k++) sum += half[s][k] * motion[r][k];
                c[s * FILTER_STATES + r] = sum;
            }
        c[CURRENT * FILTER_STATES + CURRENT] += current_noise * current_noise;
        c[SPEED * FILTER_STATES + SPEED] += set->share * slip * slip;
        c[LOADED * FILTER_STATES + LOADED] += set->share * walks[f] * set->stall * set->stall;
        const double variance = c[CURRENT] + set->noise * set->noise;
        const double largest = set->furthest * sqrt(variance);
        double innovation = reading - x[CURRENT];
        innovation = smaller(larger(innovation, -largest), largest);
        likelihood[f] *= set->memory;
        likelihood[f] -= 0.5 * (log(variance) + innovation * innovation / variance);
        double gain[FILTER_STATES], row[FILTER_STATES];
        for (int s = 0; s < FILTER_STATES; s++) {
            gain[s] = c[s * FILTER_STATES + CURRENT] / variance;
            row[s] = c[CURRENT * FILTER_STATES + s];
        }
        for (int s = 0; s < FILTER_STATES; s++) {
            x[s] += gain[s] * innovation;
            for (int r = 0; r < FILTER_STATES; r++) c[s * FILTER_STATES + r] -= gain[s] * row[r];
        }
    }
    shares_of(filters, likelihood, share);
    double speed = 0.0, spread = 0.0;
    for (int64_t f = 0; f < filters; f++) speed += share[f] * states[f * FILTER_STATES + SPEED];
    for (int64_t f = 0; f < filters; f++) {
        const double off = states[f * FILTER_STATES + SPEED] - speed;
        const int64_t place = f * FILTER_STATES * FILTER_STATES + SPEED * FILTER_STATES + SPEED;
        spread += share[f] * (covariance[place] + off * off);
    }
    mixed[0] = speed;
    mixed[1] = spread;
    return 1;
}
