/* Values, covariance and verdicts of motors none of whose parameters is known vaguely.
 *
 * The same as estimator.py, estimate, with flow.py, parameter_covariance, and estimate.py,
 * VerdictSettings; to the last bit. Where something is known vaguely the spread of its logarithm is
 * not that of its value, which numpy then works out.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#include "verdict_rules.h"

#define MOST_PARAMETERS 5
/* of a factor's square; well above LEAST_EIGENVALUE of normal_equations.py */
#define SURELY_DEFINITE 1e-8

/* What is believed, and when a parameter counts as known; regular_estimate.py holds the same
 * list. */
typedef struct {
    int64_t parameters;
    VerdictRules rules;
    double log_normal;
    /* of motors by coordinate; by state and coordinates, squared; by nothing */
    const double *p, *covariance, *noise;
    /* of motors by parameter: of the voltage, a unit's and what may come on top; or NULL */
    const double *share, *reach;
} Believed;

/* Whether a covariance of positive variances is positive definite by more than rounding:
 * normal_equations.py, definite. It is by Cholesky factors of the correlations, the smallest of
 * whose squares is no less than the least eigenvalue. */
static int definite(int n, const double *covariance)
{
    double factor[MOST_PARAMETERS][MOST_PARAMETERS];
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double left =
                covariance[i * n + j] / sqrt(covariance[i * n + i] * covariance[j * n + j]);
            for (int h = 0; h < j; h++) left -= factor[i][h] * factor[j][h];
            if (i == j && !(left > SURELY_DEFINITE)) return 0;
            factor[i][j] = i == j ? sqrt(left) : left / factor[j][j];
        }
    return 1;
}

/* Size of Believed, by which Python tells that it speaks of the same. */
int64_t believed_size(void) { return (int64_t)sizeof(Believed); }

/* Tell of `count` motors, given by their places, or of the first so many. Return whether all of
 * them are regular; else what is written means nothing. */
int64_t tell_estimates(
    const Believed *b, const int64_t *motors, int64_t count, double *values, double *covariances,
    uint8_t *verdicts)
{
    const int n = (int)b->parameters, m = n + 1;
    for (int64_t k = 0; k < count; k++) {
        const int64_t motor = motors ? motors[k] : k;
        const double *p = b->p + motor * n, *within = b->covariance + motor * m * m + m + 1;
        const double power = b->noise[motor] * b->noise[motor];
        double *value = values + k * n, *covariance = covariances + k * n * n;
        double theta[MOST_PARAMETERS], moved[MOST_PARAMETERS][MOST_PARAMETERS];
        for (int i = 0; i < n; i++) theta[i] = (i ? p[i] : 1.0) / p[0];
        for (int j = 0; j < n; j++) { /* log theta_0 = -log p_0, log theta_j = log p_j - log p_0 */
            const double leading = within[j] * power;
            moved[0][j] = -leading;
            for (int i = 1; i < n; i++) moved[i][j] = within[i * m + j] * power - leading;
        }
        for (int i = 0; i < n; i++) {
            for (int j = 1; j < n; j++) moved[i][j] -= moved[i][0];
            moved[i][0] = -moved[i][0];
            for (int j = 0; j < n; j++) moved[i][j] = moved[i][j] * theta[i] * theta[j];
        }
        for (int i = 0; i < n; i++) {
            const double x = theta[i] < b->rules.lower[i] ? b->rules.lower[i] : theta[i];
            value[i] = x > b->rules.upper[i] ? b->rules.upper[i] : x;
            for (int j = 0; j < n; j++) covariance[i * n + j] = 0.5 * (moved[i][j] + moved[j][i]);
        }
        for (int i = 0; i < n; i++) {
            const double variance = covariance[i * n + i], widest = b->log_normal * value[i];
            if (!(variance <= widest * widest && variance > 0.0)) return 0;
            const double share = b->share ? b->share[motor * n + i] : 0.0;
            const double most =
                share > 0.0 ? value[i] * share + b->reach[motor * n + i] : INFINITY;
            verdicts[k * n + i] = verdict(&b->rules, i, value[i], sqrt(variance), most);
        }
        if (!definite(n, covariance)) return 0;
    }
    return 1;
}
