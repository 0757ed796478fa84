/* The terms of terms.py for compiled code, LANES motors at a time: the same formulas, compared with these by a test.
 *
 * The codes are the places of the terms in TERMS of terms.py. A term of terms.py that has no case here is not compiled:
 * term_known() says so, and motors that have it are learnt without compiled code.
 */
#ifndef GRAY_BOX_OBSERVER_WHITE_BOX_TERMS_H
#define GRAY_BOX_OBSERVER_WHITE_BOX_TERMS_H

#include "white_box/lanes.h"

enum { INDUCTANCE, RESISTANCE, HYSTERESIS, BACK_EMF, BRUSH_DROP };

static const double BRUSH_KNEE_A = 0.02;

typedef struct {
    Real value, by_current, by_speed;
    int of_speed; /* whether there is a derivative by it */
} Term;

static inline int term_known(int64_t code) { return code >= RESISTANCE && code <= BRUSH_DROP; }

/* Basis function of a term at currents in A and speeds in rad/s, and its partial derivatives. */
INLINE Term term(int64_t code, Real current, Real speed)
{
    Term found = {{0}, {0}, {0}, code == HYSTERESIS || code == BACK_EMF};
    switch (code) {
    case RESISTANCE:
        found.value = current;
        found.by_current = all(1.0);
        break;
    case HYSTERESIS:
        found.value = absolute(speed) * current;
        found.by_current = absolute(speed);
        found.by_speed = chosen(speed > 0.0, current, chosen(speed < 0.0, -current, all(0.0)));
        break;
    case BACK_EMF:
        found.value = speed;
        found.by_speed = all(1.0);
        break;
    case BRUSH_DROP: {
        const Real reach = absolute(current) + BRUSH_KNEE_A;
        found.value = current / reach;
        found.by_current = BRUSH_KNEE_A / (reach * reach);
        break;
    }
    default:
        break;
    }
    return found;
}

#endif
