/* The current of a motor whose brushes may hold it, beside a measured speed: held_current.py for
 * compiled code, LANES motors or intervals at a time. */
#ifndef GRAY_BOX_OBSERVER_WHITE_BOX_HELD_CURRENT_H
#define GRAY_BOX_OBSERVER_WHITE_BOX_HELD_CURRENT_H

#include "white_box/forms.h"

enum { PARTS = 8 }; /* of an interval, each with the speed of its middle */
#define FAR_CURRENT 1e4 /* A: a softened sign is one there */

/* Whether brushes may hold the current. */
INLINE int holds_current(const Terms of)
{
    int any = 0;
    for (int i = 0; i < of.coordinates - 1 + of.known; i++) any |= term_holds_current(of.codes[i]);
    return any && of.speed_measured;
}

/* The rate on one side of zero, as it is at zero, and how a current moves with it. */
typedef struct {
    Real rate, by_coordinate[MOST_COORDINATES];
} Side;

typedef struct {
    Real decay, end, by_coordinate[MOST_COORDINATES];
} Way;

INLINE Side chosen_side(const Terms of, Mask which, const Side *yes, const Side *no)
{
    Side side;
    side.rate = chosen(which, yes->rate, no->rate);
    for (int j = 0; j < of.coordinates; j++)
        side.by_coordinate[j] = chosen(which, yes->by_coordinate[j], no->by_coordinate[j]);
    return side;
}

INLINE Way way_of(
    const Terms of, Real start, const Side *side, Real slope, const Real *by_current, Real time)
{
    Way way;
    way.decay = exponential(slope * time);
    const Real reach = (way.decay - 1.0) / slope;
    const Real along = start * time * way.decay
        + side->rate * (time * way.decay - reach) / slope;
    way.end = start * way.decay + reach * side->rate;
    for (int j = 0; j < of.coordinates; j++)
        way.by_coordinate[j] = reach * side->by_coordinate[j] + along * by_current[j];
    return way;
}

/* While the speed stays: to zero, and beyond it where the brushes let the current. */
INLINE Linear held_current_part(
    const Physics *box, const Terms of, Real start, const Interval *part)
{
    const Real speed = 0.5 * (part->speed + part->end_speed), one = all(1.0), none = all(0.0);
    const Real far = none * start + FAR_CURRENT, twice = 2.0 * far, across = -far;
    const Linear near = rate_of(box, of, &far, part->voltage, speed);
    const Linear further = rate_of(box, of, &twice, part->voltage, speed);
    const Linear other = rate_of(box, of, &across, part->voltage, speed);
    const Real slope = smaller(further.by_state[CURRENT][CURRENT], all(-1e-12));
    Real by_current[MOST_COORDINATES];
    Side above, below, rests;
    above.rate = near.value[CURRENT] - FAR_CURRENT * slope;
    below.rate = other.value[CURRENT] + FAR_CURRENT * slope;
    rests.rate = none * start;
    for (int j = 0; j < of.coordinates; j++) {
        const Real at = near.by_coordinate[CURRENT][j];
        by_current[j] = (further.by_coordinate[CURRENT][j] - at) / FAR_CURRENT;
        above.by_coordinate[j] = at - FAR_CURRENT * by_current[j];
        below.by_coordinate[j] = other.by_coordinate[CURRENT][j] + FAR_CURRENT * by_current[j];
        rests.by_coordinate[j] = none * by_current[j];
    }
    Side away = chosen_side(of, below.rate < none, &below, &rests);
    away = chosen_side(of, above.rate > none, &above, &away);
    Side own = chosen_side(of, start < none, &below, &away);
    own = chosen_side(of, start > none, &above, &own);
    const Mask comes = start * own.rate < none;
    const Real ratio =
        chosen(comes, own.rate / chosen(comes, own.rate + slope * start, one), one);
    const Real after = logarithm(ratio) / slope;
    const Mask passes = comes & (after < part->length);
    const Real time = chosen(passes, after, part->length);
    const Way first = way_of(of, start, &own, slope, by_current, time);
    const Way then = way_of(of, none * start, &away, slope, by_current, part->length - time);
    const Real after_zero = then.decay * away.rate / chosen(passes, own.rate, one);
    const Mask is_held = (start == none) & (own.rate == none);
    Linear moved;
    moved.value[CURRENT] = chosen(passes, then.end, first.end);
    moved.by_state[CURRENT][CURRENT] =
        chosen(passes, after_zero * first.decay, chosen(is_held, none, first.decay));
    for (int j = 0; j < of.coordinates; j++)
        moved.by_coordinate[CURRENT][j] = chosen(passes,
            after_zero * first.by_coordinate[j] + then.by_coordinate[j], first.by_coordinate[j]);
    return moved;
}

INLINE Linear held_current_motion(
    const Physics *box, const Terms of, Real start, const Interval *over)
{
    const Real slope = (over->end_speed - over->speed) / (double)PARTS;
    const Real length = over->length / (double)PARTS;
    Linear whole = {{{0}}, {{{0}}}, {{{0}}}};
    for (int k = 0; k < PARTS; k++) {
        const Real begin = over->speed + (double)k * slope;
        const Real end = k + 1 == PARTS ? over->end_speed : over->speed + (double)(k + 1) * slope;
        const Interval piece = {over->voltage, begin, end, length};
        const Real at = k == 0 ? start : whole.value[CURRENT];
        const Linear part = held_current_part(box, of, at, &piece);
        whole = k == 0 ? part : joined(of, &whole, &part);
    }
    return whole;
}

#endif
