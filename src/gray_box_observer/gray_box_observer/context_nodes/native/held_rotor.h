/* The motion of a motor whose rotor is held by friction, in closed form: context_nodes/rotor/
 * held_rotor.py for compiled code. */
#ifndef GRAY_BOX_OBSERVER_HELD_ROTOR_H
#define GRAY_BOX_OBSERVER_HELD_ROTOR_H

#include "white_box/whole_motor.h"

enum { MOST_CORRECTIONS = 8 };
#define FEWEST_DECAYS 10.0 /* of the speed over a length, from which it is taken to follow */
#define AT_REST 1e-9       /* rad/s by which it may still be off */
#define FOLLOWING 1e-4     /* share of the current's rate that may be left out, or of that which
                              the current has at which friction gives way */
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

/* Whether the speed comes to rest in a length, by the rate at its start. */
INLINE int may_be_held(const Linear *here, double length)
{
    return -here->by_state[SPEED][SPEED] * length >= FEWEST_DECAYS;
}

/* Move on by a length over which the speed follows the current; returns 0 where it does not. */
static int held_moved(const double *p, double torque_constant, const double *start, double voltage,
                      double length, Linear *moved)
{
    double from[STATES] = {start[CURRENT], start[SPEED]}, to[STATES];
    Linear first, last;
    if (!at_rest(p, torque_constant, from, voltage, length, &first)) return 0;
    const double decay = -first.by_state[SPEED][SPEED];
    const double turns = first.by_state[SPEED][CURRENT] / decay;
    const double slope = first.by_state[CURRENT][CURRENT] + first.by_state[CURRENT][SPEED] * turns;
    if (!(slope <= 0.0)) return 0; /* the current runs away */
    const int is_none = -slope * length < NEARLY_NONE;
    const double left = exp(slope * length);
    const double reach = is_none ? length : expm1(slope * length) / slope;
    const double rate = first.value[CURRENT];
    const double slip = first.by_state[CURRENT][SPEED] * (start[SPEED] - from[SPEED]) / decay;
    const double step = reach * rate;
    to[CURRENT] = from[CURRENT] + step + left * slip;
    to[SPEED] = from[SPEED] + turns * step;
    if (!at_rest(p, torque_constant, to, voltage, length, &last)) return 0;
    const double gives_way = p[BRUSH_DROP] != 0.0 ? 0.0 /* they bend the current's own balance */
                                 : p[COULOMB_FRICTION] / absolute(first.by_state[SPEED][CURRENT]);
    const double largest =
        larger(gives_way, larger(absolute(from[CURRENT]), absolute(to[CURRENT])));
    const double size = absolute(rate) + absolute(slope) * largest;
    const double off = last.value[CURRENT] - rate - slope * (to[CURRENT] - from[CURRENT]);
    const double late = first.by_state[CURRENT][SPEED] * turns * rate / decay;
    if (!(absolute(off) + absolute(late) + absolute(slip) / length <= FOLLOWING * size)) return 0;
    const double last_decay = -last.by_state[SPEED][SPEED];
    const double last_turns = last.by_state[SPEED][CURRENT] / last_decay;
    const double follows = first.by_state[CURRENT][SPEED] / decay;
    const double last_follows = last.by_state[CURRENT][SPEED] / last_decay;
    const double change = is_none ? 0.5 * length : (length * left - reach) / (slope * reach);
    moved->value[CURRENT] = to[CURRENT];
    moved->value[SPEED] = to[SPEED] - last_turns * last.value[CURRENT] / last_decay; /* its lag */
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
