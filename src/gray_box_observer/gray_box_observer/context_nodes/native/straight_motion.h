/* The motion of a motor with a rotor where its rate is straight in the states, in closed form:
 * context_nodes/rotor/straight_motion.py for compiled code. */
#ifndef GRAY_BOX_OBSERVER_STRAIGHT_MOTION_H
#define GRAY_BOX_OBSERVER_STRAIGHT_MOTION_H

#include "white_box/whole_motor.h"

enum { HALVINGS = 8, LEVELS = HALVINGS + 2, MOST_HALVINGS = 48, TERMS_OF_SERIES = 6, POINTS = 6 };
#define SHORT 0.02     /* product of rate and length up to which the series is right to rounding */
#define CONSTANT 1e-6  /* share of an effect by which a straight one may bend */
#define STRAIGHT 1e-5  /* share of the rates by which a motion may depart from a straight one */

/* Over one length: `state` is how the end answers the start, `rate` how it answers the rate at the
 * start, `slope[b][s][r][m]` how state s at the end answers, by way of a slope of balance b with
 * state r, the rate of state m at the start. */
typedef struct {
    double state[STATES][STATES], rate[STATES][STATES], slope[STATES][STATES][STATES][STATES];
} Level;

/* Of every length `length / 2^k`; `is_made` is 0 where the rate is straight nowhere. */
typedef struct {
    int is_made, bends[STATES];
    double length, jacobian[STATES][STATES], gradient[STATES][COORDINATES][STATES];
    Level level[LEVELS];
} Ladder;

/* The series of a short length: sums of J^a (..) J^c length^n / n!. */
static void series(const double jacobian[STATES][STATES], double length, Level *out)
{
    double power[TERMS_OF_SERIES + 1][STATES][STATES] = {{{1.0, 0.0}, {0.0, 1.0}}};
    double weight[TERMS_OF_SERIES + 3] = {1.0};
    for (int n = 1; n < TERMS_OF_SERIES + 3; n++) weight[n] = weight[n - 1] * length / n;
    for (int n = 1; n <= TERMS_OF_SERIES; n++)
        for (int s = 0; s < STATES; s++)
            for (int r = 0; r < STATES; r++)
                power[n][s][r] = jacobian[s][CURRENT] * power[n - 1][CURRENT][r] +
                                 jacobian[s][SPEED] * power[n - 1][SPEED][r];
    *out = (Level){{{0}}, {{0}}, {{{{0}}}}};
    for (int n = TERMS_OF_SERIES; n >= 0; n--)
        for (int s = 0; s < STATES; s++)
            for (int r = 0; r < STATES; r++) {
                out->state[s][r] += weight[n] * power[n][s][r];
                out->rate[s][r] += weight[n + 1] * power[n][s][r];
            }
    for (int a = TERMS_OF_SERIES; a >= 0; a--)
        for (int c = TERMS_OF_SERIES - a; c >= 0; c--)
            for (int b = 0; b < STATES; b++)
                for (int s = 0; s < STATES; s++)
                    for (int r = 0; r < STATES; r++)
                        for (int m = 0; m < STATES; m++)
                            out->slope[b][s][r][m] +=
                                weight[a + c + 2] * power[a][s][b] * power[c][r][m];
}

/* What twice the length does. */
static void doubled(const Level *one, Level *two)
{
    for (int s = 0; s < STATES; s++)
        for (int r = 0; r < STATES; r++) {
            double state = 0.0, rate = one->rate[s][r];
            for (int k = 0; k < STATES; k++) {
                state += one->state[s][k] * one->state[k][r];
                rate += one->state[s][k] * one->rate[k][r];
            }
            two->state[s][r] = state;
            two->rate[s][r] = rate;
        }
    for (int b = 0; b < STATES; b++)
        for (int s = 0; s < STATES; s++)
            for (int r = 0; r < STATES; r++)
                for (int m = 0; m < STATES; m++) {
                    double sum = one->rate[s][b] * one->rate[r][m];
                    for (int k = 0; k < STATES; k++)
                        sum += one->state[s][k] * one->slope[b][k][r][m] +
                               one->state[r][k] * one->slope[b][s][k][m];
                    two->slope[b][s][r][m] = sum;
                }
}

/* Whether an effect is straight over six points of a corner, and its slopes there. */
INLINE int is_straight(const double *q, const double *span, double *gradient)
{
    double size = 0.0;
    for (int point = 0; point < POINTS; point++) size = larger(size, absolute(q[point]));
    gradient[CURRENT] = (q[0] - q[1]) / (0.5 * span[CURRENT]);
    gradient[SPEED] = (q[0] - q[3]) / (0.5 * span[SPEED]);
    return absolute(q[0] - 2.0 * q[2] + q[1]) <= CONSTANT * size &&
           absolute(q[0] - 2.0 * q[4] + q[3]) <= CONSTANT * size &&
           absolute(q[0] - q[1] - q[3] + q[5]) <= CONSTANT * size;
}

/* Look for effects that are straight far from zero, and prepare every length `length / 2^k`. */
static void ladder_made(const double *p, double torque_constant, const double *far, double length,
                        Ladder *ladder)
{
    static const double share[POINTS][STATES] = {
        {1.0, 1.0}, {0.5, 1.0}, {0.75, 1.0}, {1.0, 0.5}, {1.0, 0.75}, {0.5, 0.5}};
    Linear rate[POINTS];
    ladder->is_made = 0;
    ladder->length = length;
    for (int point = 0; point < POINTS; point++) {
        const double at[STATES] = {share[point][CURRENT] * far[CURRENT],
                                   share[point][SPEED] * far[SPEED]};
        rate[point] = rate_of(p, torque_constant, at, 0.0);
    }
    for (int b = 0; b < STATES; b++)
        for (int j = 0; j < COORDINATES; j++) {
            double q[POINTS];
            for (int point = 0; point < POINTS; point++) q[point] = rate[point].by_coordinate[b][j];
            if (!is_straight(q, far, ladder->gradient[b][j])) {
                if (p[j] != 0.0) return;
                for (int r = 0; r < STATES; r++) ladder->gradient[b][j][r] = 0.0;
            }
        }
    double size = 0.0;
    for (int s = 0; s < STATES; s++)
        for (int r = 0; r < STATES; r++) {
            ladder->jacobian[s][r] = rate[0].by_state[s][r];
            size += absolute(rate[0].by_state[s][r]);
        }
    for (int s = 0; s < STATES; s++) {
        const double at[STATES] = {s == CURRENT ? 0.0 : far[CURRENT],
                                   s == SPEED ? 0.0 : far[SPEED]};
        const Linear there = rate_of(p, torque_constant, at, 0.0);
        double apart = 0.0;
        for (int r = 0; r < STATES; r++)
            for (int m = 0; m < STATES; m++)
                apart += absolute(there.by_state[r][m] - ladder->jacobian[r][m]);
        ladder->bends[s] = !(apart <= CONSTANT * size);
    }
    double least = length;
    int halvings = 0;
    while (!(size * least <= SHORT) || halvings < LEVELS - 1) {
        if (halvings == MOST_HALVINGS) return;
        least *= 0.5;
        halvings++;
    }
    Level here, next;
    series(ladder->jacobian, least, &here);
    for (int k = halvings;; k--) {
        if (k < LEVELS) ladder->level[k] = here;
        if (k == 0) break;
        doubled(&here, &next);
        here = next;
    }
    ladder->is_made = 1;
}

/* Whether the rate somewhere departs from a straight one by less than matters. */
INLINE int is_near(const Ladder *ladder, const double *start, const Linear *here, const double *at,
                   const Linear *there)
{
    for (int s = 0; s < STATES; s++) {
        double off = there->value[s] - here->value[s], size = 0.0;
        for (int r = 0; r < STATES; r++) {
            off -= ladder->jacobian[s][r] * (at[r] - start[r]);
            size += absolute(ladder->jacobian[s][r]) * larger(absolute(at[r]), absolute(start[r]));
        }
        if (!(absolute(off) <= STRAIGHT * size)) return 0;
    }
    return 1;
}

/* Move on by the length of a level; returns 0 where the rate is not straight on the way. */
static int straight_moved(const Ladder *ladder, int level, const double *p, double torque_constant,
                          const double *start, const Linear *here, double voltage, double length,
                          Linear *moved)
{
    const Level *way = ladder->level + level, *half = way + 1;
    double end[STATES], middle[STATES];
    for (int s = 0; s < STATES; s++) {
        const double ahead = here->value[s] * length;
        if (ladder->bends[s] && ahead * start[s] <= 0.0 && absolute(start[s]) <= absolute(ahead))
            return 0;
        end[s] = middle[s] = start[s];
        for (int r = 0; r < STATES; r++) {
            end[s] += way->rate[s][r] * here->value[r];
            middle[s] += half->rate[s][r] * here->value[r];
        }
        if (ladder->bends[s] && !(start[s] * end[s] > 0.0 && start[s] * middle[s] > 0.0)) return 0;
    }
    const Linear last = rate_of(p, torque_constant, end, voltage);
    if (!is_near(ladder, start, here, end, &last)) return 0;
    const Linear between = rate_of(p, torque_constant, middle, voltage);
    if (!is_near(ladder, start, here, middle, &between)) return 0;
    double turned[STATES][STATES][STATES];
    for (int b = 0; b < STATES; b++)
        for (int s = 0; s < STATES; s++)
            for (int r = 0; r < STATES; r++)
                turned[b][s][r] = way->slope[b][s][r][CURRENT] * here->value[CURRENT] +
                                  way->slope[b][s][r][SPEED] * here->value[SPEED];
    for (int s = 0; s < STATES; s++) {
        moved->value[s] = end[s];
        for (int r = 0; r < STATES; r++) moved->by_state[s][r] = way->state[s][r];
        UNROLL for (int j = 0; j < COORDINATES; j++) { /* each stands in one balance */
            const int b = BALANCE_OF[j];
            double sum = way->rate[s][b] * here->by_coordinate[b][j];
            for (int r = 0; r < STATES; r++) sum += turned[b][s][r] * ladder->gradient[b][j][r];
            moved->by_coordinate[s][j] = sum;
        }
    }
    return 1;
}

#endif
