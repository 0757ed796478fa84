/* The motion of a motor one of whose states is held by friction or brushes, in closed form:
 * context_nodes/rotor/held_state.py for compiled code. */
#ifndef GRAY_BOX_OBSERVER_HELD_STATE_H
#define GRAY_BOX_OBSERVER_HELD_STATE_H

#include "white_box/whole_motor.h"

enum { MOST_CORRECTIONS = 8 };
#define FEWEST_DECAYS 10.0 /* of the held state over a length, from which it is taken to follow */
#define AT_REST 1e-9       /* rad/s or A by which it may still be off */
#define FOLLOWING 1e-4     /* share of the free state's rate that may be left out, or of that which
                              it has where the held one gives way */
#define NEARLY_NONE 1e-6   /* exponent below which its series serves */

/* Let a state come to rest beside the other one, by Newton's method; `there` is the rate at last.
 * Returns 0 where it does not, or too slowly for a length. */
INLINE int at_rest(const double *p, double torque_constant, double *state, int held,
                   double voltage, double length, Linear *there)
{
    for (int k = 0; k < MOST_CORRECTIONS; k++) {
        *there = rate_of(p, torque_constant, state, voltage);
        const double decay = -there->by_state[held][held];
        if (!(decay * length >= FEWEST_DECAYS)) return 0;
        const double imbalance = there->value[held];
        if (absolute(imbalance) <= AT_REST * decay) return 1;
        state[held] += imbalance / decay;
    }
    return 0;
}

/* How the free state answers a push at one end, by way of the held one too. */
INLINE double push_of(const Linear *there, int held, int coordinate, double follows)
{
    return there->by_coordinate[1 - held][coordinate] +
           follows * there->by_coordinate[held][coordinate];
}

/* Whether a state comes to rest in a length, by the rate at its start. */
INLINE int may_be_held(const Linear *here, int held, double length)
{
    return -here->by_state[held][held] * length >= FEWEST_DECAYS;
}

/* Move on by a length over which a held state follows the free one; returns 0 where it does not.
 * `holding` is the rate that friction or brushes take of it. */
static int held_moved(const double *p, double torque_constant, const double *start, int held,
                      double holding, double voltage, double length, Linear *moved)
{
    const int free = 1 - held;
    double from[STATES] = {start[CURRENT], start[SPEED]}, to[STATES];
    Linear first, last;
    if (!at_rest(p, torque_constant, from, held, voltage, length, &first)) return 0;
    const double decay = -first.by_state[held][held];
    const double turns = first.by_state[held][free] / decay;
    const double slope = first.by_state[free][free] + first.by_state[free][held] * turns;
    if (!(slope <= 0.0)) return 0; /* the free state runs away */
    const int is_none = -slope * length < NEARLY_NONE;
    const double left = exp(slope * length);
    const double reach = is_none ? length : expm1(slope * length) / slope;
    const double rate = first.value[free];
    const double slip = first.by_state[free][held] * (start[held] - from[held]) / decay;
    const double step = reach * rate;
    to[free] = from[free] + step + left * slip;
    to[held] = from[held] + turns * step;
    const double to_free = to[free];
    if (!at_rest(p, torque_constant, to, held, voltage, length, &last)) return 0;
    const double gives_way = holding / larger(absolute(first.by_state[held][free]), 1e-300);
    const double largest = larger(gives_way, larger(absolute(from[free]), absolute(to_free)));
    const double size = absolute(rate) + absolute(slope) * largest;
    const double off = last.value[free] - rate - slope * (to_free - from[free]);
    const double late = first.by_state[free][held] * turns * rate / decay;
    if (!(absolute(off) + absolute(late) + absolute(slip) / length <= FOLLOWING * size)) return 0;
    const double last_decay = -last.by_state[held][held];
    const double last_turns = last.by_state[held][free] / last_decay;
    const double follows = first.by_state[free][held] / decay;
    const double last_follows = last.by_state[free][held] / last_decay;
    const double change = is_none ? 0.5 * length : (length * left - reach) / (slope * reach);
    moved->value[free] = to_free;
    moved->value[held] = to[held] - last_turns * last.value[free] / last_decay; /* its lag */
    moved->by_state[free][free] = left;
    moved->by_state[free][held] = left * follows;
    moved->by_state[held][free] = last_turns * left;
    moved->by_state[held][held] = last_turns * left * follows;
    for (int j = 0; j < COORDINATES; j++) {
        const double begins = push_of(&first, held, j, follows);
        const double ends = push_of(&last, held, j, last_follows);
        const double by_free = reach * begins + change * (ends - begins);
        moved->by_coordinate[free][j] = by_free;
        moved->by_coordinate[held][j] =
            last.by_coordinate[held][j] / last_decay + last_turns * by_free;
    }
    return 1;
}

#endif
