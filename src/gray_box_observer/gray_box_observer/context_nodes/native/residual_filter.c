/* Residuals of current and speed without what noise of the voltage leaves in them:
 * context_nodes/rotor/noise_filter.py for compiled code. */
#include <math.h>
#include <stdint.h>
#include <string.h>

enum { CURRENT, SPEED, STATES };
enum { TERMS_OF_SERIES = 6, MOST_HALVINGS = 48 };
#define SHORT 0.02 /* product of rate and length up to which the series is right to rounding */

/* Everything a call needs; native/residual_filter.py holds the same list. Arrays are contiguous. */
typedef struct {
    int64_t samples, columns, outputs;
    double jacobian[STATES * STATES]; /* of the rates of a rotor that turns, by the states */
    double drive;                     /* rate of the current by the voltage */
    double noise;                     /* variance of the readings of either output */
    double unit;                      /* in which the speed is read */
    const double *length, *voltage;   /* (interval): how long it is, variance of its voltage */
    const uint8_t *is_held;           /* (interval): whether friction holds the rotor */
    const uint8_t *is_read;           /* (sample): whether the speed is */
    const double *rows;               /* (output, sample, column) */
    double *result;                   /* likewise */
    double *deviations;               /* (sample, column, state), where they are asked for */
} ResidualFilter;

/* What an interval does to states that deviate, and to their covariance. */
typedef struct {
    double length, state[STATES][STATES], drive[STATES];
} Motion;

int64_t residual_filter_size(void) { return (int64_t)sizeof(ResidualFilter); }

/* The motion over a length: its series over a small part of it, then doubled. */
static void motion_made(const double *jacobian, double drive, double length, int states,
                        Motion *made)
{
    double size = 0.0, part = length, term[STATES][STATES] = {{1.0, 0.0}, {0.0, 1.0}};
    double state[STATES][STATES] = {{1.0, 0.0}, {0.0, 1.0}}, rate[STATES][STATES] = {{0}};
    int halvings = 0;
    for (int s = 0; s < states; s++)
        for (int r = 0; r < states; r++) size += fabs(jacobian[s * STATES + r]);
    while (!(size * part <= SHORT) && halvings < MOST_HALVINGS) part *= 0.5, halvings++;
    for (int n = 1; n <= TERMS_OF_SERIES; n++) {
        double next[STATES][STATES] = {{0}};
        for (int s = 0; s < states; s++)
            for (int r = 0; r < states; r++) {
                rate[s][r] += term[s][r] * part / n;
                for (int k = 0; k < states; k++)
                    next[s][r] += jacobian[s * STATES + k] * term[k][r] * part / n;
            }
        for (int s = 0; s < states; s++)
            for (int r = 0; r < states; r++) state[s][r] += term[s][r] = next[s][r];
    }
    for (; halvings > 0; halvings--) {
        double twice[STATES][STATES], longer[STATES][STATES];
        for (int s = 0; s < states; s++)
            for (int r = 0; r < states; r++) {
                twice[s][r] = 0.0, longer[s][r] = rate[s][r];
                for (int k = 0; k < states; k++) {
                    twice[s][r] += state[s][k] * state[k][r];
                    longer[s][r] += state[s][k] * rate[k][r];
                }
            }
        for (int s = 0; s < states; s++)
            for (int r = 0; r < states; r++) state[s][r] = twice[s][r], rate[s][r] = longer[s][r];
    }
    *made = (Motion){length, {{0}}, {0}};
    for (int s = 0; s < states; s++) {
        for (int r = 0; r < states; r++) made->state[s][r] = state[s][r];
        made->drive[s] = rate[s][CURRENT] * drive;
    }
}

/* Correct by the reading of one state in a unit; returns by what its innovation is divided. */
static double gains_of(double covariance[STATES][STATES], int read, double unit, double noise,
                       double gain[STATES])
{
    const double variance = unit * unit * covariance[read][read] + noise;
    double row[STATES];
    for (int s = 0; s < STATES; s++) row[s] = covariance[read][s];
    for (int s = 0; s < STATES; s++) gain[s] = unit * covariance[s][read] / variance;
    for (int s = 0; s < STATES; s++)
        for (int r = 0; r < STATES; r++) covariance[s][r] -= gain[s] * unit * row[r];
    return sqrt(noise / variance);
}

/* Filter all columns: what is left is white, as large as the noise of the readings. Deviations are
 * what the states are known to deviate by. `states` has room for [column][STATES], all 0. */
void filter_noise(const ResidualFilter *f, double *states)
{
    double covariance[STATES][STATES] = {{0}};
    Motion motions[2] = {{-1.0, {{0}}, {0}}, {-1.0, {{0}}, {0}}};
    for (int64_t k = 0; k < f->samples; k++) {
        if (k > 0) {
            const int is_held = f->is_held[k - 1] != 0;
            Motion *over = motions + is_held;
            if (over->length != f->length[k - 1])
                motion_made(f->jacobian, f->drive, f->length[k - 1], is_held ? 1 : STATES, over);
            double half[STATES][STATES];
            for (int s = 0; s < STATES; s++)
                for (int r = 0; r < STATES; r++)
                    half[s][r] = over->state[s][CURRENT] * covariance[CURRENT][r] +
                                 over->state[s][SPEED] * covariance[SPEED][r];
            for (int s = 0; s < STATES; s++)
                for (int r = 0; r < STATES; r++)
                    covariance[s][r] = half[s][CURRENT] * over->state[r][CURRENT] +
                                       half[s][SPEED] * over->state[r][SPEED] +
                                       f->voltage[k - 1] * over->drive[s] * over->drive[r];
            for (int64_t j = 0; j < f->columns; j++) {
                double *x = states + j * STATES;
                const double current = x[CURRENT], speed = x[SPEED];
                for (int s = 0; s < STATES; s++)
                    x[s] = over->state[s][CURRENT] * current + over->state[s][SPEED] * speed;
            }
        }
        for (int output = 0; output < f->outputs; output++) {
            const int64_t place = (output * f->samples + k) * f->columns;
            const double *reading = f->rows + place;
            double *white = f->result + place, gain[STATES] = {0}, scale = 1.0, unit = 0.0;
            if (output == CURRENT || f->is_read[k]) {
                unit = output == CURRENT ? 1.0 : f->unit;
                scale = gains_of(covariance, output, unit, f->noise, gain);
            }
            for (int64_t j = 0; j < f->columns; j++) {
                double *x = states + j * STATES;
                const double innovation = reading[j] - unit * x[output];
                white[j] = scale * innovation;
                for (int s = 0; s < STATES; s++) x[s] += gain[s] * innovation;
            }
        }
        if (f->deviations)
            memcpy(f->deviations + k * f->columns * STATES, states,
                   f->columns * STATES * sizeof(double));
    }
}

/* Move the states by small voltages over every interval, (interval, column); `states` has room for
 * [sample][column][STATES], all of them 0. */
void move_by_noise(const ResidualFilter *f, const double *voltages, double *states)
{
    Motion motions[2] = {{-1.0, {{0}}, {0}}, {-1.0, {{0}}, {0}}};
    for (int64_t k = 0; k + 1 < f->samples; k++) {
        const int is_held = f->is_held[k] != 0;
        Motion *over = motions + is_held;
        if (over->length != f->length[k])
            motion_made(f->jacobian, f->drive, f->length[k], is_held ? 1 : STATES, over);
        for (int64_t j = 0; j < f->columns; j++) {
            const double *x = states + (k * f->columns + j) * STATES;
            double *to = states + ((k + 1) * f->columns + j) * STATES;
            for (int s = 0; s < STATES; s++)
                to[s] = over->state[s][CURRENT] * x[CURRENT] + over->state[s][SPEED] * x[SPEED] +
                        over->drive[s] * voltages[k * f->columns + j];
        }
    }
}
