/* Numbers of one motor, under the names that lanes.h gives those of many. */
#ifndef GRAY_BOX_OBSERVER_WHITE_BOX_SCALAR_H
#define GRAY_BOX_OBSERVER_WHITE_BOX_SCALAR_H

#include <math.h>
#include <stdint.h>

typedef double Real;

#ifdef QUICK_BUILD /* for tests: slow code, built in seconds */
#define INLINE static inline
#else
#define INLINE static inline __attribute__((always_inline))
#endif
#define UNROLL _Pragma("GCC unroll 16")

INLINE Real all(double x) { return x; }
INLINE Real absolute(Real x) { return fabs(x); }
INLINE Real exponential(Real x) { return exp(x); }
INLINE Real sign(Real x) { return (double)((x > 0.0) - (x < 0.0)); }
INLINE Real smaller(Real a, Real b) { return b < a ? b : a; }
INLINE Real larger(Real a, Real b) { return b > a ? b : a; }

#endif
