/* Covariance and verdicts of one motor as far as the test of its fit lets its estimate be believed.
 *
 * The same as estimate_limit.py; to the last bit.
 */
#include <math.h>
#include <stdint.h>

#include "verdict_rules.h"

/* What a test has left, by parameter, and the estimate; `factors`, `spread` and `covariance` are
 * square, row by row. widened_estimate.py holds the same list. */
typedef struct {
    int64_t parameters;
    VerdictRules rules;
    double factors[MOST_JUDGED * MOST_JUDGED], spread[MOST_JUDGED * MOST_JUDGED];
    double factor[MOST_JUDGED], furthest[MOST_JUDGED];
    /* `share` and `reach` are those of regular_estimate.c */
    double value[MOST_JUDGED], share[MOST_JUDGED], reach[MOST_JUDGED];
    double covariance[MOST_JUDGED * MOST_JUDGED];
    uint8_t verdicts[MOST_JUDGED];
} Widening;

/* Size of Widening, by which Python tells that it speaks of the same. */
int64_t widening_size(void) { return (int64_t)sizeof(Widening); }

/* Judge the values by their covariance. */
void judge_widened(Widening *w)
{
    const int n = (int)w->parameters;
    for (int i = 0; i < n; i++) {
        const double variance = w->covariance[i * n + i];
        const double std = variance >= 0.0 ? sqrt(variance) : NAN;
        const double most =
            w->share[i] > 0.0
                ? w->furthest[i] * w->value[i] * w->share[i] + w->reach[i] * w->factor[i]
                : INFINITY;
        w->verdicts[i] = verdict(&w->rules, i, w->value[i], std, most);
    }
}

/* Widen the covariance, and judge the values by it. */
void widen_estimate(Widening *w)
{
    const int n = (int)w->parameters;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            w->covariance[i * n + j] = w->covariance[i * n + j] * w->factors[i * n + j]
                                       + w->spread[i * n + j] * (w->value[i] * w->value[j]);
    judge_widened(w);
}
