/* Numbers of LANES motors side by side: what the compiler turns into vectors of whatever width the
 * processor has.
 *
 * Lanes never mix, and the build forbids products fused with sums: every lane does what it would
 * do alone, so that results depend neither on which motors are computed together nor on the
 * processor.
 */
#ifndef GRAY_BOX_OBSERVER_WHITE_BOX_LANES_H
#define GRAY_BOX_OBSERVER_WHITE_BOX_LANES_H

#include <math.h>
#include <stdint.h>

#define LANES 8

typedef double Real __attribute__((vector_size(8 * LANES)));
typedef int64_t Mask __attribute__((vector_size(8 * LANES))); /* all bits of a lane, or none */

#ifdef QUICK_BUILD /* for tests: slow code, built in seconds */
#define INLINE static inline
#else
#define INLINE static inline __attribute__((always_inline))
#endif
#ifndef UNROLL
#define UNROLL _Pragma("GCC unroll 8")
#endif

/* Functions that are built for several kinds of processor, the best of which is chosen when the
 * library is loaded. */
#ifdef QUICK_BUILD /* clones pass vectors in other registers than what they do not take in */
#define CLONES static
#elif defined(__x86_64__) && defined(__GLIBC__) && !defined(__clang__) && __GNUC__ >= 12
#define CLONES \
    __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default"), noinline)) static
#else
#define CLONES __attribute__((noinline)) static
#endif

INLINE Real all(double x) { return (Real){0} + x; }
INLINE Mask everywhere(void) { return ~(Mask){0}; }
INLINE Real chosen(Mask which, Real yes, Real no)
{
    return (Real)((which & (Mask)yes) | (~which & (Mask)no));
}
INLINE Real absolute(Real x) { return (Real)((Mask)x & INT64_MAX); }
INLINE Real sign(Real x) { return chosen(x > 0.0, all(1.0), chosen(x < 0.0, all(-1.0), all(0.0))); }
INLINE Real smaller(Real a, Real b) { return chosen(b < a, b, a); }
INLINE Real larger(Real a, Real b) { return chosen(b > a, b, a); }
INLINE Real between(Real x, Real low, Real high) { return smaller(larger(x, low), high); }

INLINE int anywhere(Mask which)
{
    int any = 0;
    for (int l = 0; l < LANES; l++) any |= which[l] != 0;
    return any;
}

INLINE Real square_root(Real x)
{
    Real found;
    for (int l = 0; l < LANES; l++) found[l] = sqrt(x[l]);
    return found;
}

INLINE Real exponential(Real x)
{
    Real found;
    for (int l = 0; l < LANES; l++) found[l] = exp(x[l]);
    return found;
}

INLINE Real logarithm(Real x)
{
    Real found;
    for (int l = 0; l < LANES; l++) found[l] = log(x[l]);
    return found;
}

#endif
