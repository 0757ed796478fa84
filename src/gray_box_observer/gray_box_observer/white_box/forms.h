/* Forms of the motor for compiled code, LANES motors at a time.
 * Written by `make physics` from declaration.py: change that, not this. */
#ifndef GRAY_BOX_OBSERVER_WHITE_BOX_FORMS_H
#define GRAY_BOX_OBSERVER_WHITE_BOX_FORMS_H

#include "white_box/lanes.h"

#define FORMS_FINGERPRINT 163478827700262971

enum { CURRENT, STATES };
enum { INDUCTANCE, RESISTANCE, HYSTERESIS, BACK_EMF_CONSTANT, BRUSH_DROP, VOLTAGE_OFFSET, DEAD_ZONE,
    INERTIA, VISCOUS_FRICTION, COULOMB_FRICTION, QUADRATIC_FRICTION, LOAD_TORQUE };

#include "white_box/physics.h"

/* Whether there is a term of this code. */
static inline int term_known(int64_t code)
{
    return code == RESISTANCE || code == HYSTERESIS || code == BACK_EMF_CONSTANT || code ==
        BRUSH_DROP || code == VOLTAGE_OFFSET || code == DEAD_ZONE;
}

/* Whether a term may hold the current where it changes its sign. */
static inline int term_holds_current(int64_t code)
{
    return code == BRUSH_DROP;
}

/* Speed in rad/s where it follows the current. */
INLINE Real following_speed(Real current, Real torque_constant)
{
    return torque_constant * current;
}

/* Torque in N m from current. */
INLINE Real torque_of_current(Real current, Real torque_constant)
{
    return torque_constant * current;
}

/* Current in A from torque. */
INLINE Real current_of_torque(Real torque, Real torque_constant)
{
    return torque / torque_constant;
}

/* A term for a coefficient of one, and its derivatives. */
INLINE Term term(int64_t code, int speed_measured, Real current, Real speed, Real torque_constant,
    Real voltage)
{
    Term t = {{0}, {{0}}};
    switch (code) {
    case RESISTANCE:
        t.value = current;
        t.slope[CURRENT] = all(1.0);
        break;
    case HYSTERESIS:
        t.value = current * absolute(speed);
        t.slope[CURRENT] = speed_measured ? absolute(speed) : torque_constant * current *
            sign(speed) + absolute(speed);
        break;
    case BACK_EMF_CONSTANT:
        t.value = speed;
        t.slope[CURRENT] = speed_measured ? all(0.0) : torque_constant;
        break;
    case BRUSH_DROP:
        t.value = current * (0.01 + absolute(current)) / (0.01 * absolute(current) + 0.0001 +
            current * current);
        t.slope[CURRENT] = -(0.01 * 0.01 * current * sign(current) - 0.01 * 0.01 * absolute(current)
            - 0.01 * 0.0001 - 0.01 * (current * current) + 0.01 * current * absolute(current) *
            sign(current) - 2.0 * 0.0001 * absolute(current)) / ((0.01 * absolute(current) + 0.0001
            + current * current) * (0.01 * absolute(current) + 0.0001 + current * current));
        break;
    case VOLTAGE_OFFSET:
        t.value = 1.0 + 0.0 * current;
        break;
    case DEAD_ZONE:
        t.value = voltage * (0.01 + absolute(voltage)) / (voltage * voltage + 0.01 *
            absolute(voltage) + 0.0001);
        break;
    default: break;
    }
    return t;
}

/* Rates of the states and their derivatives: flow.py, rate. */
INLINE Linear rate_of(
    const Physics *box, const Terms of, const Real *state, Real voltage, Real measured)
{
    Linear linear;
    const Real current = state[CURRENT];
    const Real speed = of.speed_measured ? measured : following_speed(current,
        box->torque_constant);
    Real t1 = voltage;
    Real t2 = all(0.0);
    UNROLL for (int k = 0; k < of.known; k++)
    {
        const Term t = term(of.codes[of.coordinates - 1 + k], of.speed_measured, current, speed,
            box->torque_constant, voltage);
        t1 -= box->constant[k] * t.value;
        t2 -= box->constant[k] * t.slope[CURRENT];
    }
    Real t3 = box->p[0] * t1;
    Real t4 = box->p[0] * t2;
    UNROLL for (int j = 1; j < of.coordinates; j++)
    {
        const Term t = term(of.codes[j - 1], of.speed_measured, current, speed,
            box->torque_constant,
            voltage);
        t3 -= box->p[j] * t.value;
        t4 -= box->p[j] * t.slope[CURRENT];
        linear.by_coordinate[CURRENT][j] = -(t.value);
    }
    linear.value[CURRENT] = t3;
    linear.by_state[CURRENT][CURRENT] = t4;
    linear.by_coordinate[CURRENT][0] = t1;
    return linear;
}

/* flow.py, runge_kutta_step. */
INLINE Linear runge_kutta_step(
    const Physics *box, const Terms of, const Real *start, const Linear *here, const Interval *over)
{
    Linear linear;
    const Real t1 = over->length * (1.0 / 6.0);
    const Real t2 = 0.5 * over->length;
    const Real t3 = 0.5 * (over->speed + over->end_speed);
    const Linear r2 = rate_of(box, of, (Real[]){start[CURRENT] + t2 * here->value[CURRENT]},
        over->voltage, t3);
    const Linear r3 = rate_of(box, of, (Real[]){start[CURRENT] + t2 * r2.value[CURRENT]},
        over->voltage, t3);
    const Linear r4 = rate_of(box, of, (Real[]){start[CURRENT] + over->length * r3.value[CURRENT]},
        over->voltage, over->end_speed);
    linear.value[CURRENT] = start[CURRENT] + t1 * (here->value[CURRENT] + 2.0 * (r2.value[CURRENT] +
        r3.value[CURRENT]) + r4.value[CURRENT]);
    const Real t4 = 2.0 * t1;
    const Real t5 = t4 + over->length * (t1 * r4.by_state[CURRENT][CURRENT]);
    const Real t6 = t4 + t2 * (t5 * r3.by_state[CURRENT][CURRENT]);
    const Real t7 = t1 + t2 * (t6 * r2.by_state[CURRENT][CURRENT]);
    linear.by_state[CURRENT][CURRENT] = 1.0 + (t7 * here->by_state[CURRENT][CURRENT] + t6 *
        r2.by_state[CURRENT][CURRENT] + t5 * r3.by_state[CURRENT][CURRENT] + t1 *
        r4.by_state[CURRENT][CURRENT]);
    UNROLL for (int j = 0; j < of.coordinates; j++)
    {
        linear.by_coordinate[CURRENT][j] = t7 * here->by_coordinate[CURRENT][j] + t6 *
            r2.by_coordinate[CURRENT][j] + t5 * r3.by_coordinate[CURRENT][j] + t1 *
            r4.by_coordinate[CURRENT][j];
    }
    return linear;
}

/* flow.py, _exponential_step. */
INLINE Linear exponential_step(
    const Terms of, const Real *start, const Linear *here, Real length)
{
    Linear linear;
    const Real t1 = (exponential(smaller(here->by_state[CURRENT][CURRENT], all(-1e-12)) * length) -
        1.0) / smaller(here->by_state[CURRENT][CURRENT], all(-1e-12));
    linear.value[CURRENT] = start[CURRENT] + t1 * here->value[CURRENT];
    linear.by_state[CURRENT][CURRENT] = exponential(smaller(here->by_state[CURRENT][CURRENT],
        all(-1e-12)) * length);
    UNROLL for (int j = 0; j < of.coordinates; j++)
    {
        linear.by_coordinate[CURRENT][j] = t1 * here->by_coordinate[CURRENT][j];
    }
    return linear;
}

/* motion.py, joined. */
INLINE Linear joined(const Terms of, const Linear *first, const Linear *then)
{
    Linear linear;
    linear.value[CURRENT] = then->value[CURRENT];
    linear.by_state[CURRENT][CURRENT] = then->by_state[CURRENT][CURRENT] *
        first->by_state[CURRENT][CURRENT];
    UNROLL for (int j = 0; j < of.coordinates; j++)
    {
        linear.by_coordinate[CURRENT][j] = then->by_state[CURRENT][CURRENT] *
            first->by_coordinate[CURRENT][j] + then->by_coordinate[CURRENT][j];
    }
    return linear;
}

#endif
