// SPDX-License-Identifier: GPL-3.0-or-later
// The crossbar and the converter's input: an address on the pins selects a crossing, the table says what it reads.
#ifndef CROSSBAR_H
#define CROSSBAR_H

#include <simavr/sim_avr.h>
#include <stdint.h>

#include "table.h"

typedef struct {
    uint64_t conversions;
    uint64_t bad_addresses;  // conversions of no populated crossing, of address pins that are inputs, of another pin
    avr_cycle_count_t min_settle;  // least time from a change of the address to a sample; UINT64_MAX: none yet
} crossbar_statistics_t;

// The supply to give the simulated MCU [mV].
#define CROSSBAR_AVCC_MV (5 * TABLE_FULL_SCALE)

// Connects the pins; `table` must outlive the MCU.
void crossbar_connect(avr_t *avr, const char *mcu, const table_t *table);

// To be told after each avr_reset: the table's time starts again.
void crossbar_reset(avr_t *avr);

const crossbar_statistics_t *crossbar_statistics(void);

#endif
