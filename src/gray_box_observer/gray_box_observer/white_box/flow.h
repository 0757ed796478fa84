/* The motion of the states over one interval in several steps: flow.py for compiled code, LANES
 * motors at a time. */
#ifndef GRAY_BOX_OBSERVER_WHITE_BOX_FLOW_H
#define GRAY_BOX_OBSERVER_WHITE_BOX_FLOW_H

#include <math.h>

#include "white_box/forms.h"

/* The motion of those lanes that are meant, else the other one. */
INLINE Linear chosen_motion(const Terms of, Mask which, const Linear *yes, const Linear *no)
{
    Linear moved;
    for (int s = 0; s < STATES; s++) {
        moved.value[s] = chosen(which, yes->value[s], no->value[s]);
        for (int r = 0; r < STATES; r++)
            moved.by_state[s][r] = chosen(which, yes->by_state[s][r], no->by_state[s][r]);
        for (int j = 0; j < of.coordinates; j++)
            moved.by_coordinate[s][j] = chosen(which, yes->by_coordinate[s][j],
                no->by_coordinate[s][j]);
    }
    return moved;
}

enum { FIRST_STEPS = 10 }; /* exponential ones that are taken for the first one */

/* Equal steps, as many as each lane asks for; at most `most` of any lane. Where it is stiff `most`
 * exponential ones, of which the first is taken in FIRST_STEPS, each twice as long as the one
 * before: flow.py, _in_steps. */
INLINE Linear in_steps(
    const Physics *box, const Terms of, const Real *start, const Interval *over, Real steps,
    int most, int is_stiff)
{
    const Real slope = (over->end_speed - over->speed) / steps, length = over->length / steps;
    const Real change = over->speed + slope - over->speed;
    const double total = ldexp(1.0, FIRST_STEPS) - 1.0;
    const int further = is_stiff ? FIRST_STEPS - 1 : 0;
    Linear whole = {{{0}}, {{{0}}}, {{{0}}}};
    for (int s = 0; s < STATES; s++) whole.value[s] = start[s], whole.by_state[s][s] = all(1.0);
    for (int k = -further; k < most; k++) {
        const int step = k > 0 ? k : 0;
        Mask on = {0}, last = {0}; /* lane by lane: GCC 12 cannot compare vectors here */
        for (int l = 0; l < LANES; l++) {
            on[l] = -(step < steps[l]);
            last[l] = -(step + 1 >= steps[l]);
        }
        const Real to = chosen(last, over->end_speed, over->speed + (double)(step + 1) * slope);
        Interval piece = {over->voltage, over->speed + (double)step * slope, to, length};
        if (is_stiff && k <= 0) {
            const double begin = ldexp(1.0, k + further);
            piece.speed = over->speed + (begin - 1.0) / total * change;
            piece.end_speed = over->speed + (2.0 * begin - 1.0) / total * change;
            piece.length = length * (begin / total);
        }
        const Linear here = rate_of(box, of, whole.value, over->voltage, piece.speed);
        const Linear part = is_stiff ? exponential_step(of, whole.value, &here, piece.length)
                                     : runge_kutta_step(box, of, whole.value, &here, &piece);
        const Linear both = joined(of, &whole, &part);
        whole = chosen_motion(of, on, &both, &whole);
    }
    return whole;
}

#endif
