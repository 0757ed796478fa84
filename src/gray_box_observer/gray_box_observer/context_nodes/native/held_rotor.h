/* The motion of a motor whose rotor is held by friction, in closed form: context_nodes/rotor/
 * held_rotor.py for compiled code. */
#ifndef GRAY_BOX_OBSERVER_HELD_ROTOR_H
#define GRAY_BOX_OBSERVER_HELD_ROTOR_H

#include "white_box/whole_motor.h"

enum { MOST_CORRECTIONS = 8 };
#define FEWEST_DECAYS 10.0 /* of the speed over a length, from which it is taken to follow */
#define AT_REST 1e-9       /* rad/s by which it may still be off */
#define FOLLOWING 1e-4     /* share of the current's rate that may be left out */
#define NEARLY_NONE 1e-6   /* exponent below which its series serves */

/* Let the speed come to rest under a current, by Newton's method; `there` is the rate at last.
 * Returns 0 where it does not, or too slowly for a length. */
INLINE int at_rest(const double *p, double torque_constant, double *state, double voltage,
                   double length, Linear *there)
{
    for (int k = 0; k < MOST_CORRECTIONS; k++) {
        *there = rate_of(p, torque_constant, state, voltage);
        const double decay = -there->by_state[SPEED][SPEED];
        if (!(decay * length >= FEWEST_DECAYS)) return 0;
        const double imbalance = there->value[SPEED];
        if (absolute(imbalance) <= AT_REST * decay) return 1;
        state[SPEED] += imbalance / decay;
    }
    return 0;
}

/* How the current answers a push at one end, by way of the speed too. */
INLINE double push_of(const Linear *there, int coordinate, double follows)
{
    return there->by_coordinate[CURRENT][coordinate] +
           follows * there->by_coordinate[SPEED][coordinate];
}

/* Move on by a length over which the speed follows the current; returns 0 where it does not. */
static int held_moved(const double *p, double torque_constant, const double *start,
                      const Linear *here, double voltage, double length, Linear *moved)
{
    if (!(-here->by_state[SPEED][SPEED] * length >= FEWEST_DECAYS)) return 0;
    double from[STATES] = {start[CURRENT], start[SPEED]}, to[STATES];
    Linear first, last;
    if (!at_rest(p, torque_constant, from, voltage, length, &first)) return 0;
    const double decay = -first.by_state[SPEED][SPEED];
    const double turns = first.by_state[SPEED][CURRENT] / decay;
    const double slope =
        first.by_state[CURRENT][CURRENT] + first.by_state[CURRENT][SPEED] * turns;
    const double left = exp(slope * length), reach = absolute(slope * length) < NEARLY_NONE
                                                         ? length
                                                         : (left - 1.0) / slope;
    const double slip = first.by_state[CURRENT][SPEED] * (start[SPEED] - from[SPEED]) / decay;
    const double step = reach * first.value[CURRENT];
    to[CURRENT] = from[CURRENT] + step + slip;
    to[SPEED] = from[SPEED] + turns * step;
    if (!at_rest(p, torque_constant, to, voltage, length, &last)) return 0;
    const double size =
        absolute(first.value[CURRENT]) + absolute(slope) * larger(absolute(from[CURRENT]),
                                                                  absolute(to[CURRENT]));
    const double off = last.value[CURRENT] - first.value[CURRENT] - slope * step;
    const double late = first.by_state[CURRENT][SPEED] * turns * first.value[CURRENT] / decay;
    if (!(absolute(off) + absolute(late) + absolute(slip) / length <= FOLLOWING * size))
        return 0;
    const double last_decay = -last.by_state[SPEED][SPEED];
    const double last_turns = last.by_state[SPEED][CURRENT] / last_decay;
    const double follows = first.by_state[CURRENT][SPEED] / decay;
    const double last_follows = last.by_state[CURRENT][SPEED] / last_decay;
    const double change = absolute(slope * length) < NEARLY_NONE
                              ? 0.5 * length
                              : (length * left - reach) / (slope * reach);
    moved->value[CURRENT] = to[CURRENT];
    moved->value[SPEED] = to[SPEED];
    moved->by_state[CURRENT][CURRENT] = left;
    moved->by_state[CURRENT][SPEED] = left * follows;
    moved->by_state[SPEED][CURRENT] = last_turns * left;
    moved->by_state[SPEED][SPEED] = last_turns * left * follows;
    for (int j = 0; j < COORDINATES; j++) {
        const double begins = push_of(&first, j, follows), ends = push_of(&last, j, last_follows);
        const double current = reach * begins + change * (ends - begins);
        moved->by_coordinate[CURRENT][j] = current;
        moved->by_coordinate[SPEED][j] =
            last.by_coordinate[SPEED][j] / last_decay + last_turns * current;
    }
    return 1;
}

#endif
