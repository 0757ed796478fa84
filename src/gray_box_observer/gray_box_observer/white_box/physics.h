/* What the forms of forms.h are of: the same as in motor.py and flow.py, LANES motors at a time. */
#ifndef GRAY_BOX_OBSERVER_WHITE_BOX_PHYSICS_H
#define GRAY_BOX_OBSERVER_WHITE_BOX_PHYSICS_H

#define MOST_COORDINATES 5
#define MOST_KNOWN 8

/* Which terms the balance has: how many coordinates, how many known terms, whether speed is
 * measured, and the codes of the unknown terms without inductance, then of the known ones. What the
 * compiler is told it folds away. */
typedef struct {
    int coordinates, known, speed_measured;
    const int64_t *codes;
} Terms;

/* The numbers in it; the constants of the known terms are given. */
typedef struct {
    Real torque_constant, p[MOST_COORDINATES], constant[MOST_KNOWN];
} Physics;

/* A term for a coefficient of one, and its derivatives by the states. */
typedef struct {
    Real value, slope[STATES];
} Term;

/* Rates of the states, or where an interval leads, and their derivatives by the states and every
 * coordinate. */
typedef struct {
    Real value[STATES], by_state[STATES][STATES], by_coordinate[STATES][MOST_COORDINATES];
} Linear;

/* An interval, or a part of one: voltage held over it, measured speeds at its ends, and how long it
 * lasts. */
typedef struct {
    Real voltage, speed, end_speed, length;
} Interval;

#endif
