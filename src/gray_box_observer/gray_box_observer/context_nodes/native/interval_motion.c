/* The motion over many intervals of a motor, LANES at a time, and linear recurrences along them.
 *
 * Batch fits and the search for a delay move every interval of a window from a start of its own:
 * white_box/flow.py. Intervals whose decay is no number are left to numpy.
 */
#include <string.h>

#define UNROLL /* the build takes a ninth of the time, the motion little more */
#include "white_box/flow.h"
#include "white_box/held_current.h"

/* Everything a call needs; interval_motion.py holds the same list. Arrays are contiguous. */
typedef struct {
    int64_t motors, intervals, coordinates, known_terms, speed_measured;
    /* codes of the unknown terms without inductance, then of the known ones */
    int64_t codes[MOST_COORDINATES + MOST_KNOWN];
    double largest_step, most_steps;
    const double *p, *known; /* (motor, coordinate), (known term, motor) */
    const double *torque_constant; /* (motor,) */
    const double *start, *voltage, *speed, *end_speed, *length; /* (motor, interval) */
    double *outputs; /* (2 + coordinate, motor, interval): values, by state, by coordinate */
    uint8_t *left_out; /* (motor,): whether it was */
} Motions;

/* LANES entries from one on; the last entry fills up. */
INLINE Real entries(const double *array, int64_t from, int64_t count)
{
    Real x = all(0.0);
    if (from + LANES <= count)
        memcpy(&x, array + from, sizeof(Real));
    else
        for (int l = 0; l < LANES; l++) x[l] = array[from + l < count ? from + l : count - 1];
    return x;
}

INLINE void put(double *array, int64_t from, int64_t count, Real x)
{
    if (from + LANES <= count)
        memcpy(array + from, &x, sizeof(Real));
    else
        for (int l = 0; from + l < count; l++) array[from + l] = x[l];
}

/* The intervals of a motor that begin at one of them. */
INLINE Interval intervals_from(const Motions *m, int64_t first, int64_t from)
{
    const Real none = all(0.0);
    return (Interval){
        entries(m->voltage + first, from, m->intervals),
        m->speed_measured ? entries(m->speed + first, from, m->intervals) : none,
        m->speed_measured ? entries(m->end_speed + first, from, m->intervals) : none,
        entries(m->length + first, from, m->intervals),
    };
}

/* Steps that every interval of a motor is gone through in, as in flow.py: more than the most where
 * it is stiff, 0 where its decay is no number. */
INLINE int steps_of(const Motions *m, const Physics *box, const Terms of, int64_t first)
{
    Real stiffness = all(0.0);
    Mask finite = everywhere();
    double most = 0.0;
    for (int64_t j = 0; j < m->intervals; j += LANES) {
        const Interval over = intervals_from(m, first, j);
        const Real start = entries(m->start + first, j, m->intervals);
        const Linear here = rate_of(box, of, &start, over.voltage, over.speed);
        const Real stiff = absolute(here.by_state[CURRENT][CURRENT]) * over.length;
        finite &= stiff < INFINITY;
        stiffness = larger(stiffness, stiff);
    }
    for (int l = 0; l < LANES; l++) most = stiffness[l] > most ? stiffness[l] : most;
    if (anywhere(~finite)) return 0;
    if (most > m->most_steps * m->largest_step) return (int)m->most_steps + 1;
    return most > m->largest_step ? (int)ceil(most / m->largest_step) : 1;
}

INLINE void move_motor(const Motions *m, const Terms of, int64_t motor)
{
    Physics box;
    const int64_t first = motor * m->intervals, all_intervals = m->motors * m->intervals;
    double *value = m->outputs + first, *by_state = value + all_intervals;
    box.torque_constant = all(m->torque_constant[motor]);
    for (int i = 0; i < of.coordinates; i++) box.p[i] = all(m->p[motor * of.coordinates + i]);
    for (int i = 0; i < of.known; i++) box.constant[i] = all(m->known[i * m->motors + motor]);
    const int is_held = holds_current(of);
    const int steps = is_held ? 1 : steps_of(m, &box, of, first);
    const int is_stiff = steps > m->most_steps, parts = is_stiff ? (int)m->most_steps : steps;
    m->left_out[motor] = steps == 0;
    if (steps == 0) return;
    for (int64_t j = 0; j < m->intervals; j += LANES) {
        const Interval over = intervals_from(m, first, j);
        const Real start = entries(m->start + first, j, m->intervals);
        Linear to;
        if (is_held)
            to = held_current_motion(&box, of, start, &over);
        else if (steps == 1) {
            const Linear here = rate_of(&box, of, &start, over.voltage, over.speed);
            to = runge_kutta_step(&box, of, &start, &here, &over);
        } else if (is_stiff)
            to = in_steps(&box, of, &start, &over, all(parts), parts, 1);
        else
            to = in_steps(&box, of, &start, &over, all(parts), parts, 0);
        put(value, j, m->intervals, to.value[CURRENT]);
        put(by_state, j, m->intervals, to.by_state[CURRENT][CURRENT]);
        UNROLL for (int i = 0; i < of.coordinates; i++)
            put(by_state + (1 + i) * all_intervals, j, m->intervals,
                to.by_coordinate[CURRENT][i]);
    }
}

/* Variants for every number of coordinates would be no faster, and the build twice as long. */
CLONES void move_any(const Motions *m)
{
    const Terms of = {
        (int)m->coordinates, (int)m->known_terms, (int)m->speed_measured, m->codes};
    for (int64_t motor = 0; motor < m->motors; motor++) move_motor(m, of, motor);
}

void move_intervals(const Motions *m) { move_any(m); }

/* Size of Motions, by which Python tells that it speaks of the same. */
int64_t motions_size(void) { return (int64_t)sizeof(Motions); }

/* x[j + 1] = factor[j] x[j] + input[j], of `rows` right-hand sides that share the factors:
 * trajectory.py, recurrence. Shapes: factor (motor, k), inputs (row, motor, k), start (row, motor),
 * result (row, motor, k + 1). */
void recurrences(
    int64_t rows, int64_t motors, int64_t k, const double *factor, const double *inputs,
    const double *start, double *result)
{
    for (int64_t series = 0; series < rows * motors; series++) {
        const double *by = factor + series % motors * k, *more = inputs + series * k;
        double *to = result + series * (k + 1), x = start[series];
        to[0] = x;
        for (int64_t j = 0; j < k; j++) to[j + 1] = x = by[j] * x + more[j];
    }
}

/* Variance of the predicted state that restarts leave: trajectory.py, restart_variance. Shapes:
 * decay, restart (motor, k), variance (motor, k + 1). */
void restart_variances(
    int64_t motors, int64_t k, const double *decay, const uint8_t *restart, double unknown,
    double negligible, int64_t settling, double *variance)
{
    for (int64_t motor = 0; motor < motors; motor++, decay += k, restart += k, variance += k + 1) {
        double left = 0.0; /* after the sample before */
        int64_t age = settling;
        variance[0] = 0.0;
        for (int64_t j = 0; j < k; j++) {
            variance[j + 1] = 0.0;
            if (restart[j]) {
                variance[j + 1] = unknown, left = 1.0, age = 1;
            } else if (age < settling && left > negligible) {
                const double predicted = decay[j] * decay[j] * left;
                variance[j + 1] = predicted, left = predicted / (1.0 + predicted), age++;
            } else
                age = settling;
        }
    }
}
