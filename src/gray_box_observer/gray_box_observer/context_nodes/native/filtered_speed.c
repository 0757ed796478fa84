/* Filters of the speed that nobody measures, of many motors: context_nodes/rotor/speed_filter.py
 * for compiled code. */
#include <math.h>
#include <stdint.h>

#include "context_nodes/native/free_motion.h"

enum { LOADED = STATES, FILTER_STATES };
#define FAR_CURRENT 1e3 /* in A, beyond a hundred times what flows */
#define FAR 100.0

typedef struct {
    double coarseness, slip, furthest, memory, largest_step;
    int64_t most_steps;
} FilterSettings;

/* What is known of a motor: its noise in A, and its no-load speed at the largest voltage. */
typedef struct {
    double torque_constant, noise, no_load_speed, time;
} FilteredMotor;

typedef struct {
    double length, voltage, reading;
} FilteredSample;

typedef struct {
    double state[FILTER_STATES], covariance[FILTER_STATES][FILTER_STATES], likelihood, share;
} Filter;

/* What the filters of a motor agree on; NaN where they cannot follow it. */
typedef struct {
    double speed, variance;
} Agreed;

int64_t filtered_speed_settings_size(void) { return sizeof(FilterSettings); }
int64_t filtered_speed_size(void) { return sizeof(Filter) / sizeof(double); }
int64_t filtered_speed_ladder_size(void) { return sizeof(Ladder) / sizeof(double) + 1; }

/* How much every filter counts, by its log-likelihood. */
static void weigh(int64_t filters, Filter *filter)
{
    double most = filter[0].likelihood, sum = 0.0;
    for (int64_t f = 1; f < filters; f++) most = larger(most, filter[f].likelihood);
    for (int64_t f = 0; f < filters; f++) sum += filter[f].share = exp(filter[f].likelihood - most);
    for (int64_t f = 0; f < filters; f++) filter[f].share /= sum;
}

/* How the states of a filter answer those at the start of a sample. */
typedef struct {
    double mean[FILTER_STATES], end[FILTER_STATES], motion[FILTER_STATES][FILTER_STATES];
} Way;

/* Move one filter along the way of all. */
static void predict(const Way *way, Filter *filter)
{
    double apart[FILTER_STATES], half[FILTER_STATES][FILTER_STATES];
    for (int s = 0; s < FILTER_STATES; s++) apart[s] = filter->state[s] - way->mean[s];
    for (int s = 0; s < FILTER_STATES; s++) {
        filter->state[s] = way->end[s];
        for (int r = 0; r < FILTER_STATES; r++) filter->state[s] += way->motion[s][r] * apart[r];
        for (int r = 0; r < FILTER_STATES; r++) {
            half[s][r] = 0.0;
            for (int k = 0; k < FILTER_STATES; k++)
                half[s][r] += way->motion[s][k] * filter->covariance[k][r];
        }
    }
    for (int s = 0; s < FILTER_STATES; s++)
        for (int r = 0; r < FILTER_STATES; r++) {
            double sum = 0.0;
            for (int k = 0; k < FILTER_STATES; k++) sum += half[s][k] * way->motion[r][k];
            filter->covariance[s][r] = sum;
        }
}

/* Correct one filter by the measured current. */
static void correct(const FilterSettings *set, double noise, double reading, Filter *filter)
{
    const double variance = filter->covariance[CURRENT][CURRENT] + noise * noise;
    const double largest = set->furthest * sqrt(variance);
    double innovation = reading - filter->state[CURRENT];
    innovation = smaller(larger(innovation, -largest), largest);
    filter->likelihood *= set->memory;
    filter->likelihood -= 0.5 * (log(variance) + innovation * innovation / variance);
    double gain[FILTER_STATES], row[FILTER_STATES];
    for (int s = 0; s < FILTER_STATES; s++) {
        gain[s] = filter->covariance[s][CURRENT] / variance;
        row[s] = filter->covariance[CURRENT][s];
    }
    for (int s = 0; s < FILTER_STATES; s++) {
        filter->state[s] += gain[s] * innovation;
        for (int r = 0; r < FILTER_STATES; r++) filter->covariance[s][r] -= gain[s] * row[r];
    }
}

/* One sample of the filters of one motor: predict about their common mean, correct, agree. Where
 * the mean cannot be followed nothing has changed. */
static Agreed filtered(const double *p, const FilteredMotor *motor, const FilterSettings *set,
                       const double *walks, int64_t filters, const FilteredSample *sample,
                       Ladder *ladder, Filter *filter)
{
    Way way = {{0}, {0}, {{0}}};
    double loaded[COORDINATES];
    weigh(filters, filter);
    for (int64_t f = 0; f < filters; f++)
        for (int s = 0; s < FILTER_STATES; s++)
            way.mean[s] += filter[f].share * filter[f].state[s];
    for (int j = 0; j < COORDINATES; j++) loaded[j] = p[j];
    loaded[LOAD_TORQUE] = way.mean[LOADED];
    const double most[STATES] = {
        FAR * (absolute(way.mean[CURRENT]) + motor->noise) + FAR_CURRENT,
        FAR * motor->no_load_speed + absolute(way.mean[SPEED])};
    const int is_ready = ladder_of(loaded, motor->torque_constant, most, way.mean, sample->voltage,
                                   sample->length, set->largest_step, ladder);
    const Stepping by = {set->largest_step, set->most_steps, is_ready ? ladder : NULL};
    int64_t taken = 0;
    const Linear moved = moved_on(loaded, motor->torque_constant, way.mean, sample->voltage,
                                  sample->length, &by, 0, &taken);
    for (int s = 0; s < STATES; s++) {
        if (!(absolute(moved.value[s]) <= most[s])) return (Agreed){NAN, NAN};
        way.end[s] = moved.value[s];
        for (int r = 0; r < STATES; r++) way.motion[s][r] = moved.by_state[s][r];
        way.motion[s][LOADED] = moved.by_coordinate[s][LOAD_TORQUE];
    }
    way.end[LOADED] = way.mean[LOADED];
    way.motion[LOADED][LOADED] = 1.0;
    const double share = sample->length / motor->time;
    const double current_noise = set->coarseness * motor->noise;
    const double slip = set->slip * motor->no_load_speed;
    const double stall = motor->no_load_speed / motor->time;
    for (int64_t f = 0; f < filters; f++) {
        predict(&way, filter + f);
        filter[f].covariance[CURRENT][CURRENT] += current_noise * current_noise;
        filter[f].covariance[SPEED][SPEED] += share * slip * slip;
        filter[f].covariance[LOADED][LOADED] += share * walks[f] * stall * stall;
        correct(set, motor->noise, sample->reading, filter + f);
    }
    weigh(filters, filter);
    Agreed agreed = {0.0, 0.0};
    for (int64_t f = 0; f < filters; f++) agreed.speed += filter[f].share * filter[f].state[SPEED];
    for (int64_t f = 0; f < filters; f++) {
        const double off = filter[f].state[SPEED] - agreed.speed;
        agreed.variance += filter[f].share * (filter[f].covariance[SPEED][SPEED] + off * off);
    }
    return agreed;
}

/* One sample of each of `count` motors, whose places are `motor`. `p` is [][COORDINATES], `ladders`
 * [][filtered_speed_ladder_size()] with zeros where a motor's `p` is new, `filter` [][filters], all
 * else [] by place. */
void filtered_speed_steps(int64_t count, const int64_t *motor, const FilterSettings *set,
                        const double *walks, int64_t filters, const double *p,
                        const FilteredMotor *known, double *ladders, const FilteredSample *sample,
                        Filter *filter, Agreed *agreed)
{
    const int64_t ladder_size = filtered_speed_ladder_size();
    for (int64_t k = 0; k < count; k++) {
        const int64_t m = motor[k];
        Ladder *ladder = (Ladder *)(ladders + m * ladder_size);
        agreed[m] = filtered(p + m * COORDINATES, known + m, set, walks, filters, sample + m,
                             ladder, filter + m * filters);
    }
}
