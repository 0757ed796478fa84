/* The motion of the current over one interval, with its derivatives: flow.py for compiled code, step for step. */
#ifndef GRAY_BOX_OBSERVER_WHITE_BOX_FLOW_H
#define GRAY_BOX_OBSERVER_WHITE_BOX_FLOW_H

#include "white_box/terms.h"

#define MOST_COORDINATES 5
#define MOST_KNOWN 8

/* Which terms the voltage balance has: how many coordinates, how many known terms, whether speed is measured, and the
 * codes of the unknown terms without inductance, then of the known ones. What the compiler is told it folds away. */
typedef struct {
    int coordinates, known, speed_measured;
    const int64_t *codes;
} Terms;

/* The numbers in it; the constants of the known terms are given. */
typedef struct {
    Real torque_constant, p[MOST_COORDINATES], constant[MOST_KNOWN];
} Physics;

/* Rate of the current in A/s, its derivative by the current, and by every coordinate. */
typedef struct {
    Real value, slope, by_coordinate[MOST_COORDINATES];
} Rate;

/* Where an interval leads, and the derivatives by where it begins and by every coordinate. */
typedef struct {
    Real state, by_state, by_coordinate[MOST_COORDINATES];
} Moved;

/* An interval, or a part of one: voltage held over it, speeds at its ends, and how long it lasts. */
typedef struct {
    Real voltage, speed, end_speed, length;
} Interval;

/* Derivative of a term by the current; total where the speed follows it. */
INLINE Real slope_of(const Physics *box, const Terms of, const Term *t)
{
    return t->of_speed && !of.speed_measured ? t->by_current + box->torque_constant * t->by_speed : t->by_current;
}

/* Rate of the current and its derivatives: flow.py, _rate. */
INLINE Rate rate_of(const Physics *box, const Terms of, Real state, Real voltage, Real measured)
{
    const int n = of.coordinates;
    const Real speed = of.speed_measured ? measured : box->torque_constant * state;
    Rate rate;
    Real drive = voltage, slope = all(0.0);
    UNROLL for (int j = 0; j < of.known; j++) {
        const Term t = term(of.codes[n - 1 + j], state, speed);
        drive -= box->constant[j] * t.value;
        slope -= box->constant[j] * slope_of(box, of, &t);
    }
    rate.value = box->p[0] * drive;
    rate.slope = box->p[0] * slope;
    rate.by_coordinate[0] = drive;
    UNROLL for (int j = 1; j < n; j++) {
        const Term t = term(of.codes[j - 1], state, speed);
        rate.value -= box->p[j] * t.value;
        rate.slope -= box->p[j] * slope_of(box, of, &t);
        rate.by_coordinate[j] = -t.value;
    }
    return rate;
}

/* One classical Runge-Kutta step of the state and its variational equation: flow.py, _runge_kutta_step. */
INLINE Moved runge_kutta(const Physics *box, const Terms of, const Rate *first, Real start, const Interval *over)
{
    const int n = of.coordinates;
    const Real voltage = over->voltage, begin = over->speed, end = over->end_speed, step = over->length;
    const Real half = 0.5 * step, middle = 0.5 * (begin + end), sixth = step * (1.0 / 6.0);
    const Rate r2 = rate_of(box, of, start + half * first->value, voltage, middle);
    const Rate r3 = rate_of(box, of, start + half * r2.value, voltage, middle);
    const Rate r4 = rate_of(box, of, start + step * r3.value, voltage, end);
    const Real l2 = r2.slope * (1.0 + half * first->slope);
    const Real l3 = r3.slope * (1.0 + half * l2);
    const Real l4 = r4.slope * (1.0 + step * l3);
    Moved moved;
    moved.state = start + sixth * (first->value + 2.0 * (r2.value + r3.value) + r4.value);
    moved.by_state = 1.0 + sixth * (first->slope + 2.0 * (l2 + l3) + l4);
    UNROLL for (int j = 0; j < n; j++) {
        const Real m1 = first->by_coordinate[j];
        const Real m2 = r2.slope * (half * m1) + r2.by_coordinate[j];
        const Real m3 = r3.slope * (half * m2) + r3.by_coordinate[j];
        const Real m4 = r4.slope * (step * m3) + r4.by_coordinate[j];
        moved.by_coordinate[j] = sixth * (m1 + 2.0 * (m2 + m3) + m4);
    }
    return moved;
}

/* Equal steps, as many as each lane asks for; at most `most` of any lane: flow.py, _in_steps. */
INLINE Moved in_steps(const Physics *box, const Terms of, Real start, const Interval *over, Real steps, int most)
{
    const int n = of.coordinates;
    const Real slope = (over->end_speed - over->speed) / steps, length = over->length / steps;
    Moved whole = {start, all(1.0), {{0}}};
    for (int s = 0; s < most; s++) {
        const Mask on = all(s) < steps, last = all(s + 1) >= steps;
        const Real from = over->speed + (double)s * slope;
        const Real to = chosen(last, over->end_speed, over->speed + (double)(s + 1) * slope);
        const Interval piece = {over->voltage, from, to, length};
        const Rate here = rate_of(box, of, whole.state, over->voltage, from);
        const Moved part = runge_kutta(box, of, &here, whole.state, &piece);
        whole.state = chosen(on, part.state, whole.state);
        for (int j = 0; j < n; j++) {
            const Real grown = part.by_state * whole.by_coordinate[j] + part.by_coordinate[j];
            whole.by_coordinate[j] = chosen(on, grown, whole.by_coordinate[j]);
        }
        whole.by_state = chosen(on, part.by_state * whole.by_state, whole.by_state);
    }
    return whole;
}

#endif
