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
$macros
$tables
/* Resistance [ohm] of pillar i of those that are taken, as the scan reads it. */
static inline tripillar_real tripillar_ohm(const tripillar_real *resistance_ohm, int i)
{
#if TRIPILLAR_ANY_DEAD
    if (tripillar_place[i] < 0)
        return TRIPILLAR_DEAD_OHM;
#endif
    return resistance_ohm[tripillar_place[i]];
}

#if TRIPILLAR_CONVERTER
/* Whether a converter cannot tell a reading [ohm] of pillar i from rest. */
static inline int tripillar_rests(const tripillar_real *resistance_ohm, int i)
{
    const tripillar_real sense = TRIPILLAR_SENSE_OHM, rest = TRIPILLAR_READ(tripillar_rest_ohm[i]);
    const tripillar_real share = sense / (tripillar_ohm(resistance_ohm, i) + sense) - sense / (rest + sense);
    return TRIPILLAR_MATH(fabs)(share) * TRIPILLAR_FULL_COUNTS <= TRIPILLAR_MAX_COUNTS_FROM_REST;
}
#endif

/* Forces [N] of one scan.
   resistance_ohm[TRIPILLAR_RESISTANCES]: by row, column and pillar ($pillars) [ohm], each finite and above 0; dead
   pillars and those that the model does not take may hold anything.
   force_n[TRIPILLAR_FORCES]: by row, column and axis ($axes) [N]. */
static inline void tripillar_forces(const tripillar_real *resistance_ohm, tripillar_real *force_n)
{
    tripillar_real seen[TRIPILLAR_HIDDEN + TRIPILLAR_INPUTS], *input = seen + TRIPILLAR_HIDDEN;
#if TRIPILLAR_CONVERTER
    int resting = 0;
    for (int i = 0; i < TRIPILLAR_READ_PILLARS; i++)
        resting += tripillar_rests(resistance_ohm, i);
#endif
#if TRIPILLAR_STEPS
    tripillar_real length[TRIPILLAR_READ_PILLARS], residual[TRIPILLAR_READ_PILLARS]; /* [mm] */
    tripillar_real moved[TRIPILLAR_COMPONENTS * TRIPILLAR_ELECTRODES]; /* [mm] */
#endif
    for (int i = 0; i < TRIPILLAR_READ_PILLARS; i++) {
        tripillar_real ohm = tripillar_ohm(resistance_ohm, i);
#if TRIPILLAR_CONVERTER
        if (resting > TRIPILLAR_MIN_RESTING * TRIPILLAR_READ_PILLARS && tripillar_rests(resistance_ohm, i))
            ohm = TRIPILLAR_READ(tripillar_rest_ohm[i]);
#endif
#if TRIPILLAR_STEPS
        ohm -= TRIPILLAR_READ(tripillar_offset_ohm[i]);
        if (ohm < TRIPILLAR_MIN_WHOLE_OHM)
            ohm = TRIPILLAR_MIN_WHOLE_OHM;
        length[i] = TRIPILLAR_MATH(sqrt)(ohm / TRIPILLAR_READ(tripillar_ohm_per_mm2[i]));
        residual[i] = length[i] - TRIPILLAR_READ(tripillar_centre_mm[i]);
#elif TRIPILLAR_ROOT
        input[i] = TRIPILLAR_MATH(sqrt)(ohm);
#else
        input[i] = ohm;
#endif
    }
#if TRIPILLAR_STEPS /* inputs are forces, which cause these lengths */
    for (int k = 0; k < TRIPILLAR_INPUTS; k++)
        input[k] = TRIPILLAR_READ(tripillar_centre_n[k]);
    for (int step = 0;; step++) {
        for (int i = 0; i < TRIPILLAR_READ_PILLARS; i++)
            for (int k = 0; k < TRIPILLAR_INPUTS; k++)
                input[k] += residual[i] * TRIPILLAR_READ(tripillar_correctors[step][i][k]);
        if (step == TRIPILLAR_STEPS - 1)
            break;
        for (int e = 0; e < TRIPILLAR_COMPONENTS * TRIPILLAR_ELECTRODES; e++)
            moved[e] = 0;
        for (int k = 0; k < TRIPILLAR_INPUTS; k++)
            for (int e = 0; e < TRIPILLAR_COMPONENTS * TRIPILLAR_ELECTRODES; e++)
                moved[e] += input[k] * TRIPILLAR_READ(tripillar_influence[k][e]);
        for (int i = 0; i < TRIPILLAR_READ_PILLARS; i++) {
            tripillar_real square = 0;
            for (int part = 0; part < TRIPILLAR_COMPONENTS; part++) {
                const tripillar_real d = moved[part * TRIPILLAR_ELECTRODES + tripillar_top[i]]
                    + TRIPILLAR_READ(tripillar_rest_mm[part][i]);
#if TRIPILLAR_SIGNED
                square += TRIPILLAR_READ(tripillar_sign[part][i]) * d * d;
#else
                square += d * d;
#endif
            }
            residual[i] = length[i] - TRIPILLAR_MATH(sqrt)(square > 0 ? square : 0);
        }
    }
#endif
    for (int i = 0; i < TRIPILLAR_INPUTS; i++)
        input[i] = (input[i] - TRIPILLAR_READ(tripillar_input_centre[i])) * TRIPILLAR_READ(tripillar_input_factor[i]);
#if TRIPILLAR_HIDDEN
    for (int j = 0; j < TRIPILLAR_HIDDEN; j++) {
        tripillar_real sum = TRIPILLAR_READ(tripillar_hidden[j][TRIPILLAR_INPUTS]);
        for (int i = 0; i < TRIPILLAR_INPUTS; i++)
            sum += TRIPILLAR_READ(tripillar_hidden[j][i]) * input[i];
        seen[j] = TRIPILLAR_MATH(tanh)(sum);
    }
#endif
    for (int k = 0; k < TRIPILLAR_FORCES; k++) {
        tripillar_real sum = TRIPILLAR_READ(tripillar_output[k][TRIPILLAR_SEEN]);
        for (int j = 0; j < TRIPILLAR_SEEN; j++)
            sum += TRIPILLAR_READ(tripillar_output[k][j]) * seen[j];
        force_n[k] = sum;
    }
}

#endif
