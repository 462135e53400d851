/* Forces on a tactile sensor from the resistances of its pillars, by a trained network. Written by tripillar export.

$facts

Flash: $flash bytes of constants, and the code. RAM: $stack bytes on the stack while it runs, beside the two arrays that
the caller gives ($given bytes). Needs <math.h>.

Where constants do not stay in flash of their own accord (AVR), define TRIPILLAR_MEM and TRIPILLAR_READ before including
this file:
    #define TRIPILLAR_MEM PROGMEM
    #define TRIPILLAR_READ(x) pgm_read_float(&(x)) */

#ifndef TRIPILLAR_H
#define TRIPILLAR_H

#include <math.h>

#ifndef TRIPILLAR_MEM
#define TRIPILLAR_MEM
#endif
#ifndef TRIPILLAR_READ
#define TRIPILLAR_READ(x) (x)
#endif

typedef $real tripillar_real;
#define TRIPILLAR_MATH(name) $math
#define TRIPILLAR_RESISTANCES $resistances
#define TRIPILLAR_FORCES $forces
$tables
static inline tripillar_real tripillar_max(tripillar_real a, tripillar_real b)
{
    return a > b ? a : b;
}

/* Forces [N] of one scan.
   resistance_ohm[TRIPILLAR_RESISTANCES]: by row, column and pillar, as named above [ohm], each finite and above 0; dead
   pillars and those that the model does not take may hold anything.
   force_n[TRIPILLAR_FORCES]: by row, column and axis, as named above [N]. */
static inline void tripillar_forces(const tripillar_real *resistance_ohm, tripillar_real *force_n)
{
$code
}

#endif
