/* When a parameter counts as known: estimate.py, VerdictSettings. */
#ifndef VERDICT_RULES_H
#define VERDICT_RULES_H
#include <stdint.h>

#define MOST_JUDGED 12

/* In the order of estimate.py. */
enum { IDENTIFIED, CONVERGING, UNEXCITED, FROZEN, IMPLAUSIBLE, MISFIT, NEGLIGIBLE };

/* verdict_rules.py holds the same list. */
typedef struct {
    double lower[MOST_JUDGED], upper[MOST_JUDGED];
    double identified_relative_std, excited_relative_std, bound_tolerance, negligible_share;
} VerdictRules;

/* Judge parameter i; `most` is the share of the voltage that it takes at most. */
static inline uint8_t verdict(const VerdictRules *r, int i, double value, double std, double most)
{
    const int is_inside = !(value <= r->lower[i] * (1.0 + r->bound_tolerance)
                            || value >= r->upper[i] * (1.0 - r->bound_tolerance));
    const int is_excited = std <= r->excited_relative_std * value;
    if (is_inside && is_excited && std <= r->identified_relative_std * value) return IDENTIFIED;
    if (most < r->negligible_share) return NEGLIGIBLE;
    if (!is_inside) return IMPLAUSIBLE;
    return is_excited ? CONVERGING : UNEXCITED;
}
#endif
