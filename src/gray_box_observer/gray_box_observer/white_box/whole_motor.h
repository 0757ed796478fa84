/* Forms of a motor with a rotor for compiled code, one motor at a time.
 * Written by `make physics` from declaration.py: change that, not this. */
#ifndef GRAY_BOX_OBSERVER_WHITE_BOX_WHOLE_MOTOR_H
#define GRAY_BOX_OBSERVER_WHITE_BOX_WHOLE_MOTOR_H

#include "white_box/scalar.h"

#define WHOLE_MOTOR_FINGERPRINT 57557466951363654

enum { CURRENT, SPEED, STATES };
enum { INDUCTANCE, RESISTANCE, HYSTERESIS, BACK_EMF_CONSTANT, BRUSH_DROP, VOLTAGE_OFFSET, DEAD_ZONE,
    INERTIA, VISCOUS_FRICTION, COULOMB_FRICTION, QUADRATIC_FRICTION, LOAD_TORQUE, COORDINATES };
static const int BALANCE_OF[COORDINATES] = {CURRENT, CURRENT, CURRENT, CURRENT, CURRENT, CURRENT,
    CURRENT, SPEED, SPEED, SPEED, SPEED, SPEED};

typedef struct {
    Real value[STATES], by_state[STATES][STATES], by_coordinate[STATES][COORDINATES];
} Linear;

/* flow.py, rate. */
INLINE Linear rate_of(
    const Real *p, Real torque_constant, const Real *state, Real voltage)
{
    Linear linear;
    const Real t1 = state[CURRENT] * absolute(state[SPEED]);
    const Real t2 = state[CURRENT] * (0.0005 + absolute(state[CURRENT])) / (2.5e-07 + 0.0005 *
        absolute(state[CURRENT]) + state[CURRENT] * state[CURRENT]);
    const Real t3 = voltage * (0.01 + absolute(voltage)) / (voltage * voltage + 0.01 *
        absolute(voltage) + 0.0001);
    linear.value[CURRENT] = p[0] * voltage - p[1] * state[CURRENT] - p[2] * t1 - p[3] * state[SPEED]
        - p[4] * t2 - p[5] - p[6] * t3;
    const Real t4 = 2.5e-07 + 0.0005 * absolute(state[CURRENT]) + state[CURRENT] * state[CURRENT];
    linear.by_state[CURRENT][CURRENT] = -(p[1]) - p[2] * absolute(state[SPEED]) - p[4] *
        (-(-(2.5e-07) * 0.0005 - 2.0 * 2.5e-07 * absolute(state[CURRENT]) + 0.0005 * 0.0005 *
        state[CURRENT] * sign(state[CURRENT]) - 0.0005 * 0.0005 * absolute(state[CURRENT]) - 0.0005
        * (state[CURRENT] * state[CURRENT]) + 0.0005 * state[CURRENT] * absolute(state[CURRENT]) *
        sign(state[CURRENT])) / (t4 * t4));
    linear.by_state[CURRENT][SPEED] = -(p[2] * (state[CURRENT] * sign(state[SPEED]))) - p[3];
    linear.by_coordinate[CURRENT][0] = voltage;
    linear.by_coordinate[CURRENT][1] = -(state[CURRENT]);
    linear.by_coordinate[CURRENT][2] = -(t1);
    linear.by_coordinate[CURRENT][3] = -(state[SPEED]);
    linear.by_coordinate[CURRENT][4] = -(t2);
    linear.by_coordinate[CURRENT][5] = -1.0;
    linear.by_coordinate[CURRENT][6] = -(t3);
    linear.by_coordinate[CURRENT][7] = all(0.0);
    linear.by_coordinate[CURRENT][8] = all(0.0);
    linear.by_coordinate[CURRENT][9] = all(0.0);
    linear.by_coordinate[CURRENT][10] = all(0.0);
    linear.by_coordinate[CURRENT][11] = all(0.0);
    const Real t5 = torque_constant * state[CURRENT];
    const Real t6 = state[SPEED] * (0.03 + absolute(state[SPEED])) / (state[SPEED] * state[SPEED] +
        0.03 * absolute(state[SPEED]) + 0.0009);
    const Real t7 = state[SPEED] * absolute(state[SPEED]);
    linear.value[SPEED] = p[7] * t5 - p[8] * state[SPEED] - p[9] * t6 - p[10] * t7 - p[11];
    linear.by_state[SPEED][CURRENT] = p[7] * torque_constant;
    const Real t8 = state[SPEED] * state[SPEED] + 0.03 * absolute(state[SPEED]) + 0.0009;
    linear.by_state[SPEED][SPEED] = -(p[8]) - p[9] * ((state[SPEED] * state[SPEED] * 0.03 -
        state[SPEED] * (0.03 * 0.03) * sign(state[SPEED]) - state[SPEED] * 0.03 *
        absolute(state[SPEED]) * sign(state[SPEED]) + 0.03 * 0.03 * absolute(state[SPEED]) + 0.03 *
        0.0009 + 2.0 * 0.0009 * absolute(state[SPEED])) / (t8 * t8)) - p[10] * (2.0 *
        absolute(state[SPEED]));
    linear.by_coordinate[SPEED][0] = all(0.0);
    linear.by_coordinate[SPEED][1] = all(0.0);
    linear.by_coordinate[SPEED][2] = all(0.0);
    linear.by_coordinate[SPEED][3] = all(0.0);
    linear.by_coordinate[SPEED][4] = all(0.0);
    linear.by_coordinate[SPEED][5] = all(0.0);
    linear.by_coordinate[SPEED][6] = all(0.0);
    linear.by_coordinate[SPEED][7] = t5;
    linear.by_coordinate[SPEED][8] = -(state[SPEED]);
    linear.by_coordinate[SPEED][9] = -(t6);
    linear.by_coordinate[SPEED][10] = -(t7);
    linear.by_coordinate[SPEED][11] = -1.0;
    return linear;
}

/* flow.py, runge_kutta_step. */
INLINE Linear runge_kutta_step(
    const Real *p, Real torque_constant, const Real *start, const Linear *here,
    Real voltage, Real length)
{
    Linear linear;
    const Real t1 = length * (1.0 / 6.0);
    const Real t2 = 0.5 * length;
    const Linear r2 = rate_of(p, torque_constant, (Real[]){start[CURRENT] + t2 *
        here->value[CURRENT], start[SPEED] + t2 * here->value[SPEED]}, voltage);
    const Linear r3 = rate_of(p, torque_constant, (Real[]){start[CURRENT] + t2 * r2.value[CURRENT],
        start[SPEED] + t2 * r2.value[SPEED]}, voltage);
    const Linear r4 = rate_of(p, torque_constant, (Real[]){start[CURRENT] + length *
        r3.value[CURRENT], start[SPEED] + length * r3.value[SPEED]}, voltage);
    linear.value[CURRENT] = start[CURRENT] + t1 * (here->value[CURRENT] + 2.0 * (r2.value[CURRENT] +
        r3.value[CURRENT]) + r4.value[CURRENT]);
    const Real t3 = 2.0 * t1;
    const Real t4 = t3 + length * (t1 * r4.by_state[CURRENT][CURRENT]);
    const Real t5 = length * (t1 * r4.by_state[CURRENT][SPEED]);
    const Real t6 = t3 + t2 * (t4 * r3.by_state[CURRENT][CURRENT] + t5 *
        r3.by_state[SPEED][CURRENT]);
    const Real t7 = t2 * (t4 * r3.by_state[CURRENT][SPEED] + t5 * r3.by_state[SPEED][SPEED]);
    const Real t8 = t1 + t2 * (t6 * r2.by_state[CURRENT][CURRENT] + t7 *
        r2.by_state[SPEED][CURRENT]);
    const Real t9 = t2 * (t6 * r2.by_state[CURRENT][SPEED] + t7 * r2.by_state[SPEED][SPEED]);
    linear.by_state[CURRENT][CURRENT] = 1.0 + (t8 * here->by_state[CURRENT][CURRENT] + t9 *
        here->by_state[SPEED][CURRENT] + (t6 * r2.by_state[CURRENT][CURRENT] + t7 *
        r2.by_state[SPEED][CURRENT]) + (t4 * r3.by_state[CURRENT][CURRENT] + t5 *
        r3.by_state[SPEED][CURRENT]) + t1 * r4.by_state[CURRENT][CURRENT]);
    linear.by_state[CURRENT][SPEED] = t8 * here->by_state[CURRENT][SPEED] + t9 *
        here->by_state[SPEED][SPEED] + (t6 * r2.by_state[CURRENT][SPEED] + t7 *
        r2.by_state[SPEED][SPEED]) + (t4 * r3.by_state[CURRENT][SPEED] + t5 *
        r3.by_state[SPEED][SPEED]) + t1 * r4.by_state[CURRENT][SPEED];
    linear.by_coordinate[CURRENT][0] = t8 * here->by_coordinate[CURRENT][0] + t6 *
        r2.by_coordinate[CURRENT][0] + t4 * r3.by_coordinate[CURRENT][0] + t1 *
        r4.by_coordinate[CURRENT][0];
    linear.by_coordinate[CURRENT][1] = t8 * here->by_coordinate[CURRENT][1] + t6 *
        r2.by_coordinate[CURRENT][1] + t4 * r3.by_coordinate[CURRENT][1] + t1 *
        r4.by_coordinate[CURRENT][1];
    linear.by_coordinate[CURRENT][2] = t8 * here->by_coordinate[CURRENT][2] + t6 *
        r2.by_coordinate[CURRENT][2] + t4 * r3.by_coordinate[CURRENT][2] + t1 *
        r4.by_coordinate[CURRENT][2];
    linear.by_coordinate[CURRENT][3] = t8 * here->by_coordinate[CURRENT][3] + t6 *
        r2.by_coordinate[CURRENT][3] + t4 * r3.by_coordinate[CURRENT][3] + t1 *
        r4.by_coordinate[CURRENT][3];
    linear.by_coordinate[CURRENT][4] = t8 * here->by_coordinate[CURRENT][4] + t6 *
        r2.by_coordinate[CURRENT][4] + t4 * r3.by_coordinate[CURRENT][4] + t1 *
        r4.by_coordinate[CURRENT][4];
    linear.by_coordinate[CURRENT][5] = t8 * here->by_coordinate[CURRENT][5] + t6 *
        r2.by_coordinate[CURRENT][5] + t4 * r3.by_coordinate[CURRENT][5] + t1 *
        r4.by_coordinate[CURRENT][5];
    linear.by_coordinate[CURRENT][6] = t8 * here->by_coordinate[CURRENT][6] + t6 *
        r2.by_coordinate[CURRENT][6] + t4 * r3.by_coordinate[CURRENT][6] + t1 *
        r4.by_coordinate[CURRENT][6];
    linear.by_coordinate[CURRENT][7] = t9 * here->by_coordinate[SPEED][7] + t7 *
        r2.by_coordinate[SPEED][7] + t5 * r3.by_coordinate[SPEED][7];
    linear.by_coordinate[CURRENT][8] = t9 * here->by_coordinate[SPEED][8] + t7 *
        r2.by_coordinate[SPEED][8] + t5 * r3.by_coordinate[SPEED][8];
    linear.by_coordinate[CURRENT][9] = t9 * here->by_coordinate[SPEED][9] + t7 *
        r2.by_coordinate[SPEED][9] + t5 * r3.by_coordinate[SPEED][9];
    linear.by_coordinate[CURRENT][10] = t9 * here->by_coordinate[SPEED][10] + t7 *
        r2.by_coordinate[SPEED][10] + t5 * r3.by_coordinate[SPEED][10];
    linear.by_coordinate[CURRENT][11] = t9 * here->by_coordinate[SPEED][11] + t7 *
        r2.by_coordinate[SPEED][11] + t5 * r3.by_coordinate[SPEED][11];
    linear.value[SPEED] = start[SPEED] + t1 * (here->value[SPEED] + 2.0 * (r2.value[SPEED] +
        r3.value[SPEED]) + r4.value[SPEED]);
    const Real t10 = length * (t1 * r4.by_state[SPEED][CURRENT]);
    const Real t11 = t3 + length * (t1 * r4.by_state[SPEED][SPEED]);
    const Real t12 = t2 * (t10 * r3.by_state[CURRENT][CURRENT] + t11 * r3.by_state[SPEED][CURRENT]);
    const Real t13 = t3 + t2 * (t10 * r3.by_state[CURRENT][SPEED] + t11 *
        r3.by_state[SPEED][SPEED]);
    const Real t14 = t2 * (t12 * r2.by_state[CURRENT][CURRENT] + t13 * r2.by_state[SPEED][CURRENT]);
    const Real t15 = t1 + t2 * (t12 * r2.by_state[CURRENT][SPEED] + t13 *
        r2.by_state[SPEED][SPEED]);
    linear.by_state[SPEED][CURRENT] = t14 * here->by_state[CURRENT][CURRENT] + t15 *
        here->by_state[SPEED][CURRENT] + (t12 * r2.by_state[CURRENT][CURRENT] + t13 *
        r2.by_state[SPEED][CURRENT]) + (t10 * r3.by_state[CURRENT][CURRENT] + t11 *
        r3.by_state[SPEED][CURRENT]) + t1 * r4.by_state[SPEED][CURRENT];
    linear.by_state[SPEED][SPEED] = 1.0 + (t14 * here->by_state[CURRENT][SPEED] + t15 *
        here->by_state[SPEED][SPEED] + (t12 * r2.by_state[CURRENT][SPEED] + t13 *
        r2.by_state[SPEED][SPEED]) + (t10 * r3.by_state[CURRENT][SPEED] + t11 *
        r3.by_state[SPEED][SPEED]) + t1 * r4.by_state[SPEED][SPEED]);
    linear.by_coordinate[SPEED][0] = t14 * here->by_coordinate[CURRENT][0] + t12 *
        r2.by_coordinate[CURRENT][0] + t10 * r3.by_coordinate[CURRENT][0];
    linear.by_coordinate[SPEED][1] = t14 * here->by_coordinate[CURRENT][1] + t12 *
        r2.by_coordinate[CURRENT][1] + t10 * r3.by_coordinate[CURRENT][1];
    linear.by_coordinate[SPEED][2] = t14 * here->by_coordinate[CURRENT][2] + t12 *
        r2.by_coordinate[CURRENT][2] + t10 * r3.by_coordinate[CURRENT][2];
    linear.by_coordinate[SPEED][3] = t14 * here->by_coordinate[CURRENT][3] + t12 *
        r2.by_coordinate[CURRENT][3] + t10 * r3.by_coordinate[CURRENT][3];
    linear.by_coordinate[SPEED][4] = t14 * here->by_coordinate[CURRENT][4] + t12 *
        r2.by_coordinate[CURRENT][4] + t10 * r3.by_coordinate[CURRENT][4];
    linear.by_coordinate[SPEED][5] = t14 * here->by_coordinate[CURRENT][5] + t12 *
        r2.by_coordinate[CURRENT][5] + t10 * r3.by_coordinate[CURRENT][5];
    linear.by_coordinate[SPEED][6] = t14 * here->by_coordinate[CURRENT][6] + t12 *
        r2.by_coordinate[CURRENT][6] + t10 * r3.by_coordinate[CURRENT][6];
    linear.by_coordinate[SPEED][7] = t15 * here->by_coordinate[SPEED][7] + t13 *
        r2.by_coordinate[SPEED][7] + t11 * r3.by_coordinate[SPEED][7] + t1 *
        r4.by_coordinate[SPEED][7];
    linear.by_coordinate[SPEED][8] = t15 * here->by_coordinate[SPEED][8] + t13 *
        r2.by_coordinate[SPEED][8] + t11 * r3.by_coordinate[SPEED][8] + t1 *
        r4.by_coordinate[SPEED][8];
    linear.by_coordinate[SPEED][9] = t15 * here->by_coordinate[SPEED][9] + t13 *
        r2.by_coordinate[SPEED][9] + t11 * r3.by_coordinate[SPEED][9] + t1 *
        r4.by_coordinate[SPEED][9];
    linear.by_coordinate[SPEED][10] = t15 * here->by_coordinate[SPEED][10] + t13 *
        r2.by_coordinate[SPEED][10] + t11 * r3.by_coordinate[SPEED][10] + t1 *
        r4.by_coordinate[SPEED][10];
    linear.by_coordinate[SPEED][11] = t15 * here->by_coordinate[SPEED][11] + t13 *
        r2.by_coordinate[SPEED][11] + t11 * r3.by_coordinate[SPEED][11] + t1 *
        r4.by_coordinate[SPEED][11];
    return linear;
}

/* flow.py, _exponential_step. */
INLINE Linear exponential_step(
    const Real *start, const Linear *here, Real length)
{
    Linear linear;
    const Real t1 = (exponential(smaller(here->by_state[CURRENT][CURRENT], all(-1e-12)) * length) -
        1.0) / smaller(here->by_state[CURRENT][CURRENT], all(-1e-12));
    linear.value[CURRENT] = start[CURRENT] + t1 * here->value[CURRENT];
    linear.by_state[CURRENT][CURRENT] = exponential(smaller(here->by_state[CURRENT][CURRENT],
        all(-1e-12)) * length);
    linear.by_state[CURRENT][SPEED] = t1 * here->by_state[CURRENT][SPEED];
    const Real t2 = (exponential(smaller(here->by_state[SPEED][SPEED], all(-1e-12)) * length) - 1.0)
        / smaller(here->by_state[SPEED][SPEED], all(-1e-12));
    linear.value[SPEED] = start[SPEED] + t2 * here->value[SPEED];
    linear.by_state[SPEED][CURRENT] = t2 * here->by_state[SPEED][CURRENT];
    linear.by_state[SPEED][SPEED] = exponential(smaller(here->by_state[SPEED][SPEED], all(-1e-12)) *
        length);
    UNROLL for (int j = 0; j < COORDINATES; j++)
    {
        linear.by_coordinate[CURRENT][j] = t1 * here->by_coordinate[CURRENT][j];
        linear.by_coordinate[SPEED][j] = t2 * here->by_coordinate[SPEED][j];
    }
    return linear;
}

/* motion.py, joined. */
INLINE Linear joined(
    const Linear *first, const Linear *then)
{
    Linear linear;
    linear.value[CURRENT] = then->value[CURRENT];
    linear.by_state[CURRENT][CURRENT] = then->by_state[CURRENT][CURRENT] *
        first->by_state[CURRENT][CURRENT] + then->by_state[CURRENT][SPEED] *
        first->by_state[SPEED][CURRENT];
    linear.by_state[CURRENT][SPEED] = then->by_state[CURRENT][CURRENT] *
        first->by_state[CURRENT][SPEED] + then->by_state[CURRENT][SPEED] *
        first->by_state[SPEED][SPEED];
    linear.value[SPEED] = then->value[SPEED];
    linear.by_state[SPEED][CURRENT] = then->by_state[SPEED][CURRENT] *
        first->by_state[CURRENT][CURRENT] + then->by_state[SPEED][SPEED] *
        first->by_state[SPEED][CURRENT];
    linear.by_state[SPEED][SPEED] = then->by_state[SPEED][CURRENT] * first->by_state[CURRENT][SPEED]
        + then->by_state[SPEED][SPEED] * first->by_state[SPEED][SPEED];
    UNROLL for (int j = 0; j < COORDINATES; j++)
    {
        linear.by_coordinate[CURRENT][j] = then->by_state[CURRENT][CURRENT] *
            first->by_coordinate[CURRENT][j] + then->by_state[CURRENT][SPEED] *
            first->by_coordinate[SPEED][j] + then->by_coordinate[CURRENT][j];
        linear.by_coordinate[SPEED][j] = then->by_state[SPEED][CURRENT] *
            first->by_coordinate[CURRENT][j] + then->by_state[SPEED][SPEED] *
            first->by_coordinate[SPEED][j] + then->by_coordinate[SPEED][j];
    }
    return linear;
}

#endif
