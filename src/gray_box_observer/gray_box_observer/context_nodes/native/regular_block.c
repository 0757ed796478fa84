/* One block of samples learnt in which nothing is out of the ordinary, for LANES motors at a time.
 *
 * What block_step.py, change_test.py, constant_voltage.py and block_updater.py do with numpy
 * arrays for any block, this does for the usual one: no restart, no kick of the state, outliers at
 * most here and there, no doubt about the motor. A motor whose block turns out to be another is
 * left as it was and said to be so; numpy then learns it. Formulas and symbols are those of these
 * modules and of docs/METHOD.md.
 */
#include <stddef.h>
#include <string.h>

#include "white_box/flow.h"
#include "white_box/held_current.h"

#define MOST_UNKNOWNS (MOST_COORDINATES + STATES)
#define MOST_SAMPLES 64
#define MOST_MEMORIES 8
#define ROUNDING 1e-12 /* of a bound: more than its arithmetic, which is some 1e-16 off */

/* What is told of a motor: nothing where its block was not regular. */
enum { LEARNT = 1, LONG_HOLD = 2, ANCHOR_DUE = 4 };

/* Places of the signals in a replay buffer: replay_buffer.py. */
enum { INTERVAL_S, VOLTAGE_V, TORQUE_NM, SPEED_RAD_S };

/* Everything a call needs; regular_block.py holds the same list. Arrays are contiguous, the motor
 * axis first. */
typedef struct {
    int64_t coordinates, samples, memories, known_terms, speed_measured;
    /* the physics: codes of the unknown terms without inductance, then of the known ones */
    int64_t codes[MOST_COORDINATES + MOST_KNOWN];
    double heats[MOST_COORDINATES], lower[MOST_COORDINATES], upper[MOST_COORDINATES];
    const double *known, *torque_constant; /* (known term, motor), (motor,) */
    int64_t motors;
    /* settings */
    double keep[MOST_MEMORIES];
    double outlier, kick, credible, far_away, largest_step, most_steps, threshold, noise_floor;
    double left_out_memory, left_out_limit, hold_tolerance, hold_settled, long_hold_s;
    double correlation_slack, still;
    int64_t noise_memory, replay_capacity;
    /* samples: interval, voltage, torque, speed; shape (signal, motor, column), motors beside each
     * other */
    const double *data;
    int64_t signal_stride, column_stride, columns;
    const int64_t *gone, *end, *begin;
    /* what is believed of the motors; written to */
    const double *current_a, *gain, *least_noise, *walk_rate;
    const int64_t *anchored, *next_fit;
    const uint8_t *hold_begun;
    int64_t *at;
    double *p, *state, *covariance, *noise, *sensitivity;
    double *score, *information;
    int64_t *noise_count, *since, *outliers;
    double *suspicion, *left_out;
    double *hold_level, *hold_largest, *hold_held_s, *hold_p, *hold_covariance;
    uint8_t *hold_settled_now;
    int64_t *due;
    uint8_t *plain;
} Update;

/* Blocks of LANES motors, the first `lanes` of which are meant; the others fill up. Sample 0 is
 * that before a block. */
typedef struct {
    int n, k, lanes, most, beside;
    int64_t motor[LANES];
    Mask fine; /* of which nothing is out of the ordinary so far */
    Physics box;
    Real size, noise, gain, least_noise, steps;
    Real interval[MOST_SAMPLES + 1], voltage[MOST_SAMPLES + 1], measured[MOST_SAMPLES + 1],
        speed[MOST_SAMPLES + 1];
    Real about[MOST_SAMPLES + 1], factor[MOST_SAMPLES];
    /* samples that tell of the state; that are no outliers */
    Mask near[MOST_SAMPLES + 1], kept[MOST_SAMPLES + 1];
    Linear here[MOST_SAMPLES]; /* where an interval begins */
    Linear to[MOST_SAMPLES]; /* and where it leads */
    /* predicted current, and the measured one less it */
    Real path[MOST_SAMPLES + 1], error[MOST_SAMPLES + 1];
    Real covariance[MOST_UNKNOWNS][MOST_UNKNOWNS], sensitivity[MOST_COORDINATES];
    /* where the trajectory begins, ends */
    Real state, end, by_start, by_coordinate[MOST_COORDINATES], squares, used;
    Real info[MOST_UNKNOWNS][MOST_UNKNOWNS], right[MOST_UNKNOWNS];
    Real scores[MOST_MEMORIES][MOST_COORDINATES],
        tested[MOST_MEMORIES][MOST_COORDINATES][MOST_COORDINATES];
} Tile;

/* Solve a system of `size` unknowns with `columns` right-hand sides, with pivots; what was given is
 * overwritten. */
INLINE void eliminate(const int size, const int columns, Real matrix[][MOST_UNKNOWNS],
    Real right[][MOST_UNKNOWNS + 1])
{
    UNROLL for (int c = 0; c < size; c++) {
        /* the largest entry of the column comes up, lane by lane */
        UNROLL for (int r = c + 1; r < size; r++) {
            const Mask over = absolute(matrix[r][c]) > absolute(matrix[c][c]);
            UNROLL for (int j = c; j < size; j++) {
                const Real low = matrix[r][j], high = matrix[c][j];
                matrix[c][j] = chosen(over, low, high);
                matrix[r][j] = chosen(over, high, low);
            }
            UNROLL for (int j = 0; j < columns; j++) {
                const Real low = right[r][j], high = right[c][j];
                right[c][j] = chosen(over, low, high);
                right[r][j] = chosen(over, high, low);
            }
        }
        UNROLL for (int r = c + 1; r < size; r++) {
            const Real share = matrix[r][c] / matrix[c][c];
            UNROLL for (int j = c + 1; j < size; j++) matrix[r][j] -= share * matrix[c][j];
            UNROLL for (int j = 0; j < columns; j++) right[r][j] -= share * right[c][j];
        }
    }
    UNROLL for (int r = size - 1; r >= 0; r--)
        UNROLL for (int j = 0; j < columns; j++) {
            Real sum = right[r][j];
            UNROLL for (int i = r + 1; i < size; i++) sum -= matrix[r][i] * right[i][j];
            right[r][j] = sum / matrix[r][r];
        }
}

CLONES void eliminate_any(int size, int columns, Real matrix[][MOST_UNKNOWNS],
    Real right[][MOST_UNKNOWNS + 1])
{
    eliminate(size, columns, matrix, right);
}

/* The same, without a loop where the compiler knows the size. */
INLINE void solve(const int size, const int columns, Real matrix[][MOST_UNKNOWNS],
    Real right[][MOST_UNKNOWNS + 1])
{
    if (__builtin_constant_p(size))
        eliminate(size, columns, matrix, right);
    else
        eliminate_any(size, columns, matrix, right);
}

/* An array of shape (motor,); written for the motors whose block is regular. */
INLINE Real load(const Tile *t, const double *array)
{
    Real x;
    if (t->beside)
        memcpy(&x, array + t->motor[0], sizeof(Real));
    else
        for (int l = 0; l < LANES; l++) x[l] = array[t->motor[l]];
    return x;
}

INLINE void store(const Tile *t, double *array, Real x)
{
    for (int l = 0; l < t->lanes; l++)
        if (t->fine[l]) array[t->motor[l]] = x[l];
}

/* A matrix of every motor, beginning at entry `first` of a row of an array of shape (motor, width);
 * `apart` from row to row here. All of them are brought in before anything is computed: a vector
 * that was stored number by number can be loaded quickly only when these stores are over. */
INLINE void load_matrix(
    const Tile *t, const double *array, int64_t width, int64_t first, int rows, int columns,
    Real *to, int apart)
{
    for (int l = 0; l < LANES; l++) {
        const double *from = array + t->motor[l] * width + first;
        for (int i = 0; i < rows; i++)
            for (int j = 0; j < columns; j++) to[i * apart + j][l] = from[i * columns + j];
    }
}

INLINE void store_matrix(
    const Tile *t, double *array, int64_t width, int64_t first, int rows, int columns,
    const Real *from, int apart)
{
    for (int l = 0; l < t->lanes; l++) {
        if (!t->fine[l]) continue;
        double *to = array + t->motor[l] * width + first;
        for (int i = 0; i < rows; i++)
            for (int j = 0; j < columns; j++) to[i * columns + j] = from[i * apart + j][l];
    }
}

/* Bring samples and belief of the motors in, lane by lane. */
INLINE void gather(const Update *u, Tile *t, const int n)
{
    const int k = t->k, m = n + STATES, memories = (int)u->memories;
    const int64_t stride = u->signal_stride;
    t->fine = everywhere();
    int64_t column[LANES];
    /* whether one load brings what all lanes have of a motor, and of a sample */
    int beside = 1, even = 1;
    for (int l = 0; l < LANES; l++) {
        const int64_t motor = t->motor[l];
        column[l] = u->at[motor] - u->gone[motor] - 1;
        const int there = column[l] >= 0 && column[l] < u->columns - k;
        /* nothing is read that is not in memory, whatever is told of places */
        if (!there) column[l] = 0;
        if (!there || !u->hold_begun[motor] || u->at[motor] <= u->begin[motor]) t->fine[l] = 0;
        beside &= motor == t->motor[0] + l, even &= column[l] == column[0];
    }
    t->beside = beside, even &= beside;
    for (int l = 0; l < (even ? 1 : LANES); l++) {
        const double *first = u->data + t->motor[l] + column[l] * u->column_stride;
        for (int j = 0; j <= k; j++, first += u->column_stride)
            if (even) {
                memcpy(&t->interval[j], first + INTERVAL_S * stride, sizeof(Real));
                memcpy(&t->voltage[j], first + VOLTAGE_V * stride, sizeof(Real));
                memcpy(&t->measured[j], first + TORQUE_NM * stride, sizeof(Real));
                if (u->speed_measured)
                    memcpy(&t->speed[j], first + SPEED_RAD_S * stride, sizeof(Real));
            } else {
                t->interval[j][l] = first[INTERVAL_S * stride];
                t->voltage[j][l] = first[VOLTAGE_V * stride];
                t->measured[j][l] = first[TORQUE_NM * stride];
                t->speed[j][l] = first[SPEED_RAD_S * stride];
            }
    }
    if (!u->speed_measured) /* nothing is known of it, perhaps not even a number */
        for (int j = 0; j <= k; j++) t->speed[j] = all(0.0);
    t->box.torque_constant = load(t, u->torque_constant);
    for (int j = 0; j < u->known_terms; j++) t->box.constant[j] = load(t, u->known + j * u->motors);
    t->size = load(t, u->current_a), t->noise = load(t, u->noise), t->gain = load(t, u->gain);
    t->state = load(t, u->state), t->least_noise = load(t, u->least_noise);
    load_matrix(t, u->p, n, 0, 1, n, t->box.p, n);
    load_matrix(t, u->sensitivity, n, 0, 1, n, t->sensitivity, n);
    load_matrix(t, u->covariance, m * m, 0, m, m, (Real *)t->covariance, MOST_UNKNOWNS);
    load_matrix(t, u->score, memories * n, 0, memories, n, (Real *)t->scores, MOST_COORDINATES);
    for (int q = 0; q < memories; q++)
        load_matrix(t, u->information, memories * n * n, q * n * n, n, n, (Real *)t->tested[q],
            MOST_COORDINATES);
}

CLONES void gather_3(const Update *u, Tile *t) { gather(u, t, 3); }
CLONES void gather_any(const Update *u, Tile *t) { gather(u, t, t->n); }

/* Settle where every interval is linearised: block_step.py, _outset. */
CLONES void set_out(const Update *u, Tile *t)
{
    const Real reach = u->credible * t->size;
    for (int j = 0; j <= t->k; j++) {
        t->measured[j] = current_of_torque(t->measured[j], t->box.torque_constant);
        t->about[j] = j > 0 ? between(t->measured[j], -reach, reach) : t->state;
        t->near[j] = everywhere();
        if (j > 0) t->fine &= t->interval[j] > 0.0;
    }
    t->error[0] = all(0.0);
}

/* Settle in how many steps an interval is gone through: flow.py, flow. */
INLINE void count_steps(const Update *u, Tile *t, const Terms of)
{
    Real stiffness = all(0.0);
    t->steps = all(1.0), t->most = 1;
    if (holds_current(of)) return;
    for (int j = 0; j < t->k; j++) {
        t->here[j] = rate_of(&t->box, of, &t->about[j], t->voltage[j + 1], t->speed[j]);
        const Real stiff = absolute(t->here[j].by_state[CURRENT][CURRENT]) * t->interval[j + 1];
        t->fine &= stiff < INFINITY;
        stiffness = larger(stiffness, stiff);
    }
    t->fine &= stiffness <= u->most_steps * u->largest_step;
    for (int l = 0; l < LANES; l++)
        if (t->fine[l] && stiffness[l] > u->largest_step) {
            t->steps[l] = ceil(stiffness[l] / u->largest_step);
            t->most = t->steps[l] > t->most ? (int)t->steps[l] : t->most;
        }
}

/* The trajectory with its derivatives, and the normal equations: trajectory.py, linearise, follow;
 * block_step.py, _from. */
INLINE void follow(const Update *u, Tile *t, const Terms of)
{
    const int k = t->k, n = of.coordinates, m = n + STATES;
    const Real outlier = (u->outlier * t->noise) * (u->outlier * t->noise);
    Real largest = all(0.0), x = t->state, by_start = all(1.0), by_coordinate[MOST_COORDINATES];
    Real squares = all(0.0), used = all(0.0);
    Real info[MOST_UNKNOWNS][MOST_UNKNOWNS], right[MOST_UNKNOWNS],
        twice[MOST_UNKNOWNS][MOST_UNKNOWNS];
    Mask fine = t->fine;
    const int is_held = holds_current(of);
    for (int j = 0; j <= k; j++) largest = larger(largest, absolute(t->measured[j]));
    const Real limit = u->far_away * (largest + 1e-9);
    UNROLL for (int i = 0; i < n; i++) by_coordinate[i] = all(0.0);
    UNROLL for (int i = 0; i < m; i++) {
        right[i] = all(0.0);
        UNROLL for (int j = i; j < m; j++) {
            info[i][j] = all(0.0);
            twice[i][j] = i == j ? t->covariance[i][j] : t->covariance[i][j] + t->covariance[j][i];
        }
    }
    for (int j = 0; j < k; j++) { /* a loop of its own: intervals overlap in the processor */
        const Interval over = {t->voltage[j + 1], t->speed[j], t->speed[j + 1], t->interval[j + 1]};
        if (is_held)
            t->to[j] = held_current_motion(&t->box, of, t->about[j], &over);
        else if (t->most == 1)
            t->to[j] = runge_kutta_step(&t->box, of, &t->about[j], &t->here[j], &over);
        else
            t->to[j] = in_steps(&t->box, of, &t->about[j], &over, t->steps, t->most, 0);
    }
    for (int j = 0; j < k; j++) {
        const Linear to = t->to[j];
        const Real about = t->about[j], end = to.value[CURRENT];
        fine &= absolute(end) <= limit;
        const Real decay = between(to.by_state[CURRENT][CURRENT], all(-1.0), all(1.0)),
            gain = chosen(t->near[j], t->gain, all(0.0));
        const Real factor = decay * (1.0 - gain);
        t->factor[j] = factor;
        t->path[j + 1] = x = factor * x + (end - decay * about + decay * gain * t->measured[j]);
        by_start = factor * by_start;
        Real row[MOST_UNKNOWNS], variance = all(0.0);
        row[CURRENT] = by_start * t->size;
        UNROLL for (int i = 0; i < n; i++) {
            by_coordinate[i] = factor * by_coordinate[i] + to.by_coordinate[CURRENT][i];
            row[i + STATES] = by_coordinate[i] * t->box.p[i];
        }
        UNROLL for (int i = 0; i < m; i++)
            UNROLL for (int h = i; h < m; h++) variance += twice[i][h] * (row[i] * row[h]);
        const Real error = t->measured[j + 1] - x, spread = 1.0 + larger(variance, all(0.0)),
            square = error * error;
        const Mask kept = square <= outlier * spread;
        t->error[j + 1] = error, t->kept[j + 1] = kept;
        squares += chosen(kept, square / spread, all(0.0));
        used += chosen(kept, all(1.0), all(0.0));
        UNROLL for (int i = 0; i < m; i++) {
            const Real counts = chosen(kept, row[i], all(0.0));
            right[i] += counts * error;
            UNROLL for (int h = i; h < m; h++) info[i][h] += counts * row[h];
        }
    }
    t->fine = fine, t->end = x, t->by_start = by_start, t->squares = squares, t->used = used;
    for (int i = 0; i < n; i++) t->by_coordinate[i] = by_coordinate[i];
    for (int i = 0; i < m; i++) {
        t->right[i] = right[i];
        for (int j = i; j < m; j++) t->info[i][j] = t->info[j][i] = info[i][j];
    }
}

INLINE void follow_of(const Update *u, Tile *t, const Terms of)
{
    count_steps(u, t, of), follow(u, t, of);
}

/* One for every number of coordinates, so that all that is known of a sample stays in registers;
 * and one each for the physics that nearly every motor has, whose terms the compiler then knows.
 * The numbers are the same. */
#define FOLLOW(N) \
    CLONES void follow_##N(const Update *u, Tile *t) \
    { \
        follow_of(u, t, (Terms){N, (int)u->known_terms, (int)u->speed_measured, u->codes}); \
    }
FOLLOW(1) FOLLOW(2) FOLLOW(3) FOLLOW(4) FOLLOW(5)

static const int64_t USUAL[] = {RESISTANCE, HYSTERESIS, BACK_EMF_CONSTANT};

CLONES void follow_usual(const Update *u, Tile *t) { follow_of(u, t, (Terms){3, 1, 0, USUAL}); }
CLONES void follow_usual_with_speed(const Update *u, Tile *t)
{
    follow_of(u, t, (Terms){3, 1, 1, USUAL});
}

static void follow_any(const Update *u, Tile *t)
{
    if (t->n == 3 && u->known_terms == 1 && memcmp(u->codes, USUAL, sizeof(USUAL)) == 0) {
        if (u->speed_measured)
            follow_usual_with_speed(u, t);
        else
            follow_usual(u, t);
        return;
    }
    switch (t->n) {
    case 1: follow_1(u, t); break;
    case 2: follow_2(u, t); break;
    case 3: follow_3(u, t); break;
    case 4: follow_4(u, t); break;
    default: follow_5(u, t);
    }
}

/* Rule out those of some lanes whose state was kicked: trajectory.py, find_kicks. */
CLONES void look_for_kicks(const Update *u, Tile *t, const Mask *asked)
{
    const int k = t->k;
    const Real limit = u->kick * t->noise, end = all(INFINITY);
    Real change[MOST_SAMPLES], jump[MOST_SAMPLES];
    Mask kicked = ~everywhere(), large = kicked;
    for (int j = 0; j < k; j++) {
        jump[j] = t->error[j + 1] - t->factor[j] * t->error[j];
        change[j] = absolute(jump[j]);
        large |= change[j] > limit;
    }
    for (int j = 0; j < k; j++) {
        const Real earlier = j > 1 ? change[j - 2] : all(0.0),
            before = j > 0 ? change[j - 1] : all(0.0);
        const Real after = j + 1 < k ? change[j + 1] : end, last = j > 0 ? jump[j - 1] : all(0.0);
        const Real both = absolute(jump[j] + t->factor[j] * last);
        kicked |= (change[j] > limit) & (before < 0.5 * change[j]) & (after < 0.5 * change[j]);
        kicked |= (both > limit) & (earlier < 0.25 * both) & (after < 0.25 * both) & (before > 0.0);
    }
    t->fine &= ~(*asked & large & kicked);
}

/* A current that has not moved by more than the step of its readings teaches nothing:
 * block_updater.py, update. */
CLONES void silence(const Update *u, Tile *t)
{
    Real low = t->measured[0], high = low;
    if (!anywhere(t->least_noise > 0.0)) return;
    for (int j = 1; j <= t->k; j++)
        low = smaller(low, t->measured[j]), high = larger(high, t->measured[j]);
    const Mask still = (t->least_noise > 0.0) & (high - low <= u->still * t->least_noise);
    for (int i = 0; i <= t->n; i++) {
        t->right[i] = chosen(still, all(0.0), t->right[i]);
        for (int j = 0; j <= t->n; j++) t->info[i][j] = chosen(still, all(0.0), t->info[i][j]);
    }
}

/* Predict the block, and tell its good samples from the others: block_step.py, predict. */
CLONES void predict(const Update *u, Tile *t)
{
    Mask outliers = ~everywhere();
    set_out(u, t);
    follow_any(u, t);
    for (int j = 1; j <= t->k; j++) outliers |= ~t->kept[j];
    outliers &= t->fine;
    if (!anywhere(outliers)) return;
    /* whoever has no outlier is asked nothing, as it would be alone */
    look_for_kicks(u, t, &outliers);
    for (int j = 1; j <= t->k; j++) t->near[j] = t->kept[j];
    follow_any(u, t);
    for (int j = 1; j <= t->k; j++) /* the motor never stood where an outlier says */
        t->about[j] = chosen(t->kept[j], t->about[j], t->path[j]);
    follow_any(u, t);
}

/* Have the coordinates always been others? block_step.py, surprise; change_test.py,
 * ChangeTest.take. */
INLINE void examine(const Update *u, Tile *t, const int n)
{
    const int m = n + STATES, memories = (int)u->memories;
    const Real unit = 1.0 / (t->noise * t->noise);
    Real matrix[MOST_UNKNOWNS][MOST_UNKNOWNS], reached[MOST_UNKNOWNS][MOST_UNKNOWNS + 1];
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < m; j++) {
            Real sum = all(i == j ? 1.0 : 0.0);
            for (int h = 0; h < m; h++) sum += t->info[i][h] * t->covariance[h][j];
            matrix[i][j] = sum;
            reached[i][j] = t->info[i][j];
        }
        reached[i][m] = t->right[i];
    }
    solve(m, m + 1, matrix, reached);
    for (int i = 0; i < m; i++) t->fine &= reached[i][i] >= 0.0;
    for (int q = 0; q < memories; q++) {
        Real trace = all(0.0), statistic = all(0.0), solution[MOST_UNKNOWNS][MOST_UNKNOWNS + 1];
        for (int i = 0; i < n; i++) {
            const Real share = t->sensitivity[i],
                turned = share * reached[CURRENT][CURRENT] + reached[i + STATES][CURRENT];
            const Real score = (share * reached[CURRENT][m] + reached[i + STATES][m]) * unit;
            t->scores[q][i] = u->keep[q] * t->scores[q][i] + score;
            for (int j = 0; j < n; j++) {
                const Real own = share * reached[CURRENT][j + STATES] +
                    reached[i + STATES][j + STATES];
                const Real told = turned * t->sensitivity[j] + own;
                matrix[i][j] = t->tested[q][i][j] = u->keep[q] * u->keep[q] * t->tested[q][i][j] +
                    told * unit;
            }
            solution[i][0] = t->scores[q][i];
            trace += t->tested[q][i][i];
        }
        for (int i = 0; i < n; i++) matrix[i][i] += 1e-6 * trace / (double)n + 1e-300;
        solve(n, 1, matrix, solution);
        for (int i = 0; i < n; i++) statistic += t->scores[q][i] * solution[i][0];
        t->fine &= statistic <= u->threshold;
    }
    const Real samples = all((double)t->k), missing = (samples - t->used) / samples;
    const Real left_out = u->left_out_memory * load(t, u->left_out) + missing;
    t->fine &= (t->used >= 0.5 * samples) & (left_out <= u->left_out_limit);
}

/* Whether a hold has lasted for long enough, measured by the slowest decay of the block:
 * constant_voltage.py, take.
 *
 * What is left over an interval lies between bounds without logarithms, which decide nearly
 * always: (1 - f) 2 / (1 + f) <= -log f <= (1 - f^2) / (2 f) for what every interval leaves,
 * 0 < f <= 1; others are not decided.
 */
INLINE Mask has_settled(const Update *u, const Tile *t, const Mask asked, const Real held)
{
    Real most = t->factor[0], longest = t->interval[1], shortest = longest;
    Mask known = most > 0.0;
    if (!anywhere(asked)) return asked;
    for (int j = 1; j < t->k; j++) {
        known &= t->factor[j] > 0.0;
        most = larger(most, t->factor[j]);
        longest = larger(longest, t->interval[j + 1]),
            shortest = smaller(shortest, t->interval[j + 1]);
    }
    const Real least_rate = 2.0 * (1.0 - most) / ((1.0 + most) * longest);
    const Real most_rate = (1.0 - most) * (1.0 + most) / (2.0 * most * shortest);
    Mask settled = asked & known & (held * least_rate > u->hold_settled * (1.0 + ROUNDING));
    const Mask open = asked & ~settled &
        ~(known & (held * most_rate < u->hold_settled * (1.0 - ROUNDING)));
    for (int l = 0; l < t->lanes; l++) {
        if (!open[l]) continue;
        double rate = INFINITY;
        /* what is not a number stays, and nothing settles */
        for (int j = 0; j < t->k && rate == rate; j++) {
            const double decays = -log(t->factor[j][l]) / t->interval[j + 1][l];
            rate = decays >= rate ? rate : decays;
        }
        settled[l] = held[l] * rate > u->hold_settled ? -1 : 0;
    }
    return settled;
}

/* Settle what follows from a motor's block: estimator.py, _reckon; what rarely follows is left to
 * Python and told of. */
static uint8_t reckon(const Update *u, int64_t motor)
{
    const int walking = u->walk_rate[motor] != 0.0;
    const int64_t at = u->at[motor] += u->samples, update = at + u->samples;
    int64_t fit = INT64_MAX;
    if (!walking && u->next_fit[motor] <= u->replay_capacity) {
        fit = u->begin[motor] + u->next_fit[motor];
        fit = fit > at ? fit : at + 1;
    }
    u->due[motor] = fit < update ? fit : update;
    u->plain[motor] = fit > update;
    uint8_t told = LEARNT;
    if (u->hold_settled_now[motor] && u->hold_held_s[motor] > u->long_hold_s) told |= LONG_HOLD;
    if (at - u->anchored[motor] >= u->replay_capacity / (walking ? 2 : 1)) told |= ANCHOR_DUE;
    return told;
}

/* Learn, and write down what is believed then: block_step.py, learn; block_updater.py,
 * _follow_noise; constant_voltage.py, take. */
INLINE void conclude(const Update *u, Tile *t, const int n, uint8_t *told)
{
    const int k = t->k, m = n + STATES, memories = (int)u->memories;
    const Real noise = t->noise, unit = 1.0 / (noise * noise), *before = t->box.p;
    Real matrix[MOST_UNKNOWNS][MOST_UNKNOWNS], posterior[MOST_UNKNOWNS][MOST_UNKNOWNS + 1];
    Real step[MOST_UNKNOWNS], moved[MOST_UNKNOWNS][MOST_UNKNOWNS];
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) {
            Real sum = all(i == j ? 1.0 : 0.0);
            for (int h = 0; h < m; h++) sum += t->covariance[i][h] * t->info[h][j];
            matrix[i][j] = sum;
            posterior[i][j] = t->covariance[i][j];
        }
    solve(m, m, matrix, posterior);
    for (int i = 0; i < m; i++)
        for (int j = 0; j < i; j++)
            posterior[i][j] = posterior[j][i] = 0.5 * (posterior[i][j] + posterior[j][i]);
    for (int i = 0; i < m; i++) {
        step[i] = all(0.0);
        for (int j = 0; j < m; j++) step[i] += posterior[i][j] * t->right[j];
        if (i >= STATES) step[i] = between(step[i], all(-0.5), all(1.0));
    }
    for (int i = 0; i < m; i++) { /* normal_equations.py, is_sound */
        t->fine &= posterior[i][i] > 0.0;
        for (int j = 0; j < i; j++) {
            const Real most = posterior[i][i] * posterior[j][j] * (1.0 + u->correlation_slack);
            t->fine &= posterior[i][j] * posterior[i][j] <= most;
        }
    }

    Real p[MOST_COORDINATES], ratio[MOST_UNKNOWNS], transfer[MOST_UNKNOWNS];
    const Real first = before[0] * (1.0 + step[STATES]),
        leading = between(1.0 / first, all(u->lower[0]), all(u->upper[0]));
    p[0] = 1.0 / leading;
    for (int i = 1; i < n; i++)
        p[i] = between(before[i] * (1.0 + step[i + STATES]) / first, all(u->lower[i]),
            all(u->upper[i])) / leading;
    ratio[CURRENT] = all(1.0);
    transfer[CURRENT] = t->by_start;
    for (int i = 0; i < n; i++) {
        ratio[i + STATES] = before[i] / p[i];
        transfer[i + STATES] = t->by_coordinate[i] * before[i] / t->size;
    }
    Real shift = all(0.0), passed = all(0.0);
    for (int j = 1; j <= k; j++) passed += t->interval[j];
    for (int i = 0; i < m; i++) shift += transfer[i] * step[i];
    const Real state = t->end + shift * t->size, walk = load(t, u->walk_rate);
    for (int i = 0; i < m; i++) { /* the first row and column turn, the others stay */
        Real sum = all(0.0);
        for (int h = 0; h < m; h++) sum += transfer[h] * posterior[h][i];
        moved[CURRENT][i] = sum;
    }
    Real corner = all(0.0), whole = state;
    for (int h = 0; h < m; h++) corner += moved[CURRENT][h] * transfer[h];
    moved[CURRENT][CURRENT] = corner;
    for (int i = STATES; i < m; i++) {
        for (int j = 0; j < m; j++)
            moved[i][j] = j == CURRENT ? moved[CURRENT][i] : posterior[i][j];
        moved[i][i] += u->heats[i - STATES] * (walk * walk * passed * unit);
    }
    for (int i = 0; i < m; i++)
        for (int j = 0; j < m; j++) {
            moved[i][j] *= ratio[i] * ratio[j];
            whole += moved[i][j];
        }
    for (int i = 0; i < n; i++) whole += p[i];
    t->fine &= absolute(whole) < INFINITY;

    Real count, low = t->voltage[1], high = low;
    for (int l = 0; l < LANES; l++) {
        const int64_t grown = u->noise_count[t->motor[l]] + k;
        count[l] = (double)(grown < u->noise_memory ? grown : u->noise_memory);
    }
    const Real power = noise * noise + (double)k / count * (t->squares / t->used - noise * noise);
    const Real followed = larger(larger(square_root(power), u->noise_floor * t->size),
        t->least_noise);
    t->fine &= followed < INFINITY;
    for (int j = 2; j <= k; j++)
        low = smaller(low, t->voltage[j]), high = larger(high, t->voltage[j]);
    const Real level = load(t, u->hold_level);
    const Real largest = larger(load(t, u->hold_largest), larger(-low, high));
    Mask same = larger(high - level, level - low) <= u->hold_tolerance * largest;
    if (u->speed_measured) { /* then a load excites too */
        Real slow = t->speed[1], fast = slow;
        for (int j = 2; j <= k; j++)
            slow = smaller(slow, t->speed[j]), fast = larger(fast, t->speed[j]);
        same &= fast - slow <= u->hold_tolerance * larger(-slow, fast);
    }
    const Real held = chosen(same, load(t, u->hold_held_s) + passed, all(0.0));
    const Mask settled = same & has_settled(u, t, same & t->fine, held);

    Real reached[MOST_COORDINATES];
    for (int i = 0; i < n; i++)
        reached[i] = (t->by_coordinate[i] * before[i] +
            t->by_start * (t->sensitivity[i] * t->size)) / t->size;
    store(t, u->state, state);
    store(t, u->noise, followed);
    store_matrix(t, u->p, n, 0, 1, n, p, n);
    store_matrix(t, u->sensitivity, n, 0, 1, n, reached, n);
    store_matrix(t, u->covariance, m * m, 0, m, m, (Real *)moved, MOST_UNKNOWNS);
    store_matrix(t, u->score, memories * n, 0, memories, n, (Real *)t->scores, MOST_COORDINATES);
    for (int q = 0; q < memories; q++)
        store_matrix(t, u->information, memories * n * n, q * n * n, n, n, (Real *)t->tested[q],
            MOST_COORDINATES);
    store(t, u->left_out,
        u->left_out_memory * load(t, u->left_out) + ((double)k - t->used) / (double)k);
    store(t, u->suspicion, all(0.0));
    store(t, u->hold_level, chosen(same, level, t->voltage[k]));
    store(t, u->hold_largest, largest);
    store(t, u->hold_held_s, held);
    for (int l = 0; l < t->lanes; l++) {
        const int64_t motor = t->motor[l];
        told[l] = 0;
        if (!t->fine[l]) continue;
        u->since[motor] = 0;
        u->outliers[motor] += k - (int64_t)t->used[l];
        u->noise_count[motor] = (int64_t)count[l];
        if (settled[l] && !u->hold_settled_now[motor]) /* from here on only what heats may move */
            for (int i = 0; i < n; i++) {
                u->hold_p[motor * n + i] = p[i][l];
                for (int j = 0; j < n; j++)
                    u->hold_covariance[(motor * n + i) * n + j] = moved[i + STATES][j + STATES][l] *
                        followed[l] * followed[l];
            }
        u->hold_settled_now[motor] = settled[l] != 0;
        told[l] = reckon(u, motor);
    }
}

/* A variant for three coordinates, which most motors have: the compiler unrolls their small
 * matrices. */
CLONES void finish_3(const Update *u, Tile *t, uint8_t *told)
{
    examine(u, t, 3), conclude(u, t, 3, told);
}
CLONES void finish_any(const Update *u, Tile *t, uint8_t *told)
{
    examine(u, t, t->n), conclude(u, t, t->n, told);
}

/* Size of Update, by which Python tells that it speaks of the same. */
int64_t update_size(void) { return (int64_t)sizeof(Update); }

/* Learn the next blocks of `count` motors, given by their places; tell of each what became of
 * it. */
void learn_blocks(const Update *u, const int64_t *motors, int64_t count, uint8_t *told)
{
    Tile t;
    for (int64_t begin = 0; begin < count; begin += LANES) {
        t.n = (int)u->coordinates, t.k = (int)u->samples;
        t.lanes = (int)(count - begin < LANES ? count - begin : LANES);
        for (int l = 0; l < LANES; l++) t.motor[l] = motors[begin + (l < t.lanes ? l : 0)];
        if (t.n == 3)
            gather_3(u, &t);
        else
            gather_any(u, &t);
        predict(u, &t);
        silence(u, &t);
        if (t.n == 3)
            finish_3(u, &t, told + begin);
        else
            finish_any(u, &t, told + begin);
    }
}

/* A turn: learn the next block of every motor that is due for one, where these are no more than
 * `most`. Tell how many they are, and in `wait` in how many samples somebody is due again; 0 where
 * there is more to do than was done here. */
int64_t learn_due(
    const Update *u, int64_t most, int64_t *motors, uint8_t *told, uint8_t *changed, int64_t *wait)
{
    int64_t count = 0, next = INT64_MAX;
    int more = 0;
    for (int64_t motor = 0; motor < u->motors; motor++) {
        changed[motor] = 0;
        if (u->gone[motor] + u->end[motor] < u->due[motor]) continue;
        if (!u->plain[motor])
            more = 1;
        else if (count++ < most)
            motors[count - 1] = motor;
    }
    *wait = 0;
    if (count > most) return count;
    learn_blocks(u, motors, count, told);
    for (int64_t i = 0; i < count; i++) {
        changed[motors[i]] = told[i] > 0;
        more |= told[i] != LEARNT;
    }
    if (more) return count;
    for (int64_t motor = 0; motor < u->motors; motor++) {
        const int64_t left = u->due[motor] - u->gone[motor] - u->end[motor];
        if (left <= 0 && !u->plain[motor]) return count; /* what it has learnt makes a fit due */
        next = left < next ? left : next;
    }
    *wait = next > 1 ? next : 1;
    return count;
}

/* By which Python tells that this was built of the forms that it has itself. */
int64_t forms_fingerprint(void) { return FORMS_FINGERPRINT; }

/* A term for a coefficient of one, and its derivative by the current, of one motor. Returns whether
 * there is such. */
int64_t term_values(
    int64_t code, int64_t speed_measured, double current, double speed, double torque_constant,
    double voltage, double *values)
{
    const Term found = term(code, (int)speed_measured, all(current), all(speed),
        all(torque_constant), all(voltage));
    values[0] = found.value[0];
    values[1] = found.slope[CURRENT][0];
    return term_known(code);
}
