/* One motor with a rotor over a length of constant voltage: in closed form where there is one, else
 * in steps. */
#ifndef GRAY_BOX_OBSERVER_FREE_MOTION_H
#define GRAY_BOX_OBSERVER_FREE_MOTION_H

#include <math.h>
#include <stddef.h>

#include "context_nodes/native/held_state.h"
#include "context_nodes/native/straight_motion.h"
#include "white_box/whole_motor.h"

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

/* Move on by a length, the ladder's where there is one: at once where friction holds the rotor,
 * brushes the current, or the rate is straight on the way, in steps where these are few, else by
 * halves. Steps are shorter where a state passes zero. */
static Linear moved_on(const double *p, double torque_constant, const double *start, double voltage,
                       double length, const Stepping *by, int level, int64_t *taken)
{
    const Linear here = rate_of(p, torque_constant, start, voltage);
    Linear moved;
    if (may_be_held(&here, SPEED, length)) {
        const double holding = p[BRUSH_DROP] != 0.0 ? 0.0 : p[COULOMB_FRICTION];
        *taken += HELD_COST;
        if (held_moved(p, torque_constant, start, SPEED, holding, voltage, length, &moved))
            return moved;
    }
    if (by->ladder && straight_moved(by->ladder, level, p, torque_constant, start, &here, voltage,
                                     length, &moved)) {
        *taken += STRAIGHT_COST;
        return moved;
    }
    if (p[BRUSH_DROP] != 0.0 && may_be_held(&here, CURRENT, length)) {
        const double holding = p[COULOMB_FRICTION] != 0.0 ? 0.0 : p[BRUSH_DROP];
        *taken += HELD_COST;
        if (held_moved(p, torque_constant, start, CURRENT, holding, voltage, length, &moved))
            return moved;
    }
    double away = fastest(&here);
    const double few = FEW_STEPS * by->largest_step;
    const int may_halve = level < HALVINGS;
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

#endif
